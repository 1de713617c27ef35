"""When the arm is where: a path becomes a trajectory within limits of speed and acceleration."""

from __future__ import annotations

import csv
import io
import logging
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError, write_atomic
from momapos.model.records import Motion, PlacementPlan, Verb
from momapos.model.robots import Robot

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

CORNER = np.radians(10.0)
"""The arm stops where its path turns by more than this in joint space [rad]."""
_SAME = 1e-9
_STILL = 1e-6
"""A tool that moves less has no limits [m]."""
_NO_LIMIT = 1e3
"""Stands for infinity where numbers are wanted [m/s] or [m/s^2]."""
_GRID = 400
"""Points of a piece at which the limits are met, at least [-]."""


@dataclass(frozen=True)
class SpeedConfig:
    """How fast the arm moves."""

    approach_speed: float = 0.5
    """Share of the joints' speed limits used on the way to the object [-]."""
    manipulation_speed: float = 0.5
    """Share of the joints' speed limits used while it holds the object [-]."""
    tool_speed: float = 0.25
    """Speed limit of the tool while it holds the object, as ISO 10218-1 has for hand-guided work
    [m/s]."""
    acceleration: float = 2.0
    """Limit for joints that turn [rad/s^2]."""
    slide_acceleration: float = 0.5
    """Limit for joints that slide [m/s^2]."""
    carry_acceleration: float = 1.0
    """Limit of the tool in each direction while it carries an object by friction [m/s^2]."""
    default_speed: float = 1.5
    """Limit of joints whose URDF gives none [rad/s] or [m/s]."""


@dataclass(frozen=True)
class Trajectory:
    """Samples at equal times, the first and the last at rest."""

    q: Float[np.ndarray, "t n"]
    v: Float[np.ndarray, "t n"]
    a: Float[np.ndarray, "t n"]
    state_times: Float[np.ndarray, " m"]
    """When each state of the path is passed [s], from the first sample."""

    def __len__(self) -> int:
        return len(self.q)


@dataclass(frozen=True)
class TimedTrajectory:
    """The arm's motion of a plan over time: the approach, then the manipulation."""

    joints: tuple[str, ...]
    times: Float[np.ndarray, " t"]
    """[s], from 0."""
    positions: Float[np.ndarray, "t n"]
    """[rad] or [m]"""
    velocities: Float[np.ndarray, "t n"]
    """[rad/s] or [m/s]"""
    grasp_index: int
    """The first sample at which the gripper holds the object, or holds it no more for `place`."""

    def write_csv(self, path: Path) -> None:
        """Write a line a sample: the time [s], the positions, the velocities."""
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(["time", *self.joints, *(f"{name}_velocity" for name in self.joints)])
        samples = np.column_stack([self.times, self.positions, self.velocities])
        rows.writerows([f"{value:.9g}" for value in row] for row in samples.tolist())
        write_atomic(path, text.getvalue().encode())


DEFAULT = SpeedConfig()


def time_plan(
    plan: PlacementPlan, robot: Robot, config: SpeedConfig = DEFAULT, *, step: float = 0.02
) -> TimedTrajectory:
    """Say when the arm is where: the motion of a solved plan as a trajectory.

    The arm rests at the grasp, where the gripper closes; both parts begin and end at rest.

    Args:
        plan: A solved plan of this robot.
        robot: Its joints' speed limits count.
        config: How fast.
        step: Time between samples [s].

    Raises:
        InputError: The plan is not solved, or no trajectory keeps the limits.
    """
    if plan.motion is None:
        raise InputError(f"the plan is {plan.status!r}: it holds no motion to be timed")
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
    """The same plan with a time for each of its arm states, see `time_plan`; unsolved as it is."""
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
    """The approach and the manipulation of a motion, each from rest to rest.

    Args:
        robot: Its joints' speed limits count.
        motion: What the arm does.
        config: How fast.
        step: Time between samples [s].
        verb: What it is for: to pick an object the hand carries it in the manipulation, to place
            one in the approach.
    """
    joints = [robot.model.joint(name) for name in robot.moved_joints]
    speed = np.array([joint.velocity for joint in joints])
    speed = np.where(np.isfinite(speed), speed, config.default_speed)
    slides = np.array([joint.kind == "prismatic" for joint in joints])
    acceleration = np.where(slides, config.slide_acceleration, config.acceleration)
    approach = motion.approach if len(motion.approach) else motion.q[:1]
    carry = config.carry_acceleration
    held = config.manipulation_speed * speed
    if verb == "place":
        tool = robot.chain.tool_poses(robot.chain.freedom_values(approach))[:, :3, 3]
        way = time_path(
            approach, held, acceleration, step,
            tool=tool, tool_speed=config.tool_speed, tool_acceleration=carry,
        )  # fmt: skip
    else:
        way = time_path(approach, config.approach_speed * speed, acceleration, step)
    return way, time_path(
        motion.q, held, acceleration, step,
        tool=motion.Ts_world_tool[:, :3, 3], tool_speed=config.tool_speed,
        tool_acceleration=carry if verb == "pick" else np.inf,
    )  # fmt: skip


def still(q: Float[np.ndarray, " n"], count: int) -> Trajectory:
    """Stay at a state."""
    rest = np.zeros((count, len(q)))
    return Trajectory(np.tile(q, (count, 1)), rest, rest, np.zeros(1))


def time_path(
    q: Float[np.ndarray, "m n"],
    speed: Float[np.ndarray, " n"],
    acceleration: Float[np.ndarray, " n"],
    step: float,
    *,
    tool: Float[np.ndarray, "m 3"] | None = None,
    tool_speed: float = np.inf,
    tool_acceleration: float = np.inf,
) -> Trajectory:
    """Follow a path as fast as limits allow (Pham and Pham, TOPP-RA, 2018).

    Between its corners the path is a cubic spline through its states, which are close together;
    at a corner the arm stops, so that no spline swings out of the checked path.

    Args:
        q: States [rad] or [m].
        speed: Limit of each joint [rad/s] or [m/s].
        acceleration: Limit of each joint [rad/s^2] or [m/s^2].
        step: Time between samples [s].
        tool: Positions of the tool at the states [m], where its speed is limited too.
        tool_speed: That limit [m/s].
        tool_acceleration: Its limit in each direction [m/s^2].

    Raises:
        InputError: No trajectory meets the limits, or a state is not finite.
    """
    if not np.isfinite(q).all():
        raise InputError("the motion holds NaN or infinity; nothing can be executed")
    keep = np.append(True, np.abs(np.diff(q, axis=0)).max(1, initial=0.0) > _SAME)
    q = q[keep]
    state = np.cumsum(keep) - 1
    if len(q) < 2:
        return replace(still(q[0], 1), state_times=np.zeros(len(state)))
    # The tool's way is one more coordinate with a limit, and each direction of it another.
    more = None if tool is None else np.column_stack([_along(tool[keep]), tool[keep]])
    limits = (
        np.append(speed, [tool_speed, *[np.inf] * 3]),
        np.append(acceleration, [np.inf, *[tool_acceleration] * 3]),
    )
    ends = np.flatnonzero(_corners(q))
    pieces = []
    for first, last in pairwise(ends):
        part = slice(first, last + 1)
        whole = q[part] if more is None else np.column_stack([q[part], more[part]])
        pieces.append(_piece(whole, q.shape[1], *limits, step))
    timed, _ = joined(pieces)
    begin = np.cumsum([0, *map(len, pieces[:-1])]) * step
    passed = [t + piece.state_times[1:] for t, piece in zip(begin, pieces, strict=True)]
    return replace(timed, state_times=np.concatenate([[0.0], *passed])[state])


def _along(points: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, " m"]:
    """Distance along a path of points [m]."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _corners(q: Float[np.ndarray, "m n"]) -> Bool[np.ndarray, " m"]:
    """Where the path turns sharply, and its ends."""
    steps = np.diff(q, axis=0)
    unit = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", unit[:-1], unit[1:])
    return np.concatenate([[True], cosine < np.cos(CORNER), [True]])


def _piece(
    path: Float[np.ndarray, "m c"],
    n: int,
    speed: Float[np.ndarray, " d"],
    acceleration: Float[np.ndarray, " d"],
    step: float,
) -> Trajectory:
    """A smooth piece from rest to rest along the first n coordinates, the joints.

    The others only have limits, as far as they have some and move at all.
    """
    import toppra
    from toppra import algorithm, constraint

    logging.getLogger("toppra").setLevel(logging.ERROR)
    speed, acceleration = speed[: path.shape[1]], acceleration[: path.shape[1]]
    bounded = np.isfinite(speed) | np.isfinite(acceleration)
    counts = (np.arange(path.shape[1]) < n) | (bounded & (np.ptp(path, axis=0) > _STILL))
    speed = np.minimum(speed[counts], _NO_LIMIT)
    acceleration = np.minimum(acceleration[counts], _NO_LIMIT)
    s = _along_max(path[:, :n])
    spline = toppra.SplineInterpolator(s, path[:, counts])
    limits = [
        constraint.JointVelocityConstraint(np.stack([-speed, speed], 1)),
        constraint.JointAccelerationConstraint(np.stack([-acceleration, acceleration], 1)),
    ]
    grid = np.linspace(s[0], s[-1], max(_GRID, 2 * len(s)))
    solver = algorithm.TOPPRA(limits, spline, grid, parametrizer="ParametrizeConstAccel")
    timed = solver.compute_trajectory(0.0, 0.0)
    if timed is None:
        raise InputError("no trajectory along the motion keeps the joints' limits")
    t = np.append(np.arange(0.0, timed.duration, step), timed.duration)
    position, velocity, change = (timed(t, order)[:, :n] for order in (0, 1, 2))
    velocity[-1], change[-1] = 0.0, 0.0
    passed = _passing_times(grid, solver.problem_data.sd_vec, s)
    return Trajectory(position, velocity, change, passed)


def _passing_times(
    grid: Float[np.ndarray, " g"], speed: Float[np.ndarray, " g"], s: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    """When points of a path are passed that is accelerated evenly between grid points [s].

    Args:
        grid: Positions along the path, rising.
        speed: Speed along the path at each.
        s: The points.
    """
    step = np.diff(grid)
    begin = np.append(0.0, np.cumsum(2 * step / (speed[:-1] + speed[1:])))
    i = np.clip(np.searchsorted(grid, s, side="right") - 1, 0, len(step) - 1)
    squared = speed**2
    share = (s - grid[i]) / step[i]
    here = np.sqrt(squared[i] + share * (squared[i + 1] - squared[i]))
    way = s - grid[i]
    total = speed[i] + here
    return begin[i] + np.divide(2 * way, total, out=np.zeros_like(way), where=way > 0)


def _along_max(q: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " m"]:
    """Way along a path, by the joint that moves most in each step."""
    return np.append(0.0, np.cumsum(np.abs(np.diff(q, axis=0)).max(1)))


def joined(parts: list[Trajectory]) -> tuple[Trajectory, Int[np.ndarray, " t"]]:
    """One trajectory after the other, and the index of the part that each sample is of."""
    keys = ("q", "v", "a", "state_times")
    whole = Trajectory(*(np.concatenate([getattr(part, key) for part in parts]) for key in keys))
    return whole, np.repeat(np.arange(len(parts)), [len(part) for part in parts])
