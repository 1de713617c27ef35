"""Time-parameterize arm paths within limits of speed and acceleration."""

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

from .time_law import Limits, Trajectory, time_piece

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MAX_CORNER_ANGLE = np.radians(20.0)
"""The arm stops where its path turns by more than this in joint space [rad]. A spline leaves the
straight motions between states by an eighth of their length times this angle: 2 mrad in free
motions, whose states are 0.04 rad apart. States that follow a moved part are up to 0.25 rad apart
on a curve, which turns by up to 15 degrees in between; the spline is nearer to it than they are."""
MIN_STEP = 1e-4
"""Shortest time between samples; a plan of one minute then has 600,000 [s]."""
MIN_SPEED = 1e-3
"""Smallest speed, acceleration or share of one in a configuration."""
_MIN_STATE_DISTANCE = 1e-9
"""Nearer states count as equal [rad] or [m]."""
_MIN_TOOL_MOTION = 1e-6
"""A coordinate of the tool that moves less is not limited [m]."""
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
    """The arm trajectory of a plan: the approach, then the manipulation."""

    joints: tuple[str, ...]
    times: Float[np.ndarray, " t"]
    """Times from 0 [s]."""
    positions: Float[np.ndarray, "t n"]
    """Joint positions [rad] or [m]."""
    velocities: Float[np.ndarray, "t n"]
    """Joint velocities [rad/s] or [m/s]."""
    grasp_index: int
    """First sample at which the gripper holds the object, or for `place` has released it."""

    def write_csv(self, path: str | Path) -> None:
        """Write one row per sample: time [s], positions, velocities."""
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(["time", *self.joints, *(f"{name}_velocity" for name in self.joints)])
        samples = np.column_stack([self.times, self.positions, self.velocities])
        rows.writerows([f"{value:.9g}" for value in row] for row in samples.tolist())
        write_atomic(as_path("path", path), text.getvalue().encode())


DEFAULT = SpeedConfig()


def time_plan(
    plan: PlacementPlan, robot: Robot, config: SpeedConfig = DEFAULT, *, step: float = 0.02
) -> TimedTrajectory:
    """Compute the arm trajectory of a solved plan.

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
    return TimedTrajectory(
        joints=robot.moved_joints,
        times=np.arange(len(approach) + len(manipulation)) * step,
        positions=np.concatenate([approach.q, manipulation.q]),
        velocities=np.concatenate([approach.v, manipulation.v]),
        grasp_index=len(approach),
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

    Args:
        robot: The robot, with its joints' limits of speed and acceleration.
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
    return way, time_path(
        motion.q, held, acceleration, step, jerk=jerk,
        tool=motion.Ts_world_tool[:, :3, 3], tool_speed=config.tool_speed,
        tool_acceleration=carry if verb == "pick" else np.inf,
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
) -> Trajectory:
    """Follow a path with continuous acceleration, nearly as fast as the limits allow.

    Between corners, the path is a cubic spline through its states, which are close together. The
    arm stops at corners, so that the spline does not leave the checked path; the planner rounds
    them where there is room.

    Args:
        q: States [rad] or [m].
        speed: Speed limit of each joint [rad/s] or [m/s].
        acceleration: Acceleration limit of each joint [rad/s^2] or [m/s^2].
        step: Time between samples [s].
        jerk: Jerk limit of each joint [rad/s^3] or [m/s^3]; None for none.
        tool: Positions of the tool at the states, if the tool has limits [m].
        tool_speed: Speed limit of the tool [m/s].
        tool_acceleration: Acceleration limit of the tool along each axis [m/s^2].

    Raises:
        InputError: The limits cannot be met, or a state is not finite.
    """
    if not np.isfinite(q).all():
        raise InputError("the motion contains NaN or infinity")
    keep = np.append(True, np.abs(np.diff(q, axis=0)).max(1, initial=0.0) > _MIN_STATE_DISTANCE)
    q = q[keep]
    state = np.cumsum(keep) - 1
    if len(q) < 2:
        return replace(still(q[0], 1), state_times=np.zeros(len(state)))
    whole, limits, n = q, Limits(speed, acceleration, np.full(len(speed), np.inf)), q.shape[1]
    if jerk is not None:
        limits = replace(limits, jerk=jerk)
    if tool is not None:
        # The tool adds coordinates with limits: the distance along its path, and x, y, z.
        whole = np.column_stack([q, _along(tool[keep]), tool[keep]])
        limits = Limits(
            np.append(speed, [tool_speed, *[np.inf] * 3]),
            np.append(acceleration, [np.inf, *[tool_acceleration] * 3]),
            np.append(limits.jerk, [np.inf] * 4),
        )
    pieces = [
        _piece(whole[first : last + 1], n, limits, step)
        for first, last in pairwise(np.flatnonzero(_corners(q)))
    ]
    timed, _ = joined(pieces)
    begin = np.cumsum([0, *map(len, pieces[:-1])]) * step
    passed = [t + piece.state_times[1:] for t, piece in zip(begin, pieces, strict=True)]
    return replace(timed, state_times=np.concatenate([[0.0], *passed])[state])


def _along(points: Float[np.ndarray, "m d"]) -> Float[np.ndarray, " m"]:
    """Return the distance along a path of points or states [m] or [rad]."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _corners(q: Float[np.ndarray, "m n"]) -> Bool[np.ndarray, " m"]:
    """Return which states are corners or ends of the path."""
    steps = np.diff(q, axis=0)
    unit = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", unit[:-1], unit[1:])
    return np.concatenate([[True], cosine < np.cos(MAX_CORNER_ANGLE), [True]])


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
