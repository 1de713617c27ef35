"""Split a plan into timed phases: drive, move the arm, close or open the gripper."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.model import DEFAULT, SpeedConfig, limited_base_path, time_motion, time_path
from momapos.model.records import Motion, PlacementPlan, Verb
from momapos.model.robots import Robot, opened_as

if TYPE_CHECKING:
    from jaxtyping import Float, Int

GRIPPER_TIME = 1.0
"""Time for a gripper to close or open [s]."""
STEP = 0.02
"""Time between samples [s]."""
_MIN_MOTION = 1e-9
"""A joint or a base that moves less stands still [rad] or [m]."""


class PhaseKind(StrEnum):
    """Kind of a phase; the values are written to files."""

    DRIVE = "drive"
    ARM = "arm"
    DRIVE_AND_ARM = "drive_and_arm"
    CLOSE = "close_gripper"
    OPEN = "open_gripper"


@dataclass(frozen=True, eq=False)
class Phase:
    """A section of a plan that begins and ends at rest."""

    kind: PhaseKind
    times: Float[np.ndarray, " t"]
    """Time since the beginning of the phase [s]."""
    base: Float[np.ndarray, "t 3"]
    """x [m], y [m], yaw [rad] of the base on the floor."""
    positions: Float[np.ndarray, "t n"]
    """Positions of the plan's joints [rad] or [m]."""
    velocities: Float[np.ndarray, "t n"]
    object_q: Float[np.ndarray, " t"]
    """Value of the object's joint [rad] or [m]; zeros if the task has none."""
    latch_q: Float[np.ndarray, " t"]
    """Value of the object's latch [rad] or [m]; zeros if none is turned."""
    base_path: Float[np.ndarray, "k 3"] | None = None
    """The path of the base, of a phase in which the base moves alone."""


def phases_of(
    plan: PlacementPlan, robot: Robot, speeds: SpeedConfig = DEFAULT, *, step: float = STEP
) -> tuple[Phase, ...]:
    """Return the phases of a solved plan, in order.

    A hand that is not fully open in the plan is opened to that width first. The base drives along
    its path with the arm at home. Then the arm moves, and rests while the gripper closes or opens.
    If the base moves in the manipulation, phases in which arm and base move are on one clock, and
    phases in which the base moves alone, between two grasps, are drives.

    Args:
        plan: A solved plan.
        robot: Robot of the plan, with its speed limits.
        speeds: Speed limits of the arm.
        step: Time between samples [s].

    Raises:
        InputError: The plan is not solved, or no trajectory keeps the limits.
    """
    if plan.motion is None or plan.base_pose is None:
        raise InputError(f"the plan is {plan.status!r}: it has no motion to export")
    motion, base, verb = plan.motion, np.array(plan.base_pose), plan.task.verb
    robot = opened_as(robot, plan.robot_rest)
    q, now = _first(motion), _Now.of(motion)
    phases: list[Phase] = []
    if robot.fully_open is not None and verb != "place":
        begin = base if plan.base_path is None else plan.base_path[0]
        phases.append(_gripper(PhaseKind.OPEN, begin, q, now))
    if plan.base_path is not None:
        phases.append(_drive(plan.base_path, q, now, robot, step))
    if verb == "place":
        phases.append(_gripper(PhaseKind.CLOSE, base, q, now))
    for part in _parts(verb, motion):
        if isinstance(part, PhaseKind):
            phases.append(_gripper(part, base, q, now))
        else:
            phases.append(_section(part, verb, base, robot, speeds, step))
            last = phases[-1]
            base = last.base[-1]
            q, now = last.positions[-1], _Now(float(last.object_q[-1]), float(last.latch_q[-1]))
    if motion.home is not None:
        section = now.rests(np.concatenate([motion.q[-1:], motion.home]))
        phases.append(_section(section, verb, base, robot, speeds, step))
    return tuple(phases)


def _first(motion: Motion) -> Float[np.ndarray, " n"]:
    return motion.approach[0] if len(motion.approach) else motion.q[0]


@dataclass(frozen=True)
class _Now:
    """Values of the object's joint and of its latch [rad] or [m]."""

    object_q: float
    latch_q: float

    @classmethod
    def of(cls, motion: Motion) -> _Now:
        """Return the values at the start of a motion."""
        return cls(float(motion.object_q[0]), float(_latch_q(motion)[0]))

    def rests(self, q: Float[np.ndarray, "m n"]) -> _Section:
        """Return a section in which only the arm moves."""
        return _Section(q, np.full(len(q), self.object_q), np.full(len(q), self.latch_q), None)


def _latch_q(motion: Motion) -> Float[np.ndarray, " m"]:
    return np.zeros(len(motion.q)) if motion.latch_q is None else motion.latch_q


@dataclass(frozen=True, eq=False)
class _Section:
    """States of the arm between two actions of the gripper."""

    q: Float[np.ndarray, "m n"]
    object_q: Float[np.ndarray, " m"]
    latch_q: Float[np.ndarray, " m"]
    Ts_world_tool: Float[np.ndarray, "m 4 4"] | None
    """None before the grasp and after the release, where the tool's speed is limited only if it
    carries an object."""
    base: Float[np.ndarray, "m 3"] | None = None
    """Poses of a base that moves; None if it stands still."""

    @property
    def base_moves(self) -> bool:
        return self.base is not None and bool(np.ptp(self.base, axis=0).max() > _MIN_MOTION)

    def cut(self) -> list[_Section]:
        """Cut a section of the free hand where the base starts or stops to move."""
        if self.base is None or len(self.q) < 2:
            return [self]
        moves = np.abs(np.diff(self.base, axis=0)).max(1) > _MIN_MOTION
        ends = [0, *(np.flatnonzero(moves[1:] != moves[:-1]) + 1).tolist(), len(self.q) - 1]
        return [self._part(slice(first, last + 1)) for first, last in pairwise(ends)]

    def _part(self, states: slice) -> _Section:
        Ts = None if self.Ts_world_tool is None else self.Ts_world_tool[states]
        base = None if self.base is None else self.base[states]
        return _Section(self.q[states], self.object_q[states], self.latch_q[states], Ts, base)


def _parts(verb: str, motion: Motion) -> list[_Section | PhaseKind]:
    """Cut the motion of the arm where the gripper closes or opens."""
    parts: list[_Section | PhaseKind] = []
    if len(motion.approach):
        parts.append(_Now.of(motion).rests(motion.approach))
    last = len(motion.q) - 1
    if verb == "pick":
        return [*parts, PhaseKind.CLOSE, _between(motion, 0, last)]
    if verb == "place":
        return [*parts, PhaseKind.OPEN, _between(motion, 0, last)]
    at = 0
    for hold in motion.grasps:
        parts += _between(motion, at, hold.first).cut() if hold.first > at else []
        parts += [PhaseKind.CLOSE, _between(motion, hold.first, hold.last), PhaseKind.OPEN]
        at = hold.last
    return [*parts, *_between(motion, at, last).cut()] if at < last else parts


def _between(motion: Motion, first: int, last: int) -> _Section:
    part = slice(first, last + 1)
    return _Section(
        motion.q[part], motion.object_q[part], _latch_q(motion)[part], motion.Ts_world_tool[part],
        None if motion.base is None else motion.base[part],
    )  # fmt: skip


def _drive(
    path: Float[np.ndarray, "k 3"], q: Float[np.ndarray, " n"], now: _Now, robot: Robot, step: float
) -> Phase:
    """Time the drive. Limits of speed and acceleration hold for the norm of x and y."""
    turned = path.copy()
    turned[:, 2] = np.unwrap(path[:, 2])
    turned[:, 2] += (
        path[-1, 2] - turned[-1, 2]
    )  # by whole turns, to end at the yaw of the arm phases
    place, base = np.pad(path[:, :2], ((0, 0), (0, 1))), limited_base_path(robot, turned, 1.0)
    timed = time_path(
        turned, base.speed, base.acceleration, step, tool=place, tool_speed=robot.max_speed
    )
    rest = np.tile(q, (len(timed), 1))
    return Phase(
        PhaseKind.DRIVE, _times(len(timed), step), timed.q, rest, np.zeros_like(rest),
        np.full(len(timed), now.object_q), np.full(len(timed), now.latch_q), path,
    )  # fmt: skip


def _section(
    part: _Section,
    verb: Verb,
    base: Float[np.ndarray, "3"],
    robot: Robot,
    speeds: SpeedConfig,
    step: float,
) -> Phase:
    if part.base is not None and part.base_moves and np.ptp(part.q, axis=0).max() < _MIN_MOTION:
        now = _Now(float(part.object_q[0]), float(part.latch_q[0]))
        return _drive(part.base, part.q[0], now, robot, step)
    if part.Ts_world_tool is None:
        motion = Motion(part.q, part.q[-1:], part.object_q[-1:], np.eye(4)[None])
        timed = time_motion(robot, motion, speeds, step, verb=verb)[0]
    else:
        motion = Motion(part.q[:0], part.q, part.object_q, part.Ts_world_tool, base=part.base)
        timed = time_motion(robot, motion, speeds, step, verb=verb)[1]
    times = _times(len(timed), step)
    values, latch = (np.interp(times, timed.state_times, v) for v in (part.object_q, part.latch_q))
    bases = np.tile(base, (len(timed), 1)) if timed.base is None else timed.base
    kind = PhaseKind.DRIVE_AND_ARM if part.base_moves else PhaseKind.ARM
    return Phase(kind, times, bases, timed.q, timed.v, values, latch)


def _gripper(
    kind: PhaseKind, base: Float[np.ndarray, "3"], q: Float[np.ndarray, " n"], now: _Now
) -> Phase:
    rest = np.tile(q, (2, 1))
    return Phase(
        kind, np.array([0.0, GRIPPER_TIME]), np.tile(base, (2, 1)), rest, np.zeros_like(rest),
        np.full(2, now.object_q), np.full(2, now.latch_q),
    )  # fmt: skip


def _times(count: int, step: float) -> Float[np.ndarray, " t"]:
    return np.arange(count) * step


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of all phases in order."""

    times: Float[np.ndarray, " t"]
    base: Float[np.ndarray, "t 3"]
    positions: Float[np.ndarray, "t n"]
    velocities: Float[np.ndarray, "t n"]
    object_q: Float[np.ndarray, " t"]
    phase: Int[np.ndarray, " t"]
    """Index of the phase of each sample."""
    latch_q: Float[np.ndarray, " t"]


def samples_of(phases: tuple[Phase, ...]) -> Samples:
    """Join phases; each begins when the one before it ends."""
    begin = np.cumsum([0.0, *(phase.times[-1] for phase in phases[:-1])])
    return Samples(
        times=np.concatenate([t + p.times for t, p in zip(begin, phases, strict=True)]),
        base=np.concatenate([phase.base for phase in phases]),
        positions=np.concatenate([phase.positions for phase in phases]),
        velocities=np.concatenate([phase.velocities for phase in phases]),
        object_q=np.concatenate([phase.object_q for phase in phases]),
        phase=np.repeat(np.arange(len(phases)), [len(phase.times) for phase in phases]),
        latch_q=np.concatenate([phase.latch_q for phase in phases]),
    )
