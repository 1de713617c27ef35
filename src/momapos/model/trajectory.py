"""Time-parameterize paths of arm and base within limits of speed, acceleration and jerk.

TOPP-RA (Pham and Pham, 2018) finds the fastest motion within the limits of speed and acceleration;
its acceleration jumps. The mean of its position over a moving window of time has the same path and
a continuous acceleration (Biagiotti and Melchiorri, FIR filters for online trajectory planning with
time- and frequency-domain specifications, Control Engineering Practice, 2012). What then exceeds a
limit, because the motion is elsewhere on its path, is slowed down as a whole.

Straight motions between the states are what is planned and checked. What is executed is a smooth
curve through the states, which leaves them where the path bends; states are added until it leaves
them by at most `MAX_DEVIATION`.

toppra imports matplotlib for its own plots, which takes longer than the rest of its import and a
third of a short command. A stand-in imports matplotlib when a plot needs it.
"""

from __future__ import annotations

import csv
import io
import logging
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import (
    GRAVITY,
    InputError,
    as_path,
    check_fields,
    compare_by_content,
    expect,
    finite_number,
    refuse_below,
    write_atomic,
)

from .records import Motion, PlacementPlan, Task, Verb
from .robots import Robot

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


_FOR_PLOTS = ("matplotlib", "matplotlib.pyplot")


class _Later(ModuleType):
    """Imports a module when it is used."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        _forget(self)
        return getattr(import_module(self.__name__), name)


def _forget(module: _Later) -> None:
    """Let the next import find the real module."""
    if sys.modules.get(module.__name__) is module:
        del sys.modules[module.__name__]


@cache
def import_toppra() -> Any:
    """Return the module toppra."""
    waiting = [_Later(name) for name in _FOR_PLOTS if name not in sys.modules]
    sys.modules.update({module.__name__: module for module in waiting})
    try:
        return import_module("toppra")
    finally:
        for module in waiting:
            _forget(module)


WINDOW = 0.06
"""Shortest time over which the position is averaged [s]: three samples of a controller at 50 Hz."""
_MAX_WINDOW = 1.0
"""Longest such time; a small jerk limit then slows the whole motion [s]."""
_NO_LIMIT = 1e3
"""A finite number in place of infinity [m/s] or [m/s^2]."""
_MIN_GRID_POINTS = 400
"""Smallest number of points per piece at which the limits hold [-]."""
_CHECK_STEP = 0.004
"""Longest time between the samples at which the limits are checked [s]."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples at equal time steps; the first and last are at rest."""

    q: Float[np.ndarray, "t n"]
    v: Float[np.ndarray, "t n"]
    a: Float[np.ndarray, "t n"]
    state_times: Float[np.ndarray, " m"]
    """Time at which each state of the path is passed, from the first sample [s]."""
    base: Float[np.ndarray, "t 3"] | None = None
    """x [m], y [m], yaw [rad] of the base; None if it stands still."""
    base_v: Float[np.ndarray, "t 3"] | None = None
    """Velocity of the base in the world [m/s], [m/s], [rad/s]."""

    def __len__(self) -> int:
        return len(self.q)


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of each coordinate of a path; infinite where there is none."""

    speed: Float[np.ndarray, " c"]
    acceleration: Float[np.ndarray, " c"]
    jerk: Float[np.ndarray, " c"]

    @classmethod
    def join(cls, parts: Sequence[MotionLimits]) -> MotionLimits:
        """Concatenate the limits of several sets of coordinates."""
        names = ("speed", "acceleration", "jerk")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def take(self, which: Any) -> MotionLimits:
        """Return the limits of some coordinates."""
        return MotionLimits(self.speed[which], self.acceleration[which], self.jerk[which])


def time_piece(
    path: Float[np.ndarray, "m c"], s: Float[np.ndarray, " m"], limits: MotionLimits, step: float
) -> Trajectory:
    """Time a smooth piece of a path, a cubic spline through its states.

    Args:
        path: States, close together [rad] or [m].
        s: Increasing positions of the states along the path, from 0.
        limits: Of each coordinate.
        step: Time between samples [s].

    Raises:
        InputError: The limits cannot be met.
    """
    toppra = import_toppra()
    logging.getLogger("toppra").setLevel(logging.ERROR)
    spline = toppra.SplineInterpolator(s, path)
    profile = _Profile.fastest(spline, s, limits)
    window = _window(spline, profile, limits)
    end = profile.duration + window
    fine = np.linspace(0.0, end, max(100, int(np.ceil(end / _CHECK_STEP))) + 1)
    passed = np.interp(s, np.maximum.accumulate(profile.averaged(fine, window)[0]), fine)
    passed[-1] = end
    # The acceleration of a cubic spline is largest near its knots.
    checked = profile.averaged(np.concatenate([fine, passed]), window)
    # A whole number of steps, so that the last sample is at the end.
    count = max(1, int(np.ceil(end * _slowdown(spline, checked, limits) / step - 1e-9)))
    factor = end / (count * step)
    q, v, a, _ = _derivatives(spline, profile.averaged(np.linspace(0.0, end, count + 1), window))
    v[[0, -1]] = a[[0, -1]] = 0.0
    return Trajectory(q, factor * v, factor**2 * a, passed / factor)


def _window(spline: Any, profile: _Profile, limits: MotionLimits) -> float:
    """Return the time over which to average the position, so that the jerk keeps its limits [s].

    Over a window w an acceleration changes from one extreme a to the other: a jerk of 2 a / w.
    """
    _, *along = profile.at(profile.times)
    _, _, acceleration, _ = _derivatives(spline, (*along, np.zeros(len(profile.times))))
    needed = 2.0 * np.abs(acceleration).max(0) / limits.jerk
    return float(np.clip(needed.max(), WINDOW, _MAX_WINDOW))


def _slowdown(
    spline: Any, along: tuple[Float[np.ndarray, " t"], ...], limits: MotionLimits
) -> float:
    """Return the factor on the duration with which a motion keeps all limits."""
    _, *rates = _derivatives(spline, along)
    bounds = limits.speed, limits.acceleration, limits.jerk
    excess = [(np.abs(x).max(0) / bound).max() for x, bound in zip(rates, bounds, strict=True)]
    return float(max(1.0, *(x ** (1.0 / (k + 1)) for k, x in enumerate(excess))))


def _derivatives(
    spline: Any, along: tuple[Float[np.ndarray, " t"], ...]
) -> tuple[Float[np.ndarray, "t c"], ...]:
    """Return position, speed, acceleration and jerk of the coordinates by time.

    Args:
        spline: The path.
        along: Position along the path and its three derivatives by time.
    """
    s, v, a, j = along
    q, dq, ddq, dddq = (spline.cspl(s, order) for order in range(4))
    v, a, j = v[:, None], a[:, None], j[:, None]
    return q, dq * v, ddq * v**2 + dq * a, dddq * v**3 + 3.0 * ddq * v * a + dq * j


@dataclass(frozen=True, eq=False)
class _Profile:
    """Motion along a path at constant acceleration between times, from rest to rest."""

    times: Float[np.ndarray, " g"]
    position: Float[np.ndarray, " g"]
    speed: Float[np.ndarray, " g"]
    acceleration: Float[np.ndarray, " g_minus_1"]
    integral: Float[np.ndarray, " g"]
    """Integral of the position over time."""

    @classmethod
    def fastest(cls, spline: Any, s: Float[np.ndarray, " m"], limits: MotionLimits) -> _Profile:
        """Return the fastest motion within the limits of speed and acceleration."""
        toppra = import_toppra()
        grid = np.linspace(s[0], s[-1], max(_MIN_GRID_POINTS, 2 * len(s)))
        bounds = [np.minimum(limit, _NO_LIMIT) for limit in (limits.speed, limits.acceleration)]
        kept = [
            toppra.constraint.JointVelocityConstraint(np.stack([-bounds[0], bounds[0]], 1)),
            toppra.constraint.JointAccelerationConstraint(np.stack([-bounds[1], bounds[1]], 1)),
        ]
        solver = toppra.algorithm.TOPPRA(kept, spline, grid, parametrizer="ParametrizeConstAccel")
        if solver.compute_trajectory(0.0, 0.0) is None:
            raise InputError("no trajectory along the motion meets the joints' limits")
        speed = np.array(solver.problem_data.sd_vec)
        spans = 2.0 * np.diff(grid) / (speed[:-1] + speed[1:])
        times = np.append(0.0, np.cumsum(spans))
        acceleration = np.diff(speed) / spans
        areas = grid[:-1] * spans + speed[:-1] * spans**2 / 2 + acceleration * spans**3 / 6
        return cls(times, grid, speed, acceleration, np.append(0.0, np.cumsum(areas)))

    @property
    def duration(self) -> float:
        """Return the time at the end [s]."""
        return float(self.times[-1])

    def averaged(
        self, t: Float[np.ndarray, " t"], window: float
    ) -> tuple[Float[np.ndarray, " t"], ...]:
        """Return the mean position over the window before each time, and three derivatives."""
        now, before = self.at(t), self.at(t - window)
        return tuple((x - y) / window for x, y in zip(now, before, strict=True))

    def at(self, t: Float[np.ndarray, " t"]) -> tuple[Float[np.ndarray, " t"], ...]:
        """Return integral, position, speed and acceleration; it rests before and after."""
        i = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        inside = np.clip(t, 0.0, self.duration)
        x, a = inside - self.times[i], self.acceleration[i]
        moving = (t >= 0.0) & (t < self.duration)
        position = self.position[i] + self.speed[i] * x + a * x**2 / 2
        area = self.integral[i] + self.position[i] * x + self.speed[i] * x**2 / 2 + a * x**3 / 6
        area = area + np.maximum(t - self.duration, 0.0) * self.position[-1]
        return (
            area, position, np.where(moving, self.speed[i] + a * x, 0.0), np.where(moving, a, 0.0)
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class BaseMotion:
    """Base poses at the states of an arm path, and the limits of the base."""

    poses: Float[np.ndarray, "m 3"]
    """x [m], y [m], yaw [rad], without jumps of a turn."""
    speed: Float[np.ndarray, "3"]
    """Speed limits of x, y and yaw; that of x holds for the norm of x and y, too."""
    acceleration: Float[np.ndarray, "3"]
    """Acceleration limits of x, y and yaw."""


def limited_base_path(robot: Robot, poses: Float[np.ndarray, "m 3"], share: float) -> BaseMotion:
    """Return a base path with the limits of a robot.

    Args:
        robot: The robot.
        poses: x [m], y [m], yaw [rad], without jumps of a turn.
        share: Share of the base's speed limits used [-].
    """
    apart = robot.max_acceleration / np.sqrt(2.0)  # in x and in y, so that both together keep it
    return BaseMotion(
        poses,
        share * np.array([robot.max_speed, robot.max_speed, robot.max_yaw_rate]),
        np.array([apart, apart, robot.max_yaw_acceleration]),
    )


MAX_CORNER_ANGLE = np.radians(20.0)
"""The arm stops where its path turns by more than this in joint space [rad]."""
MAX_DEVIATION = 0.001
"""How far the executed curve may leave the straight motions between states, about [rad] or [m]: the
tip of an arm of one meter then does by a millimeter, a third of what the exact check tolerates as
overlap."""
MAX_PIECES = 8
"""Largest number of intervals into which one is divided [-]."""
_SAME = 1e-9
"""Nearer states count as equal [rad] or [m]."""
_AT = np.array([0.25, 0.5, 0.75])
"""Where the deviation is measured, as a share of an interval [-]."""

ToolPoses = Callable[["Float[np.ndarray, 'm n']", "Float[np.ndarray, 'm 3'] | None"], np.ndarray]
"""Returns the tool's poses in the world (m, 4, 4) at states of the joints and of a moving base."""


def corners(q: Float[np.ndarray, "m n"]) -> Bool[np.ndarray, " m"]:
    """Return which states, no two of them equal, are corners or ends of the path."""
    steps = np.diff(q, axis=0)
    unit = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", unit[:-1], unit[1:])
    return np.concatenate([[True], cosine < np.cos(MAX_CORNER_ANGLE), [True]])


def deviation(q: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " k"]:
    """Return by how much the executed curve leaves the straight motion in each interval.

    The largest of all joints counts [rad] or [m].
    """
    if len(q) < 3:
        return np.zeros(max(len(q) - 1, 0))
    s, slopes = _parameters(q)
    bends = _bends(q, s, slopes)
    return np.abs(np.stack([_off(bends, t) for t in _AT])).max((0, 2), initial=0.0)


def with_close_states(motion: Motion, tool_poses: ToolPoses) -> Motion:
    """Add states to the manipulation, on the curve that is executed, see `MAX_DEVIATION`.

    Args:
        motion: A motion without times.
        tool_poses: Returns the tool's poses at states.
    """
    q = motion.q if motion.base is None else np.column_stack([motion.q, motion.base])
    if len(q) < 3:
        return motion
    pieces = np.ceil(np.sqrt(deviation(q) / MAX_DEVIATION) - 1e-9)
    pieces = np.clip(pieces, 1, MAX_PIECES).astype(np.int64)
    if (pieces == 1).all():
        return motion
    (s, slopes), n = _parameters(q), motion.q.shape[1]
    # A joint that turns back does so at its limit at the most.
    states = np.clip(_between(q, _bends(q, s, slopes), pieces), q.min(0), q.max(0))
    base = None if motion.base is None else states[:, n:]

    def along(values: Float[np.ndarray, " m"]) -> Float[np.ndarray, " k"]:
        column = values[:, None]
        return _between(column, _bends(column, s, _monotone(column, s)), pieces)[:, 0]

    new = np.append(0, np.cumsum(pieces))
    Ts = tool_poses(states[:, :n], base)
    Ts[new] = motion.Ts_world_tool
    return replace(
        motion,
        q=states[:, :n],
        base=base,
        object_q=along(motion.object_q),
        latch_q=None if motion.latch_q is None else along(motion.latch_q),
        Ts_world_tool=Ts,
        holds=tuple(
            replace(one, first=int(new[one.first]), last=int(new[one.last])) for one in motion.holds
        ),
    )


def _parameters(
    q: Float[np.ndarray, "m n"],
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "2 k n"]]:
    """Return the states' positions along the path, and slopes at both ends of each interval.

    The slope at a state is that of the parabola through it and its neighbors. Next to a corner or
    end, where the arm rests, the parabola is that of the neighbor.
    """
    lengths = np.linalg.norm(np.diff(q, axis=0), axis=1)
    s = np.append(0.0, np.cumsum(lengths))
    slopes = np.stack([_secants(q, s)] * 2)
    moved = np.flatnonzero(np.append(True, lengths > _SAME))
    if len(moved) < 3:
        return s, slopes
    kept = q[moved]
    h = np.diff(s[moved])
    m = np.diff(kept, axis=0) / h[:, None]
    inner = (h[1:, None] * m[:-1] + h[:-1, None] * m[1:]) / (h[:-1] + h[1:])[:, None]
    stops = corners(kept)[:, None]
    slopes[:, moved[1:] - 1] = _next_to_ends(m, inner, stops[:-1], stops[1:])
    return s, slopes


def _next_to_ends(
    m: Float[np.ndarray, "k c"],
    inner: Float[np.ndarray, "k_minus_1 c"],
    starts: Bool[np.ndarray, "k #c"],
    ends: Bool[np.ndarray, "k #c"],
) -> Float[np.ndarray, "2 k c"]:
    """Return slopes at both ends of each interval, given those at the states between two.

    An interval that starts or ends the curve has one parabola: that of its other end.
    """
    begin, end = np.concatenate([m[:1], inner]), np.concatenate([inner, m[-1:]])
    alone = starts & ends
    return np.stack([
        np.where(starts, np.where(alone, m, 2.0 * m - end), begin),
        np.where(ends, np.where(alone, m, 2.0 * m - begin), end),
    ])  # fmt: skip


def _monotone(
    values: Float[np.ndarray, "m c"], s: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "2 k c"]:
    """Return slopes with which the curve turns back only where the values do.

    They are those of parabolas, as in `_parameters`, up to three times those of the straight
    motions. Between a rest and a motion the slope jumps. Source: Fritsch and Carlson, Monotone
    Piecewise Cubic Interpolation, SIAM J. Numer. Anal. 17 (1980).
    """
    m, h = _secants(values, s), np.diff(s)[:, None]
    if len(m) < 2:
        return np.stack([m, m])
    a, b = m[:-1], m[1:]
    inner = (h[1:] * a + h[:-1] * b) / np.maximum(h[1:] + h[:-1], _SAME)
    turns = a * b <= 0.0
    starts, ends = (np.pad(turns, (one, (0, 0)), constant_values=True) for one in ((1, 0), (0, 1)))
    slopes = _next_to_ends(m, inner, starts, ends)
    return np.clip(slopes, np.minimum(0.0, 3.0 * m), np.maximum(0.0, 3.0 * m))


def _secants(
    values: Float[np.ndarray, "m c"], s: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "k c"]:
    h = np.diff(s)[:, None]
    return np.where(h > _SAME, np.diff(values, axis=0) / np.maximum(h, _SAME), 0.0)


def _bends(
    values: Float[np.ndarray, "m c"], s: Float[np.ndarray, " m"], slopes: Float[np.ndarray, "2 k c"]
) -> Float[np.ndarray, "2 k c"]:
    """Return the slopes relative to the straight motion, times the length of the interval."""
    return (
        (slopes - _secants(values, s)) * np.diff(s)[:, None] * np.array([1.0, -1.0])[:, None, None]
    )


def _off(
    bends: Float[np.ndarray, "2 k c"], t: float | Float[np.ndarray, "k 1"]
) -> Float[np.ndarray, "k c"]:
    """Return how far cubic curves are from the straight motions, at a share of each interval."""
    return np.asarray(t * (1.0 - t) * ((1.0 - t) * bends[0] + t * bends[1]))


def _between(
    values: Float[np.ndarray, "m c"],
    bends: Float[np.ndarray, "2 k c"],
    pieces: Int[np.ndarray, " k"],
) -> Float[np.ndarray, "r c"]:
    """Return the values on the curve with each interval divided into pieces."""
    row = np.repeat(np.arange(len(pieces)), pieces)
    within = np.arange(len(row)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    t = (within / pieces[row])[:, None]
    out = values[row] + t * (values[row + 1] - values[row]) + _off(bends[:, row], t)
    return np.vstack([out, values[-1:]])


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


MAX_SURFACE_TILT = math.radians(60.0)
"""Tilt of a level from which on it does not limit the speed [rad]."""


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

    def for_task(self, task: Task) -> SpeedConfig:
        """Return the speeds for a task: its own, or those at which an object stays level.

        The surface of a liquid tilts by the angle whose tangent is the acceleration over that of
        gravity. It may take half of the allowed tilt; the hand takes the rest. A speed that the
        task states for a path is the tool's limit there.
        """
        if task.speed is not None:
            return replace(self, tool_speed=task.speed)
        if task.level is None:
            return self
        most = GRAVITY * math.tan(min(task.level, MAX_SURFACE_TILT) / 2)
        return replace(self, carry_acceleration=min(self.carry_acceleration, most))


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
    config = config.for_task(plan.task)
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
    config = config.for_task(plan.task)
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
    base: BaseMotion | None = None,
) -> Trajectory:
    """Follow a path with continuous acceleration, nearly as fast as the limits allow.

    Between corners, the path is a cubic spline through its states. The arm stops at corners; the
    planner rounds them where there is room, and its states are so close together that the spline
    leaves the straight motions between them, which are checked, by `MAX_DEVIATION`.

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
    limits = [MotionLimits(speed, acceleration, np.full(n, np.inf) if jerk is None else jerk)]
    if base is not None:
        q = np.column_stack([q, base.poses])
        limits.append(MotionLimits(base.speed, base.acceleration, np.full(3, np.inf)))
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
        limits.append(MotionLimits(*bounds))
    if base is not None:  # the norm of x and y
        columns.append(_along(q[:, n : n + 2])[:, None])
        limits.append(MotionLimits(base.speed[:1], *np.full((2, 1), np.inf)))
    whole, bound = np.column_stack(columns), MotionLimits.join(limits)
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


def _piece(path: Float[np.ndarray, "m c"], n: int, limits: MotionLimits, step: float) -> Trajectory:
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
