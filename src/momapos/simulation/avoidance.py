"""What the arm would meet next: itself, the room and the part, as the robot knows them."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from .config import ComplianceConfig
from .geoms import HAND, ROBOT, Kind, matrix_quat
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

LOOK = 4
"""Steps of the controller between two looks at what is near the arm [-]."""
_LEVER = 0.03
"""Change of a distance with the joints, below which they are no way to keep it [m/rad]."""
_OPPOSITE = -0.9
"""Cosine of bounds that can hardly be kept at once [-]."""
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
    most (Faverjon and Tournassoud, ICRA 1987), whichever of them moves. The robot knows its own
    shape exactly, the room and the part as they are modeled; the part stands where its joint is
    believed to be. What the hand may touch it feels, and is left out.
    """

    def __init__(self, known: Simulation, config: ComplianceConfig) -> None:
        self.known, self._config = known, config
        self._model = copy(known.model)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = known.data.qpos
        self._T_world_part = np.eye(4)  # of the body of the part, its joint where the model has it
        mujoco.mju_quat2Mat(rotation := np.empty(9), known.model.body_quat[known.part_body])
        self._T_world_part[:3, :3] = rotation.reshape(3, 3)
        self._T_world_part[:3, 3] = known.model.body_pos[known.part_body]
        self._jacobians = np.zeros((2, 3, known.model.nv))
        joint = known.model.body_jntadr[known.part_body]
        self._loose = known.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        self.part_gaps = np.inf, np.inf
        """`gaps` where bounds were asked for last."""

    def bounds(
        self,
        q: Float[np.ndarray, " n"],
        value: float,
        T_off: Float[np.ndarray, "4 4"] | None = None,
        *,
        part_speed: float = 0.0,
        hand: bool = False,
        stands: bool = False,
    ) -> Bounds:
        """Bounds at a state of the arm.

        Args:
            q: The state [rad] or [m].
            value: Of the part's joint there [rad] or [m]; any for a loose object.
            T_off: Moves the part from where it is modeled to where the hand found it; None for
                where it is modeled.
            part_speed: Of the part's joint [rad/s] or [m/s].
            hand: Whether the hand, too, keeps apart from the room: where it is not near what it
                will hold.
            stands: Whether a loose object stands where it is modeled; else it is left out, for it
                gives way, or is in the hand.
        """
        known, model, data, config = self.known, self._model, self._data, self._config
        self.part_gaps = self.gaps(q, value, T_off)
        mujoco.mj_comPos(model, data)
        near = np.flatnonzero(self._counts(hand, stands) & (data.contact.dist < config.avoid))
        near = near[np.argsort(data.contact.dist[near], kind="stable")]
        _, first = np.unique(data.contact.geom[near], axis=0, return_index=True)
        chosen = near[np.sort(first)[:_MOST]]
        changes = np.array([self._change(i) for i in chosen.tolist()]).reshape(-1, model.nv)
        rows = changes[:, known.arm_v]
        # What overlaps as it is believed is left slowly: the belief may be wrong.
        speed = np.minimum(
            -config.avoid_rate * (data.contact.dist[chosen] - config.apart), config.speed
        )
        if not self._loose:
            speed -= changes[:, known.part_v] * part_speed
        size = np.linalg.norm(rows, axis=1)
        able = size > _LEVER  # else no joint does much about it
        rows, speed = rows[able] / size[able, None], speed[able] / size[able]
        # Between two things the arm leaves the nearer one.
        kept = ~(np.tril(rows @ rows.T < _OPPOSITE)).any(1)
        return Bounds(rows[kept], speed[kept])

    def gaps(
        self,
        q: Float[np.ndarray, " n"],
        value: float,
        T_off: Float[np.ndarray, "4 4"] | None = None,
    ) -> tuple[float, float]:
        """Distance of the part from the robot's base and from its arm; infinite unless near [m].

        Arguments are those of `bounds`.
        """
        known, model, data = self.known, self._model, self._data
        data.qpos[known.arm_q] = q
        if not self._loose:
            T = self._T_world_part if T_off is None else T_off @ self._T_world_part
            model.body_pos[known.part_body] = T[:3, 3]
            model.body_quat[known.part_body] = matrix_quat(T[:3, :3])
            data.qpos[known.part_q] = value
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        return self._gap(Kind.BASE, Kind.PART), self._gap(Kind.ARM, Kind.PART)

    def _gap(self, one: Kind, other: Kind) -> float:
        """Distance between what is of two kinds [m]; infinite where none of it is near."""
        kinds = np.sort(self.known.kinds[self._data.contact.geom], axis=1)
        pairs = (kinds == sorted((one, other))).all(1)
        return float(self._data.contact.dist[pairs].min(initial=np.inf))

    def _counts(self, hand: bool, stands: bool) -> Bool[np.ndarray, " c"]:
        """Which of the near pairs are of the arm with something that it must not touch."""
        kinds: Int[np.ndarray, "c 2"] = self.known.kinds[self._data.contact.geom]
        own = np.isin(kinds, ROBOT).all(1)
        kind = Kind.ROOM if self._loose and not stands else (Kind.ROOM, Kind.PART)
        things = np.isin(kinds, kind).any(1)
        arm = np.isin(kinds, (Kind.ARM, *HAND) if hand else Kind.ARM).any(1)
        return np.asarray(own | (things & arm))

    def _change(self, i: int) -> Float[np.ndarray, " v"]:
        """How the distance of a near pair changes with the joints."""
        model, data = self._model, self._data
        contact = data.contact
        for J, geom in zip(self._jacobians, contact.geom[i].tolist(), strict=True):
            mujoco.mj_jac(model, data, J, None, contact.pos[i], int(model.geom_bodyid[geom]))
        return np.asarray(contact.frame[i, :3] @ (self._jacobians[1] - self._jacobians[0]))
