"""Admittance control of the arm at the tool: force sensing, avoidance, pace of the approach.

The controller knows the plan, the robot's joints and the force at the hand, not where the part is.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from momapos.model import Trajectory

from .base_drive import base_coordinates
from .config import (
    ARM_FORCE,
    ARM_TORQUE,
    AVOID_RATE,
    BESIDE_SPEED,
    FILTER_TIME,
    FOLLOW_RATE,
    NEAR_GRASP,
    NEAR_SPEED,
    OBSERVED_DISTANCE,
    PACE_RATE,
    RETURN_RATE,
    SUBSTEPS,
    TURN_DAMPING,
    TURN_RETURN_RATE,
    TURN_SPEED,
    ComplianceConfig,
    ExecutionConfig,
)
from .geoms import HAND, ROBOT, Kind, matrix_quat
from .simulation import Simulation, set_followers

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


@dataclass(frozen=True, eq=False)
class SensedForces:
    """Forces that the robot senses, without the hand's own weight."""

    force: Float[np.ndarray, "3"]
    """Force on the hand, in the world [N]."""
    torque: Float[np.ndarray, "3"]
    """Torque on the hand about the tool's origin, in the world [Nm]."""
    pads: tuple[float, float]
    """Load of the pads of the two sides, against their closing [N]."""
    arm: Float[np.ndarray, " n"]
    """Load of the arm's joints that neither its motion nor the hand explains, from contacts of its
    links [Nm] or [N]."""

    @property
    def size(self) -> tuple[float, float]:
        """Magnitudes of force [N] and torque [Nm]."""
        return float(np.linalg.norm(self.force)), float(np.linalg.norm(self.torque))


def sense_forces(world: Simulation) -> SensedForces:
    """Return the forces on the robot from contacts and from the weld."""
    model, data = world.model, world.data
    mujoco.mj_rnePostConstraint(model, data)
    wrench = data.cfrc_ext[world.hand_bodies].sum(0)
    center = data.subtree_com[model.body_rootid[world.tool_body]]
    force = wrench[3:].copy()
    torque = wrench[:3] + np.cross(center - data.xpos[world.tool_body], force)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], world.tool_body)
    of_hand = np.concatenate([force, torque]) @ jacobian
    loads = (_outside(world) - of_hand)[world.arm_v]
    return SensedForces(force, torque, pad_loads(world), loads)


def _outside(world: Simulation) -> Float[np.ndarray, " v"]:
    """Return the load of all joints from contacts and couplings, without limits [Nm] or [N]."""
    data, load = world.data, np.zeros(world.model.nv)
    if data.nefc:
        own = data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
        mujoco.mj_mulJacTVec(world.model, data, load, np.where(own, 0.0, data.efc_force))
    return load


def pad_loads(world: Simulation) -> tuple[float, float]:
    """Return the load of the pads on sides -1 and 1 [N]."""
    sides = world.pad_side[world.data.contact.geom]
    one = (sides != 0).sum(1) == 1  # two pads in contact hold nothing
    rows = np.flatnonzero(one & (world.data.contact.efc_address >= 0))
    if not len(rows):
        return 0.0, 0.0
    axis = world.T_world_tool[:3, :3] @ world.hand.axis
    loads, wrench = {-1: 0.0, 1: 0.0}, np.empty(6)
    for i in rows.tolist():
        mujoco.mj_contactForce(world.model, world.data, i, wrench)
        push = float(world.data.contact.frame[i].reshape(3, 3).T @ wrench[:3] @ axis)
        for side, sign in zip(sides[i].tolist(), (-1, 1), strict=True):  # force of one on other
            if side:
                loads[side] += side * sign * push
    return loads[-1], loads[1]


_DAMPING = _MIN_SINGULAR_VALUE = 0.05
"""Damping of the pseudoinverse near singularities, and the singular value below which it starts
[m]; there the joints stay closer to the plan."""
_TWIST_WEIGHTS = np.array([1.0, 1.0, 1.0, 0.2, 0.2, 0.2])
"""Length that 1 rad of hand rotation counts as [m]: if the arm cannot meet both, it deviates in
rotation rather than in position."""
_MAX_ITERATIONS = 4
"""Iterations of the active-set solver for joint speed bounds [-]."""
_BOUND_DAMPING = 1e-5
"""Damping of the inverse of the active bounds [-]."""
_NULL_RATE = 2.0
"""Rate at which joints return to the plan in the null space of the tool pose [1/s]."""


class ArmKinematics:
    """Kinematics of the arm from its joints and the odometry of its base alone."""

    def __init__(self, world: Simulation) -> None:
        self._world = world
        self._data = mujoco.MjData(world.model)
        self._data.qpos[:] = world.data.qpos
        self._jacobian = np.zeros((6, world.model.nv))
        self.base, self.base_velocity = np.zeros(3), np.zeros(3)
        """Pose and velocity of the base by odometry, as of its joints."""

    def at(
        self, q: Float[np.ndarray, " n"], base: Float[np.ndarray, "3"] | None = None
    ) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "6 n"]]:
        """Return the tool pose in the world and its Jacobian: linear rows, then angular rows.

        Args:
            q: Arm state [rad] or [m].
            base: Values of the base's joints; None for where it is.
        """
        model, data, tool = self._world.model, self._data, self._world.tool_body
        data.qpos[self._world.base_q] = self.base if base is None else base
        data.qpos[self._world.arm_q] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBody(model, data, self._jacobian[:3], self._jacobian[3:], tool)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.xmat[tool].reshape(3, 3), data.xpos[tool]
        return T, self._jacobian[:, self._world.arm_v]

    @property
    def carried(self) -> Float[np.ndarray, "6"]:
        """Twist of the tool from the motion of the base alone, at the last state of `at`."""
        return np.asarray(self._jacobian[:, self._world.base_v] @ self.base_velocity)


def twist_between(
    T: Float[np.ndarray, "4 4"], other: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "6"]:
    """Return the twist from one pose to another in the world: translation [m], rotation [rad]."""
    quat, turn = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat, (other[:3, :3] @ T[:3, :3].T).ravel())
    mujoco.mju_quat2Vel(turn, quat, 1.0)
    return np.concatenate([other[:3, 3] - T[:3, 3], turn])


EVERYWHERE = np.eye(3)
"""Projector on all directions."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Target of the arm for one control step."""

    q: Float[np.ndarray, " n"]
    """[rad] or [m]"""
    v: Float[np.ndarray, " n"]
    T: Float[np.ndarray, "4 4"]
    """Tool pose."""
    twist: Float[np.ndarray, "6"]
    """Tool velocity, linear and angular [m/s], [rad/s]."""
    yields: Float[np.ndarray, "3 3"]
    """Projector of forces on the directions in which the hand is compliant."""
    loose: Float[np.ndarray, "3 3"]
    """Projector of offsets on the directions in which the hand recovers slowly."""
    here: Float[np.ndarray, "3"] | None = None
    """Measured tool position by the joints [m]; None to ignore the motors' lag."""
    bounds: Bounds | None = None
    """Bounds on the joint speeds; None for the joint limits alone."""


class CompliantArm:
    """Motor set-points that follow a reference and yield to the force at the hand."""

    def __init__(self, world: Simulation, config: ComplianceConfig, step: float) -> None:
        self.kinematics, self._world = ArmKinematics(world), world
        self.config, self.step = config, step
        self.q = world.data.qpos[world.arm_q].copy()
        self.v, self.a = np.zeros(len(self.q)), np.zeros(len(self.q))
        joints = world.model.actuator_trnid[world.arm_motor, 0]
        limited = world.model.jnt_limited[joints].astype(bool)
        limits = world.model.jnt_range[joints]
        self._low = np.where(limited, limits[:, 0], -np.inf)
        self._high = np.where(limited, limits[:, 1], np.inf)
        slides = world.model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE
        self._bears = np.where(slides, ARM_FORCE, ARM_TORQUE)
        self._wrench, self._load = np.zeros(6), np.zeros(len(self.q))
        self.missing = np.zeros(3)
        """What the last step toward a reference lacks of the hand's velocity, for which the arm has
        too few joints [m/s]."""

    def update_forces(self, touch: SensedForces) -> None:
        """Update the low-pass filtered force at the hand."""
        share = self.step / (FILTER_TIME + self.step)
        self._wrench += share * (np.concatenate([touch.force, touch.torque]) - self._wrench)
        self._load += share * (touch.arm - self._load)

    @property
    def wrench(self) -> Float[np.ndarray, "6"]:
        """Filtered force [N] and torque about the tool's origin [Nm] on the hand, in the world."""
        return self._wrench

    @property
    def load(self) -> float:
        """Joint load that the hand does not explain, as a share of the allowed load."""
        return float((np.abs(self._load) / self._bears).max())

    def go(
        self,
        q: Float[np.ndarray, " n"],
        v: Float[np.ndarray, " n"],
        a: Float[np.ndarray, " n"] | None = None,
    ) -> None:
        """Set position and velocity, regardless of the force at the hand."""
        self.q, self.v, self.a = q, v, np.zeros_like(q) if a is None else a

    def stop(self) -> None:
        """Hold the measured position, so that nothing is pressed further."""
        self.go(self._world.data.qpos[self._world.arm_q].copy(), np.zeros_like(self.q))

    def follow(self, reference: Reference) -> None:
        """Move by one step toward a reference."""
        config = self.config
        T, J = self.kinematics.at(self.q)
        off = twist_between(T, reference.T)
        if reference.here is not None:  # compensate the motors' lag along the path
            sure = np.eye(3) - reference.yields
            off[:3] += sure @ (T[:3, 3] - reference.here)
        stiff = off[:3] - reference.loose @ off[:3]
        line = FOLLOW_RATE * stiff + RETURN_RATE * (off[:3] - stiff)
        line += reference.yields @ self._wrench[:3] / config.damping
        turn = TURN_RETURN_RATE * off[3:] + self._wrench[3:] / TURN_DAMPING
        twist = np.concatenate([_clip_length(line, config.speed), _clip_length(turn, TURN_SPEED)])
        twist -= self.kinematics.carried
        free = reference.v + _NULL_RATE * (reference.q - self.q)
        twist += reference.twist
        q = self._moved(J, twist, free, reference.bounds)
        self.missing = (twist - J @ (q - self.q) / self.step)[:3]
        # Feed forward only the plan's speed: feeding forward the compliant motion oscillates.
        self.go(q, reference.v)

    def _moved(
        self,
        J: Float[np.ndarray, "6 n"],
        twist: Float[np.ndarray, "6"],
        free: Float[np.ndarray, " n"],
        bounds: Bounds | None,
    ) -> Float[np.ndarray, " n"]:
        """Return the state after one step at a twist, as close as the joint speed bounds allow.

        Active bounds hold exactly; the remaining degrees of freedom follow the twist.
        """
        count = len(free)
        bounds = bounds or no_bounds(count)
        rows = np.concatenate([np.eye(count), -np.eye(count), bounds.rows])
        to_limits = (self._low - self.q, self.q - self._high)
        least = np.concatenate([*np.minimum(to_limits, 0.0) / self.step, bounds.least])
        v, met = free, np.zeros(len(rows), bool)
        J, twist = J * _TWIST_WEIGHTS[:, None], twist * _TWIST_WEIGHTS
        for _ in range(_MAX_ITERATIONS):
            kept = _bound_inverse(rows[met])
            rest = np.eye(count) - kept @ rows[met]
            v = kept @ least[met] + rest @ free
            v = v + _damped_inverse(J @ rest) @ (twist - J @ v)
            over = rows @ v < least - 1e-9
            if not (over & ~met).any():
                break
            met |= over
        v = v * min(1.0, self.config.joint_speed / max(float(np.abs(v).max()), 1e-12))
        return np.clip(self.q + self.step * v, self._low, self._high)


def _bound_inverse(rows: Float[np.ndarray, "c n"]) -> Float[np.ndarray, "n c"]:
    """Return the damped inverse of the active bounds, which may be nearly parallel."""
    gram = rows @ rows.T + _BOUND_DAMPING * np.eye(len(rows))
    return np.asarray(np.linalg.solve(gram, rows).T)


def _damped_inverse(J: Float[np.ndarray, "6 n"]) -> Float[np.ndarray, "n 6"]:
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    damping = _DAMPING * np.sqrt(np.clip(1.0 - (sigma[-1] / _MIN_SINGULAR_VALUE) ** 2, 0.0, 1.0))
    return np.asarray((Vt.T * (sigma / (sigma**2 + damping**2 + 1e-12))) @ U.T)


def _clip_length(vector: Float[np.ndarray, "3"], length: float) -> Float[np.ndarray, "3"]:
    return vector * min(1.0, length / max(float(np.linalg.norm(vector)), 1e-12))


_MOVING = (Kind.ARM, *HAND)
_SURROUNDINGS = (Kind.ROOM, Kind.PART, Kind.FLOOR)


@dataclass(frozen=True, eq=False)
class PacedTrajectory:
    """A timed trajectory that may be followed more slowly than timed, and backward."""

    plan: Trajectory
    pace: Float[np.ndarray, " t"]
    """Maximum speed at each sample, as a share of the timed speed [-]."""
    left: Float[np.ndarray, " t"]
    """Distance of the tool from its final position at each sample [m]."""
    gap: Float[np.ndarray, " t"]
    """Distance from the arm to the known surroundings at each sample [m], capped at
    `ExecutionConfig.near`."""

    @property
    def last(self) -> int:
        """Index of the last sample."""
        return len(self.plan) - 1

    def at(
        self, k: float, pace: float
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Interpolate position, velocity and acceleration between two samples.

        Args:
            k: Fractional sample index.
            pace: Samples per step; negative on the way back.
        """
        i, j, share = self._between(k)
        q, v, a = (
            (1.0 - share) * values[i] + share * values[j]
            for values in (self.plan.q, self.plan.v, self.plan.a)
        )
        return q, pace * v, pace**2 * a

    def base_at(self, k: float) -> Float[np.ndarray, "3"] | None:
        """Interpolate the pose of a moving base between two samples; None if it stands still."""
        if self.plan.base is None:
            return None
        i, j, share = self._between(k)
        return (1.0 - share) * self.plan.base[i] + share * self.plan.base[j]

    def _between(self, k: float) -> tuple[int, int, float]:
        i = min(int(k), self.last)
        return i, min(i + 1, self.last), k - i


def pace_trajectory(
    plan: Trajectory,
    path: Float[np.ndarray, "m n"],
    tool: Float[np.ndarray, "m 3"],
    room: Simulation,
    config: ExecutionConfig,
    *,
    value: float | None = None,
    careful: bool = False,
    base: Float[np.ndarray, "m 3"] | None = None,
) -> PacedTrajectory:
    """Slow a trajectory down near obstacles and before the grasp.

    Args:
        plan: Trajectory at the joints' speed limits.
        path: Its states [rad] or [m].
        tool: Tool positions at these states [m].
        room: The room as the robot knows it.
        config: Speeds and distances.
        value: Value of the part's joint meanwhile [rad] or [m]; by default as in the room.
        careful: Limit the speed everywhere, because the known room may be wrong.
        base: Poses of a base that moves, at these states; None if it stands where it was first.
    """
    step = config.timestep * SUBSTEPS
    times = np.arange(len(plan)) * step
    gaps = clearances(room, path, OBSERVED_DISTANCE, value, base)
    gap = np.interp(times, plan.state_times, gaps)
    points = np.column_stack([np.interp(times, plan.state_times, tool[:, i]) for i in range(3)])
    speed = np.zeros(len(plan))
    if len(plan) > 1:
        speed = np.linalg.norm(np.gradient(points, axis=0), axis=1) / step
    left = np.linalg.norm(points - points[-1], axis=1)
    share = np.clip(gap / OBSERVED_DISTANCE, 0.0, 1.0)
    most = NEAR_SPEED + share * (BESIDE_SPEED - NEAR_SPEED)
    most = np.where(share < 1.0, most, BESIDE_SPEED if careful else np.inf)
    # If the tool passes near its end and leaves again, only the last arrival counts.
    coming = np.maximum.accumulate(left[::-1])[::-1] <= NEAR_GRASP
    most = np.where(coming, np.minimum(most, NEAR_SPEED), most)
    return PacedTrajectory(plan, _smooth(most / np.maximum(speed, 1e-9), step), left, gap)


def _smooth(pace: Float[np.ndarray, " t"], step: float) -> Float[np.ndarray, " t"]:
    """Return the largest pace below `pace` and 1 whose rate of change is bounded.

    At pace p a sample takes step / p, so p^2 changes by at most 2 rate step per sample.
    """
    rise = 2.0 * PACE_RATE * step * np.arange(len(pace))
    squared = np.clip(pace, 1e-3, 1.0) ** 2
    forward = np.minimum.accumulate(squared - rise) + rise
    backward = (np.minimum.accumulate((forward + rise)[::-1]))[::-1] - rise
    return np.sqrt(backward)


def clearances(
    room: Simulation,
    path: Float[np.ndarray, "m n"],
    most: float,
    value: float | None = None,
    base: Float[np.ndarray, "m 3"] | None = None,
) -> Float[np.ndarray, " m"]:
    """Return the distance from the arm to its surroundings at each state [m], capped at `most`.

    `value` is the value of the part's joint [rad] or [m]; by default as in the room. `base` is the
    pose of a base that moves.
    """
    stands = np.zeros((len(path), 3)) if base is None else base_coordinates(room, base)
    data = mujoco.MjData(room.model)
    data.qpos[:] = room.data.qpos
    if value is not None:
        data.qpos[room.part_q] = value
    arm, obstacles = np.isin(room.kinds, _MOVING), np.isin(room.kinds, _SURROUNDINGS)
    gaps = np.full(len(path), most)
    for i, q in enumerate(path):
        data.qpos[room.arm_q], data.qpos[room.base_q] = q, stands[i]
        mujoco.mj_kinematics(room.model, data)
        mujoco.mj_collision(room.model, data)
        geoms = data.contact.geom
        both = arm[geoms].any(1) & obstacles[geoms].any(1)
        gaps[i] = min(most, data.contact.dist[both].min(initial=most))
    return gaps
