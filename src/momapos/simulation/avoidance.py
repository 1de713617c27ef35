"""Collision avoidance of the arm against itself, the room and the part, as the robot knows them."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from .config import AVOID_RATE, ComplianceConfig
from .followers import set_followers
from .geoms import HAND, ROBOT, Kind, matrix_quat
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

PROXIMITY_INTERVAL = 4
"""Control steps between two proximity queries [-]."""
_MIN_LEVER = 0.03
"""Minimum change of a distance with the joints for a bound to be useful [m/rad]."""
_CONFLICT_COSINE = -0.9
"""Cosine below which two bounds conflict [-]."""
_MAX_PAIRS = 3
"""Maximum number of pairs that get a bound at a time, nearest first [-]."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Linear bounds on the joint speeds: `rows @ v >= least`."""

    rows: Float[np.ndarray, "c n"]
    least: Float[np.ndarray, " c"]


def no_bounds(joints: int) -> Bounds:
    """Return an empty set of bounds."""
    return Bounds(np.zeros((0, joints)), np.zeros(0))


class CollisionAvoidance:
    """Keeps the arm away from nearby obstacles with velocity dampers.

    Two bodies at distance d may approach each other at a speed of at most rate (d - gap)
    (Faverjon and Tournassoud, ICRA 1987), whichever of them moves. The robot knows its own shape
    exactly; the room and the part are as modeled, the part at its estimated joint value. Contacts
    that the hand may have are left to the force control.
    """

    def __init__(self, known: Simulation, config: ComplianceConfig) -> None:
        self.known, self._config = known, config
        self._model = copy(known.model)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = known.data.qpos
        # Of the part's bodies that no other one carries, with the joint as modeled.
        self._Ts_world_part = {body: known.fixed_pose(body) for body in known.part_roots}
        self._jacobians = np.zeros((2, 3, known.model.nv))
        joint = known.model.body_jntadr[known.part_body]
        self._loose = known.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        self.base = np.zeros(3)
        """Values of the base's joints by odometry."""
        self.part_gaps = np.inf, np.inf
        """Result of `gaps` at the last call of `bounds`."""

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
        """Return the speed bounds at a state of the arm.

        Args:
            q: Arm state [rad] or [m].
            value: Value of the part's joint [rad] or [m]; ignored for a movable object.
            T_off: Transform from the part's modeled pose to its estimated one; None for no
                offset.
            part_speed: Speed of the part's joint [rad/s] or [m/s].
            hand: Also keep the hand away from the room, while it is not near its grasp.
            stands: Avoid a movable object at its modeled pose; otherwise it is ignored, because
                it yields or is in the hand.
        """
        known, model, data, config = self.known, self._model, self._data, self._config
        self.part_gaps = self.gaps(q, value, T_off)
        mujoco.mj_comPos(model, data)
        near = np.flatnonzero(self._counts(hand, stands) & (data.contact.dist < config.avoid))
        near = near[np.argsort(data.contact.dist[near], kind="stable")]
        _, first = np.unique(data.contact.geom[near], axis=0, return_index=True)
        chosen = near[np.sort(first)[:_MAX_PAIRS]]
        changes = np.array([self._change(i) for i in chosen.tolist()]).reshape(-1, model.nv)
        rows = changes[:, known.arm_v]
        # Leave an assumed overlap slowly: the model may be wrong.
        speed = np.minimum(-AVOID_RATE * (data.contact.dist[chosen] - config.apart), config.speed)
        if not self._loose:
            speed -= changes[:, known.part_v] * part_speed
        size = np.linalg.norm(rows, axis=1)
        able = size > _MIN_LEVER  # otherwise no joint changes the distance much
        rows, speed = rows[able] / size[able, None], speed[able] / size[able]
        # Between two obstacles the arm moves away from the nearer one.
        kept = ~(np.tril(rows @ rows.T < _CONFLICT_COSINE)).any(1)
        return Bounds(rows[kept], speed[kept])

    def gaps(
        self,
        q: Float[np.ndarray, " n"],
        value: float,
        T_off: Float[np.ndarray, "4 4"] | None = None,
    ) -> tuple[float, float]:
        """Return the distance of the part from the base and from the arm [m]; inf if not near.

        See `bounds` for the arguments.
        """
        known, model, data = self.known, self._model, self._data
        data.qpos[known.arm_q] = q
        data.qpos[known.base_q] = self.base
        if not self._loose:
            for body, T_modeled in self._Ts_world_part.items():
                T = T_modeled if T_off is None else T_off @ T_modeled
                model.body_pos[body] = T[:3, 3]
                model.body_quat[body] = matrix_quat(T[:3, :3])
            data.qpos[known.part_q] = value
            if known.latch is not None:
                known.latch.place(data.qpos, value)
            set_followers(model, data.qpos)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        return self._gap(Kind.BASE, Kind.PART), self._gap(Kind.ARM, Kind.PART)

    def _gap(self, one: Kind, other: Kind) -> float:
        """Return the distance between two kinds of geoms [m]; inf if none are near."""
        kinds = np.sort(self.known.kinds[self._data.contact.geom], axis=1)
        pairs = (kinds == sorted((one, other))).all(1)
        return float(self._data.contact.dist[pairs].min(initial=np.inf))

    def _counts(self, hand: bool, stands: bool) -> Bool[np.ndarray, " c"]:
        """Mark the near pairs of the arm and something that it must not touch."""
        kinds: Int[np.ndarray, "c 2"] = self.known.kinds[self._data.contact.geom]
        own = np.isin(kinds, ROBOT).all(1)
        kind = Kind.ROOM if self._loose and not stands else (Kind.ROOM, Kind.PART)
        obstacles = np.isin(kinds, kind).any(1)
        arm = np.isin(kinds, (Kind.ARM, *HAND) if hand else Kind.ARM).any(1)
        return np.asarray(own | (obstacles & arm))

    def _change(self, i: int) -> Float[np.ndarray, " v"]:
        """Return the derivative of a near pair's distance by the joints."""
        model, data = self._model, self._data
        contact = data.contact
        for J, geom in zip(self._jacobians, contact.geom[i].tolist(), strict=True):
            mujoco.mj_jac(model, data, J, None, contact.pos[i], int(model.geom_bodyid[geom]))
        return np.asarray(contact.frame[i, :3] @ (self._jacobians[1] - self._jacobians[0]))
