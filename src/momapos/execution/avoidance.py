"""What the arm would meet next: itself, the room and the part, as the robot knows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from momapos.execution.config import ComplianceConfig
from momapos.execution.shapes import ROBOT, Kind
from momapos.execution.simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_LEVER = 0.03
"""Change of a distance with the joints, below which they are no way to keep it [m/rad]."""
_MOST = 3
"""Pairs that are kept apart at a time, the nearest ones [-]."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Linear bounds of the joints' speeds: `rows @ v >= least`."""

    rows: Float[np.ndarray, "c n"]
    least: Float[np.ndarray, " c"]


def no_bounds(joints: int) -> Bounds:
    """Bounds that bound nothing."""
    return Bounds(np.zeros((0, joints)), np.zeros(0))


class Surroundings:
    """Keeps the arm apart from what is near it, by a velocity damper.

    Two bodies whose distance is d may come nearer to each other at a speed of rate (d - gap) at
    most (Faverjon and Tournassoud, ICRA 1987). The robot knows its own shape exactly, the room and
    the part as they are modeled; the part stands where its joint is believed to be. What the hand
    may touch it feels, and is left out.
    """

    def __init__(self, known: Simulation, config: ComplianceConfig) -> None:
        self.known, self._config = known, config
        self._data = mujoco.MjData(known.model)
        self._data.qpos[:] = known.data.qpos
        self._jacobians = np.zeros((2, 3, known.model.nv))

    def bounds(self, q: Float[np.ndarray, " n"], value: float) -> Bounds:
        """Bounds at a state of the arm, with the part's joint at a value."""
        known, model, data, config = self.known, self.known.model, self._data, self._config
        data.qpos[known.arm_q] = q
        data.qpos[known.part_q] = value
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        near = np.flatnonzero(self._counts() & (data.contact.dist < config.avoid))
        near = near[np.argsort(data.contact.dist[near], kind="stable")]
        _, first = np.unique(data.contact.geom[near], axis=0, return_index=True)
        chosen = near[np.sort(first)[:_MOST]]
        rows = np.array([self._row(i) for i in chosen.tolist()]).reshape(-1, len(q))
        speed = -config.avoid_rate * (data.contact.dist[chosen] - config.apart)
        size = np.linalg.norm(rows, axis=1)
        able = size > _LEVER  # else no joint does much about it
        return Bounds(rows[able] / size[able, None], speed[able] / size[able])

    def _counts(self) -> Bool[np.ndarray, " c"]:
        """Which of the near pairs are of the arm with something that it must not touch."""
        kinds: Int[np.ndarray, "c 2"] = self.known.kinds[self._data.contact.geom]
        own = np.isin(kinds, ROBOT).all(1)
        things = np.isin(kinds, (Kind.ROOM, Kind.PART)).any(1)
        return np.asarray(own | (things & (kinds == Kind.ARM).any(1)))

    def _row(self, i: int) -> Float[np.ndarray, " n"]:
        """How the distance of a near pair changes with the arm's joints."""
        model, data = self.known.model, self._data
        contact = data.contact
        for J, geom in zip(self._jacobians, contact.geom[i].tolist(), strict=True):
            mujoco.mj_jac(model, data, J, None, contact.pos[i], int(model.geom_bodyid[geom]))
        away = contact.frame[i, :3] @ (self._jacobians[1] - self._jacobians[0])
        return np.asarray(away[self.known.arm_v])
