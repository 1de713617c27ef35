"""A plan as phases over time: drive, move the arm, close or open the gripper."""

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
"""A gripper gets this long to close or open [s]."""
STEP = 0.02


class PhaseKind(StrEnum):
    """What happens in a phase; the words stand in files."""

    DRIVE = "drive"
    ARM = "arm"
    CLOSE = "close_gripper"
    OPEN = "open_gripper"


@dataclass(frozen=True)
class Phase:
    """A stretch of a plan that begins and ends at rest."""

    kind: PhaseKind
    times: Float[np.ndarray, " t"]
    """[s], from the beginning of the phase."""
    base: Float[np.ndarray, "t 3"]
    """x [m], y [m], yaw [rad] of the base on the floor."""
    positions: Float[np.ndarray, "t n"]
    """Of the joints that the plan names [rad] or [m]."""
    velocities: Float[np.ndarray, "t n"]
    object_q: Float[np.ndarray, " t"]
    """Value of the object's joint [rad] or [m]; zeros where the task has none."""

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.times[-1])


def phases_of(
    plan: PlacementPlan, robot: Robot, speeds: SpeedConfig = DEFAULT, *, step: float = STEP
) -> tuple[Phase, ...]:
    """The phases of a solved plan, in order.

    The base drives along its path with its arm at home; then the arm moves, and comes to rest
    wherever the gripper closes or opens.

    Args:
        plan: A solved plan of this robot.
        robot: Its speed limits count.
        speeds: How fast the arm moves.
        step: Time between samples [s].

    Raises:
        InputError: The plan is not solved, or no trajectory keeps the limits.
    """
    if plan.motion is None or plan.base_pose is None:
        raise InputError(f"the plan is {plan.status!r}: it holds no motion to export")
    motion, base = plan.motion, np.array(plan.base_pose)
    phases = [] if plan.base_path is None else [_drive(plan.base_path, motion, robot, step)]
    q, value = _first(motion), float(motion.object_q[0])
    if plan.task.verb == "place":
        phases.append(_gripper(PhaseKind.CLOSE, base, q, value))
    for part in _parts(plan.task.verb, motion):
        if isinstance(part, PhaseKind):
            phases.append(_gripper(part, base, q, value))
        else:
            phases.append(_arm(part, plan.task.verb, base, robot, speeds, step))
            q, value = phases[-1].positions[-1], float(phases[-1].object_q[-1])
    if motion.home is not None:
        back = np.concatenate([motion.q[-1:], motion.home])
        rest = np.full(len(back), value)
        way = _Stretch(back, rest, None)
        phases.append(_arm(way, plan.task.verb, base, robot, speeds, step))
    return tuple(phases)


def _first(motion: Motion) -> Float[np.ndarray, " n"]:
    return motion.approach[0] if len(motion.approach) else motion.q[0]


@dataclass(frozen=True)
class _Stretch:
    """States of the arm between two actions of the gripper."""

    q: Float[np.ndarray, "m n"]
    object_q: Float[np.ndarray, " m"]
    Ts_world_tool: Float[np.ndarray, "m 4 4"] | None
    """None on the way to the object, where the tool's speed is limited only if it carries one."""


def _parts(verb: str, motion: Motion) -> list[_Stretch | PhaseKind]:
    """The arm's motion, cut where the gripper closes or opens."""
    parts: list[_Stretch | PhaseKind] = []
    if len(motion.approach):
        rest = np.full(len(motion.approach), motion.object_q[0])
        parts.append(_Stretch(motion.approach, rest, None))
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


def _between(motion: Motion, first: int, last: int) -> _Stretch:
    """The states from one to another, both included."""
    part = slice(first, last + 1)
    return _Stretch(motion.q[part], motion.object_q[part], motion.Ts_world_tool[part])


def _drive(path: Float[np.ndarray, "k 3"], motion: Motion, robot: Robot, step: float) -> Phase:
    speed = np.array([robot.max_speed, robot.max_speed, robot.max_yaw_rate])
    limit = np.array([robot.max_acceleration, robot.max_acceleration, robot.max_yaw_acceleration])
    turned = path.copy()
    turned[:, 2] = np.unwrap(path[:, 2])
    turned[:, 2] += path[-1, 2] - turned[-1, 2]  # whole turns: the arm's phases begin at its end
    timed = time_path(turned, speed, limit, step)
    rest = np.tile(_first(motion), (len(timed), 1))
    return Phase(
        PhaseKind.DRIVE, _times(len(timed), step), timed.q, rest, np.zeros_like(rest),
        np.full(len(timed), motion.object_q[0]),
    )  # fmt: skip


def _arm(
    part: _Stretch,
    verb: Verb,
    base: Float[np.ndarray, "3"],
    robot: Robot,
    speeds: SpeedConfig,
    step: float,
) -> Phase:
    none = part.q[:0]
    if part.Ts_world_tool is None:
        whole = Motion(part.q, part.q[-1:], part.object_q[-1:], np.eye(4)[None])
        timed = time_motion(robot, whole, speeds, step, verb=verb)[0]
    else:
        whole = Motion(none, part.q, part.object_q, part.Ts_world_tool)
        timed = time_motion(robot, whole, speeds, step, verb=verb)[1]
    times = _times(len(timed), step)
    values = np.interp(times, timed.state_times, part.object_q)
    stands = np.tile(base, (len(timed), 1))
    return Phase(PhaseKind.ARM, times, stands, timed.q, timed.v, values)


def _gripper(
    kind: PhaseKind, base: Float[np.ndarray, "3"], q: Float[np.ndarray, " n"], object_q: float
) -> Phase:
    """The gripper closes or opens, and all else rests."""
    rest = np.tile(q, (2, 1))
    return Phase(
        kind, np.array([0.0, GRIPPER_TIME]), np.tile(base, (2, 1)), rest, np.zeros_like(rest),
        np.full(2, object_q),
    )  # fmt: skip


def _times(count: int, step: float) -> Float[np.ndarray, " t"]:
    return np.arange(count) * step


@dataclass(frozen=True)
class Samples:
    """All phases one after the other."""

    times: Float[np.ndarray, " t"]
    base: Float[np.ndarray, "t 3"]
    positions: Float[np.ndarray, "t n"]
    velocities: Float[np.ndarray, "t n"]
    object_q: Float[np.ndarray, " t"]
    phase: Int[np.ndarray, " t"]
    """Index of the phase that each sample is of."""


def samples_of(phases: tuple[Phase, ...]) -> Samples:
    """Join phases; where one ends the next begins."""
    begin = np.cumsum([0.0, *(phase.duration for phase in phases[:-1])])
    return Samples(
        times=np.concatenate([t + p.times for t, p in zip(begin, phases, strict=True)]),
        base=np.concatenate([phase.base for phase in phases]),
        positions=np.concatenate([phase.positions for phase in phases]),
        velocities=np.concatenate([phase.velocities for phase in phases]),
        object_q=np.concatenate([phase.object_q for phase in phases]),
        phase=np.repeat(np.arange(len(phases)), [len(phase.times) for phase in phases]),
    )
