"""Measure the tolerance of a base pose: how far off the robot may stand and still do the task."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from momapos.core import (
    Clock,
    OutOfTimeError,
    Stopwatch,
    finite_array,
    look,
    processor_time,
    time_limit,
    whole_number,
)
from momapos.core.geometry import pose_planar
from momapos.model.collision import FREE, check
from momapos.model.records import Motion, Tolerance
from momapos.planning.arm_motion import adapt_motion, arm_spheres, brief_config, with_payload
from momapos.planning.placement import BaseStatus, base_pose_status

from .base_pose_check import BasePoseChecks
from .query import PlacementQuery
from .result import PlacementResult
from .robust import unit_offsets
from .time_limit import cut_short, time_left, with_note

if TYPE_CHECKING:
    from jaxtyping import Float


Depth: TypeAlias = Literal["base", "arm", "all"]
"""How deep a pose is checked: the base alone, also an arm path in the planner's model, or all that
a plan must pass."""
MAX_REPLANNED_POSES = 12
"""Poses at which a motion is planned from scratch because no known one can be adapted; after that,
a pose where none can be adapted counts as a failure [-]."""


@dataclass(frozen=True, eq=False)
class _Known:
    """A base pose with its motion."""

    base: Float[np.ndarray, "3"]
    motion: Motion


@dataclass
class NearbyReplanner:
    """Find motions at base poses near one with a known motion."""

    checks: BasePoseChecks
    known: list[_Known]
    replanned: int = 0
    """Number of poses at which a motion was planned from scratch."""

    @classmethod
    def around(
        cls, query: PlacementQuery, base: Float[np.ndarray, "3"], motion: Motion
    ) -> NearbyReplanner:
        """Build a replanner around a base pose with a motion."""
        config = replace(query.config, planner=brief_config(query.config.planner))
        checks = BasePoseChecks(replace(query, config=config)).holding(motion)
        return cls(checks, [_Known(base, motion)])

    def failure(self, poses: Float[np.ndarray, "n 3"], depth: Depth) -> int | None:
        """Return the index of a pose without a motion; None if all poses have one.

        Args:
            poses: x [m], y [m], yaw [rad], those that fail most often first.
            depth: How deep each pose is checked.
        """
        status, _ = base_pose_status(self.checks.prepared.geometry, poses)
        blocked = np.flatnonzero(status != BaseStatus.CLEAR)
        if len(blocked):
            return int(blocked[-1])
        for index, pose in enumerate(poses if depth != "base" else ()):
            look()
            if not self._has_motion(pose, exact=depth == "all"):
                return index
        return None

    def _has_motion(self, pose: Float[np.ndarray, "3"], *, exact: bool) -> bool:
        if any(self._adapts(one, pose, exact=exact) for one in self.known):
            return True
        if self.replanned == MAX_REPLANNED_POSES:
            return False
        self.replanned += 1
        regrasps = len(self.known[0].motion.holds) > 1
        found = (self.checks if regrasps else self.checks.with_one_grasp)(pose).motion
        if found is None:
            return False
        self.known.insert(0, _Known(pose, found))
        return True

    def _adapts(self, known: _Known, pose: Float[np.ndarray, "3"], *, exact: bool) -> bool:
        prepared = self.checks.prepared
        straight = prepared.motion.grasp_step
        motion = adapt_motion(prepared.robot, known.motion, known.base, pose, straight)
        if motion is None or not self._clear(motion, pose):
            return False
        return not exact or prepared.violation(pose, motion) is None

    def _clear(self, motion: Motion, pose: Float[np.ndarray, "3"]) -> bool:
        """Return whether the arm is free in the planner's model.

        True for a motion with more than one grasp, which only the exact check judges.
        """
        prepared = self.checks.prepared
        task, robot, chain = prepared.motion, prepared.robot, prepared.robot.chain
        steps, straight = len(task.object_q), task.grasp_step
        if len(motion.holds) > 1 or straight + len(motion.q) != steps:
            return True
        carrying = task.task.verb == "place"
        q = chain.freedom_values(np.concatenate([motion.approach, motion.q]))
        approach = len(q) - steps
        spheres = robot.spheres.by_hulls
        if carrying:
            T = pose_planar(pose) @ chain.tool_poses(q[approach : approach + 1])[0]
            spheres = with_payload(robot, task, T, 0)
        bases = np.tile(pose, (len(q), 1))
        codes = check(
            prepared.world, chain, spheres, q[:approach], bases[:approach],
            np.full(approach, task.value[0]), np.full(approach, carrying),
        )  # fmt: skip
        if (codes != FREE).any():
            return False
        # Grasps and the exact check test the hand against the object that it holds.
        codes = check(
            prepared.world, chain, arm_spheres(robot), q[approach:], bases[approach:],
            task.value, task.holding,
        )  # fmt: skip
        return bool((codes == FREE).all())


Failure: TypeAlias = "Callable[[Float[np.ndarray, 'n 3'], Depth], int | None]"
"""Returns the index of an offset at which replanning fails; None if it fails at none."""
RADII = (0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.125, 0.15)
"""Radii of the discs that are tried, smallest first [m]."""
SAMPLES = 100
"""Poses per disc: if none fails, at least 97 % of the disc works with 95 % confidence [-]."""
MAX_SAMPLES = 100_000
"""Limit on the poses per disc, which bounds the work of one call [-]."""
NUM_FARTHEST = 24
"""Farthest poses of a disc, at which the arm is checked before the others [-]."""
TURN_PER_RADIUS = float(np.radians(0.6) / 0.01)
"""Maximum turn of the base, per meter of the disc's radius [rad/m]."""


def tolerance_at(
    query: PlacementQuery,
    base_pose: Float[np.ndarray, "3"] | Sequence[float],
    *,
    samples: int = SAMPLES,
) -> Tolerance:
    """Find the largest disc and turn around a base pose in which replanning succeeds.

    Replanning is tried from poses drawn evenly in a disc, turned by at most 0.6 deg per cm of its
    radius. A disc of 5 mm to 15 cm counts if replanning succeeds from all of them, and each motion
    passes the exact check.

    Args:
        query: The question; its start and region are ignored.
        base_pose: x [m], y [m], yaw [rad].
        samples: Number of poses in a disc [-].

    Raises:
        TaskError: The gripper cannot hold the object.
        RobotError: The robot and the task do not fit together.
        InputError: An argument has the wrong type, shape or range.
    """
    samples = whole_number("samples", samples, 1, MAX_SAMPLES)
    base = finite_array("base_pose", base_pose, (3,))
    query = replace(query, watch=Stopwatch(lambda: 0.0))
    motion = BasePoseChecks(query)(base).motion
    if motion is None:
        return Tolerance(0.0, 0.0, samples)
    return measured_tolerance(query, base, motion, samples=samples)


def measured_tolerance(
    query: PlacementQuery,
    base: Float[np.ndarray, "3"],
    motion: Motion,
    *,
    samples: int = SAMPLES,
) -> Tolerance:
    """Measure the tolerance of a base pose whose motion is known.

    Args:
        query: The question, with the task that the motion does.
        base: x [m], y [m], yaw [rad].
        motion: A motion there that the exact check accepts.
        samples: Number of poses in a disc [-].
    """
    samples = whole_number("samples", samples, 1, MAX_SAMPLES)
    replanner = NearbyReplanner.around(query, base, motion)
    unit = unit_offsets(samples, np.random.default_rng(query.seed))
    radius = largest_radius(unit, lambda offsets, depth: replanner.failure(base + offsets, depth))
    return Tolerance(radius, radius * TURN_PER_RADIUS, samples)


def with_tolerance(
    answer: PlacementResult, *, samples: int = SAMPLES, clock: Clock = processor_time
) -> PlacementResult:
    """Return an answer with the tolerance in its plan, and the time that this took.

    The time limit of the answer includes it; if it ends the measurement, the plan has no tolerance
    and a note says so.

    Args:
        answer: An answer; returned unchanged if it has no motion, has its tolerance already, or
            moves its base in the manipulation: replanning is measured for one base pose only.
        samples: Number of poses in a disc [-].
        clock: Measures the time, which is not part of the plan's total. An exception that it
            raises ends the work.
    """
    plan, query = answer.plan, answer.query
    known = plan.tolerance is not None or plan.moves_base
    if known or plan.motion is None or query is None:
        return answer
    watch, base = Stopwatch(clock), np.array(plan.base_pose, float)
    query, found = replace(query, task=plan.task, watch=Stopwatch(clock)), None
    left = time_left(plan, query.config.timeout)
    with watch.stage("tolerance"), suppress(OutOfTimeError), time_limit(left, clock):
        found = measured_tolerance(query, base, plan.motion, samples=samples)
    timing = {**plan.timing, "tolerance": watch.timing["tolerance"]}
    answer = replace(answer, plan=replace(plan, tolerance=found, timing=timing))
    return answer if found else with_note(answer, cut_short("the measurement of the tolerance"))


def largest_radius(unit: Float[np.ndarray, "n 3"], failure: Failure) -> float:
    """Return the largest of `RADII` in whose disc no pose fails [m]; 0 if one fails in each disc.

    Cheap checks of all poses come first, then the arm at the farthest poses, which fail most
    often. The remaining disc is checked in full. A disc with a failed pose never counts.

    Args:
        unit: Offsets in the unit disc, with turns from -1 to 1.
        failure: Finds an offset that fails.
    """
    level = np.maximum(np.hypot(unit[:, 0], unit[:, 1]), np.abs(unit[:, 2]))
    order = np.argsort(-level, kind="stable")
    unit, level = unit[order], level[order]

    def within(count: int, depth: Depth) -> int:
        """Return how many discs, smallest first, exclude the offset that fails in disc `count`."""
        radius = RADII[count - 1]
        some = unit if depth != "arm" else unit[:NUM_FARTHEST]
        index = failure(some * radius * [1.0, 1.0, TURN_PER_RADIUS], depth)
        return count if index is None else bisect_left(RADII, level[index] * radius)

    most = len(RADII)
    while most and (left := within(most, "base")) < most:
        most = left
    known = 0
    while known < most:
        middle = (known + most + 1) // 2
        left = within(middle, "arm")
        known, most = (middle, most) if left == middle else (min(known, left), left)
    while most and (left := within(most, "all")) < most:
        most = left
    return RADII[most - 1] if most else 0.0
