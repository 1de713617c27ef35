"""Measure the tolerance of a base pose: how far off the robot may stand and still do the task."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import (
    Clock,
    OutOfTimeError,
    Stopwatch,
    finite_array,
    processor_time,
    time_limit,
    whole_number,
)
from momapos.model.records import Motion, Tolerance

from .base_pose_check import BasePoseChecks
from .query import PlacementQuery
from .replan_nearby import Depth, NearbyReplanner
from .result import PlacementResult
from .robust import unit_offsets
from .time_limit import cut_short, time_left, with_note

if TYPE_CHECKING:
    from jaxtyping import Float


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
