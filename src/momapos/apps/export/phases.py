"""Split a plan into timed phases: drive, move the arm, close or open the gripper."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.model import DEFAULT, SpeedConfig, time_motion, time_path
from momapos.model.records import Hold, Motion, PlacementPlan, Verb
from momapos.model.robots import Robot

if TYPE_CHECKING:
    from jaxtyping import Float, Int

GRIPPER_TIME = 1.0
"""Time for a gripper to close or open [s]."""
STEP = 0.02
"""Time between samples [s]."""


class PhaseKind(StrEnum):
    """Kind of a phase; the values are written to files."""

    DRIVE = "drive"
    ARM = "arm"
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


def phases_of(
    plan: PlacementPlan, robot: Robot, speeds: SpeedConfig = DEFAULT, *, step: float = STEP
) -> tuple[Phase, ...]:
    """Return the phases of a solved plan, in order.

    The base drives along its path with the arm at home. Then the arm moves, and rests while the
    gripper closes or opens.

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
    phases = [] if plan.base_path is None else [_drive(plan.base_path, motion, robot, step)]
    q, value = _first(motion), float(motion.object_q[0])
    if verb == "place":
        phases.append(_gripper(PhaseKind.CLOSE, base, q, value))
    for part in _parts(verb, motion):
        if isinstance(part, PhaseKind):
            phases.append(_gripper(part, base, q, value))
        else:
            phases.append(_arm(part, verb, base, robot, speeds, step))
            q, value = phases[-1].positions[-1], float(phases[-1].object_q[-1])
    if motion.home is not None:
        back = np.concatenate([motion.q[-1:], motion.home])
        section = _Section(back, np.full(len(back), value), None)
        phases.append(_arm(section, verb, base, robot, speeds, step))
    return tuple(phases)


def _first(motion: Motion) -> Float[np.ndarray, " n"]:
    return motion.approach[0] if len(motion.approach) else motion.q[0]


@dataclass(frozen=True, eq=False)
class _Section:
    """States of the arm between two actions of the gripper."""

    q: Float[np.ndarray, "m n"]
    object_q: Float[np.ndarray, " m"]
    Ts_world_tool: Float[np.ndarray, "m 4 4"] | None
    """None before the grasp and after the release, where the tool's speed is limited only if it
    carries an object."""


def _parts(verb: str, motion: Motion) -> list[_Section | PhaseKind]:
    """Cut the motion of the arm where the gripper closes or opens."""
    parts: list[_Section | PhaseKind] = []
    if len(motion.approach):
        rest = np.full(len(motion.approach), motion.object_q[0])
        parts.append(_Section(motion.approach, rest, None))
    last = len(motion.q) - 1
    if verb == "pick":
        return [*parts, PhaseKind.CLOSE, _between(motion, 0, last)]
    if verb == "place":
        return [*parts, PhaseKind.OPEN, _between(motion, 0, last)]
    at = 0
    for hold in motion.holds or (Hold(0, last),):
        parts += [_between(motion, at, hold.first)] if hold.first > at else []
        parts += [PhaseKind.CLOSE, _between(motion, hold.first, hold.last), PhaseKind.OPEN]
        at = hold.last
    return [*parts, _between(motion, at, last)] if at < last else parts


def _between(motion: Motion, first: int, last: int) -> _Section:
    part = slice(first, last + 1)
    return _Section(motion.q[part], motion.object_q[part], motion.Ts_world_tool[part])


def _drive(path: Float[np.ndarray, "k 3"], motion: Motion, robot: Robot, step: float) -> Phase:
    """Time the drive. Limits of speed and acceleration hold for the norm of x and y."""
    apart = robot.max_acceleration / np.sqrt(2.0)  # in x and in y, so that both together keep it
    speed = np.array([robot.max_speed, robot.max_speed, robot.max_yaw_rate])
    limit = np.array([apart, apart, robot.max_yaw_acceleration])
    turned = path.copy()
    turned[:, 2] = np.unwrap(path[:, 2])
    turned[:, 2] += (
        path[-1, 2] - turned[-1, 2]
    )  # by whole turns, to end at the yaw of the arm phases
    place = np.pad(path[:, :2], ((0, 0), (0, 1)))
    timed = time_path(turned, speed, limit, step, tool=place, tool_speed=robot.max_speed)
    rest = np.tile(_first(motion), (len(timed), 1))
    return Phase(
        PhaseKind.DRIVE, _times(len(timed), step), timed.q, rest, np.zeros_like(rest),
        np.full(len(timed), motion.object_q[0]),
    )  # fmt: skip


def _arm(
    part: _Section,
    verb: Verb,
    base: Float[np.ndarray, "3"],
    robot: Robot,
    speeds: SpeedConfig,
    step: float,
) -> Phase:
    if part.Ts_world_tool is None:
        motion = Motion(part.q, part.q[-1:], part.object_q[-1:], np.eye(4)[None])
        timed = time_motion(robot, motion, speeds, step, verb=verb)[0]
    else:
        motion = Motion(part.q[:0], part.q, part.object_q, part.Ts_world_tool)
        timed = time_motion(robot, motion, speeds, step, verb=verb)[1]
    times = _times(len(timed), step)
    values = np.interp(times, timed.state_times, part.object_q)
    bases = np.tile(base, (len(timed), 1))
    return Phase(PhaseKind.ARM, times, bases, timed.q, timed.v, values)


def _gripper(
    kind: PhaseKind, base: Float[np.ndarray, "3"], q: Float[np.ndarray, " n"], object_q: float
) -> Phase:
    rest = np.tile(q, (2, 1))
    return Phase(
        kind, np.array([0.0, GRIPPER_TIME]), np.tile(base, (2, 1)), rest, np.zeros_like(rest),
        np.full(2, object_q),
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
    )
