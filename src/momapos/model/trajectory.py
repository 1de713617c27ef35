"""Time-parameterize paths of arm and base within limits of speed and acceleration."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import (
    InputError,
    as_path,
    check_fields,
    compare_by_content,
    expect,
    finite_number,
    refuse_below,
    write_atomic,
)
from momapos.model.records import Motion, PlacementPlan, Verb
from momapos.model.robots import Robot

from .base_limits import BasePath, limited_base_path
from .close_states import corners
from .time_law import Limits, Trajectory, time_piece

if TYPE_CHECKING:
    from jaxtyping import Float, Int

MIN_STEP = 1e-4
"""Shortest time between samples; a plan of one minute then has 600,000 [s]."""
MIN_SPEED = 1e-3
"""Smallest speed, acceleration or share of one in a configuration."""
_MIN_STATE_DISTANCE = 1e-9
"""Nearer states count as equal [rad] or [m]."""
_MIN_TOOL_MOTION = 1e-6
"""A coordinate of the tool that moves less is not limited [m]."""
BASE_COLUMNS = ("base_x", "base_y", "base_yaw")
"""Names of the base's coordinates in tables."""
DEFAULT_SPEED = 1.5
"""Speed limit of joints without a limit in the URDF [rad/s] or [m/s]."""


@dataclass(frozen=True)
class SpeedConfig:
    """How fast the arm moves."""

    approach_speed: float = 0.5
    """Share of the joints' speed limits used in the approach [-]."""
    manipulation_speed: float = 0.5
    """Share of the joints' speed limits used in the manipulation [-]."""
    tool_speed: float = 0.25
    """Speed limit of the tool in the manipulation, as in ISO 10218-1 for hand guiding [m/s]."""
    acceleration: float = 2.0
    """Acceleration limit of revolute joints; a smaller one of the URDF holds [rad/s^2]."""
    slide_acceleration: float = 0.5
    """Acceleration limit of prismatic joints; a smaller one of the URDF holds [m/s^2]."""
    carry_acceleration: float = 1.0
    """Acceleration limit of the tool along each axis while it carries an object [m/s^2]."""

    def __post_init__(self) -> None:
        check_fields(self)
        refuse_below(self, MIN_SPEED, *(item.name for item in fields(self)))


@compare_by_content
@dataclass(frozen=True, eq=False)
class TimedTrajectory:
    """The trajectory of a plan's arm, and of a base that moves: approach, then manipulation."""

    joints: tuple[str, ...]
    times: Float[np.ndarray, " t"]
    """Times from 0 [s]."""
    positions: Float[np.ndarray, "t n"]
    """Joint positions [rad] or [m]."""
    velocities: Float[np.ndarray, "t n"]
    """Joint velocities [rad/s] or [m/s]."""
    grasp_index: int
    """First sample of the manipulation: the gripper holds the object, or for `place` has released
    it. A base that moves may bring the hand to the object first."""
    base: Float[np.ndarray, "t 3"] | None = None
    """x [m], y [m], yaw [rad] of the base; None if it stands still at the plan's base pose."""
    base_velocities: Float[np.ndarray, "t 3"] | None = None
    """Velocity of the base in the world [m/s], [m/s], [rad/s]."""

    def write_csv(self, path: str | Path) -> None:
        """Write one row per sample: time [s], positions, velocities; then those of a moving base.

        The base has the columns base_x, base_y, base_yaw.
        """
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        names, columns = list(self.joints), [self.times, self.positions, self.velocities]
        header = ["time", *names, *(f"{name}_velocity" for name in names)]
        if self.base is not None and self.base_velocities is not None:
            columns += [self.base, self.base_velocities]
            header += [*BASE_COLUMNS, *(f"{name}_velocity" for name in BASE_COLUMNS)]
        rows.writerow(header)
        samples = np.column_stack(columns)
        rows.writerows([f"{value:.9g}" for value in row] for row in samples.tolist())
        write_atomic(as_path("path", path), text.getvalue().encode())


DEFAULT = SpeedConfig()


def time_plan(
    plan: PlacementPlan, robot: Robot, config: SpeedConfig = DEFAULT, *, step: float = 0.02
) -> TimedTrajectory:
    """Compute the arm trajectory of a solved plan, and the base's if it moves, on one clock.

    Approach and manipulation each start and end at rest; in between, the gripper closes.

    Args:
        plan: A solved plan of this robot.
        robot: The robot, with its joints' speed limits.
        config: Speed and acceleration limits.
        step: Time between samples [s].

    Raises:
        InputError: The plan is not solved or not for this robot, or the limits cannot be met.
    """
    expect("plan", plan, PlacementPlan, "read_plan reads one")
    expect("robot", robot, Robot, "load_robot reads one")
    expect("config", config, SpeedConfig)
    step = finite_number("step", step, MIN_STEP, 1.0)
    if plan.motion is None:
        raise InputError(f"plan must be solved, but its status is {plan.status!r}")
    if plan.joints != robot.moved_joints:
        raise InputError(
            f"plan is for {plan.robot_name} with joints {', '.join(plan.joints)}, not for robot "
            f"{robot.name}"
        )
    approach, manipulation = time_motion(robot, plan.motion, config, step, verb=plan.task.verb)
    base, base_v = manipulation.base, manipulation.base_v
    if base is not None and base_v is not None:  # it stands still in the approach
        count = (len(approach), 1)
        base = np.concatenate([np.tile(base[0], count), base])
        base_v = np.concatenate([np.tile(np.zeros(3), count), base_v])
    return TimedTrajectory(
        joints=robot.moved_joints,
        times=np.arange(len(approach) + len(manipulation)) * step,
        positions=np.concatenate([approach.q, manipulation.q]),
        velocities=np.concatenate([approach.v, manipulation.v]),
        grasp_index=len(approach),
        base=base,
        base_velocities=base_v,
    )


def with_times(
    plan: PlacementPlan, robot: Robot, config: SpeedConfig = DEFAULT, *, step: float = 0.02
) -> PlacementPlan:
    """Return a plan with a time for each of its arm states, see `time_plan`."""
    if plan.motion is None:
        return plan
    approach, manipulation = time_motion(robot, plan.motion, config, step, verb=plan.task.verb)
    times = manipulation.state_times
    motion = replace(
        plan.motion,
        approach_times=approach.state_times if len(plan.motion.approach) else times[:0],
        times=times,
    )
    return replace(plan, motion=motion)


def time_motion(
    robot: Robot, motion: Motion, config: SpeedConfig, step: float, *, verb: Verb | None = None
) -> tuple[Trajectory, Trajectory]:
    """Compute trajectories of a motion's approach and manipulation, each from rest to rest.

    A base that moves in the manipulation keeps the speed share of the joints and its own
    acceleration limits, which hold for the norm of x and y.

    Args:
        robot: The robot, with its joints' and its base's limits of speed and acceleration.
        motion: The motion.
        config: Speed and acceleration limits.
        step: Time between samples [s].
        verb: The task's verb: `pick` carries an object in the manipulation, `place` in the
            approach.
    """
    joints = [robot.model.joint(name) for name in robot.moved_joints]
    speed = np.array([joint.velocity for joint in joints])
    speed = np.where(np.isfinite(speed), speed, DEFAULT_SPEED)
    slides = np.array([joint.kind == "prismatic" for joint in joints])
    usual = np.where(slides, config.slide_acceleration, config.acceleration)
    acceleration = np.minimum(usual, [joint.acceleration for joint in joints])
    jerk = np.array([joint.jerk for joint in joints])
    approach = motion.approach if len(motion.approach) else motion.q[:1]
    carry = config.carry_acceleration
    held = config.manipulation_speed * speed
    if verb == "place":
        tool = robot.chain.tool_poses(robot.chain.freedom_values(approach))[:, :3, 3]
        way = time_path(
            approach, held, acceleration, step, jerk=jerk,
            tool=tool, tool_speed=config.tool_speed, tool_acceleration=carry,
        )  # fmt: skip
    else:
        way = time_path(approach, config.approach_speed * speed, acceleration, step, jerk=jerk)
    base = None
    if motion.base is not None:
        base = limited_base_path(robot, motion.base, config.manipulation_speed)
    return way, time_path(
        motion.q, held, acceleration, step, jerk=jerk,
        tool=motion.Ts_world_tool[:, :3, 3], tool_speed=config.tool_speed,
        tool_acceleration=carry if verb == "pick" else np.inf,
        base=base,
    )  # fmt: skip


def still(q: Float[np.ndarray, " n"], count: int) -> Trajectory:
    """Return a trajectory that stays at a state."""
    rest = np.zeros((count, len(q)))
    return Trajectory(np.tile(q, (count, 1)), rest, rest, np.zeros(1))


def time_path(
    q: Float[np.ndarray, "m n"],
    speed: Float[np.ndarray, " n"],
    acceleration: Float[np.ndarray, " n"],
    step: float,
    *,
    jerk: Float[np.ndarray, " n"] | None = None,
    tool: Float[np.ndarray, "m 3"] | None = None,
    tool_speed: float = np.inf,
    tool_acceleration: float = np.inf,
    base: BasePath | None = None,
) -> Trajectory:
    """Follow a path with continuous acceleration, nearly as fast as the limits allow.

    Between corners, the path is a cubic spline through its states. The arm stops at corners; the
    planner rounds them where there is room, and its states are so close together that the spline
    leaves the straight motions between them, which are checked, by `close_states.MAX_DEVIATION`.

    Args:
        q: States [rad] or [m].
        speed: Speed limit of each joint [rad/s] or [m/s].
        acceleration: Acceleration limit of each joint [rad/s^2] or [m/s^2].
        step: Time between samples [s].
        jerk: Jerk limit of each joint [rad/s^3] or [m/s^3]; None for none.
        tool: Positions of the tool at the states, if the tool has limits [m].
        tool_speed: Speed limit of the tool [m/s].
        tool_acceleration: Acceleration limit of the tool along each axis [m/s^2].
        base: Path of the base at the states, if it moves with the arm.

    Raises:
        InputError: The limits cannot be met, or a state is not finite.
    """
    n = q.shape[1]
    limits = [Limits(speed, acceleration, np.full(n, np.inf) if jerk is None else jerk)]
    if base is not None:
        q = np.column_stack([q, base.poses])
        limits.append(Limits(base.speed, base.acceleration, np.full(3, np.inf)))
    if not np.isfinite(q).all():
        raise InputError("the motion contains NaN or infinity")
    keep = np.append(True, np.abs(np.diff(q, axis=0)).max(1, initial=0.0) > _MIN_STATE_DISTANCE)
    q = q[keep]
    state = np.cumsum(keep) - 1
    if len(q) < 2:
        return _split(replace(still(q[0], 1), state_times=np.zeros(len(state))), n)
    # The tool adds coordinates with limits: the distance along its path, and x, y, z.
    columns = [q]
    if tool is not None:
        columns += [_along(tool[keep])[:, None], tool[keep]]
        most = tool_acceleration
        bounds = np.array([[tool_speed, *[np.inf] * 3], [np.inf, most, most, most], [np.inf] * 4])
        limits.append(Limits(*bounds))
    if base is not None:  # the norm of x and y
        columns.append(_along(q[:, n : n + 2])[:, None])
        limits.append(Limits(base.speed[:1], *np.full((2, 1), np.inf)))
    whole, bound = np.column_stack(columns), Limits.join(limits)
    pieces = [
        _piece(whole[first : last + 1], q.shape[1], bound, step)
        for first, last in pairwise(np.flatnonzero(corners(q)))
    ]
    timed, _ = joined(pieces)
    begin = np.cumsum([0, *map(len, pieces[:-1])]) * step
    passed = [t + piece.state_times[1:] for t, piece in zip(begin, pieces, strict=True)]
    return _split(replace(timed, state_times=np.concatenate([[0.0], *passed])[state]), n)


def _split(timed: Trajectory, n: int) -> Trajectory:
    """Return a trajectory of n joints and a base from one of all; without a base, unchanged."""
    if timed.q.shape[1] == n:
        return timed
    arm = timed.q[:, :n], timed.v[:, :n], timed.a[:, :n]
    return Trajectory(*arm, timed.state_times, timed.q[:, n:], timed.v[:, n:])


def _along(points: Float[np.ndarray, "m d"]) -> Float[np.ndarray, " m"]:
    """Return the distance along a path of points or states [m] or [rad]."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _piece(path: Float[np.ndarray, "m c"], n: int, limits: Limits, step: float) -> Trajectory:
    """Time a smooth piece from rest to rest.

    The first n coordinates are joints. The others only impose limits, if finite and if they move.
    """
    bounded = np.isfinite(limits.speed) | np.isfinite(limits.acceleration)
    counts = bounded & (np.ptp(path, axis=0) > _MIN_TOOL_MOTION)
    counts[:n] = True
    timed = time_piece(path[:, counts], _along(path[:, :n]), limits.take(counts), step)
    return replace(timed, q=timed.q[:, :n], v=timed.v[:, :n], a=timed.a[:, :n])


def joined(parts: list[Trajectory]) -> tuple[Trajectory, Int[np.ndarray, " t"]]:
    """Concatenate trajectories; also return the index of each sample's part."""
    keys = ("q", "v", "a", "state_times")
    whole = Trajectory(*(np.concatenate([getattr(part, key) for part in parts]) for key in keys))
    return whole, np.repeat(np.arange(len(parts)), [len(part) for part in parts])
