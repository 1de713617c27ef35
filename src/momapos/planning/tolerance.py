"""How far beside a base pose the robot may stand, and still do it."""

from __future__ import annotations

import time
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import Clock, InputError, Stopwatch
from momapos.model.records import Motion, Task, Tolerance
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.reachability import load_reach

from .base_pose_check import BasePoseChecks
from .config import PipelineConfig
from .query import PlacementQuery
from .replan_nearby import Depth, FoundAnew
from .result import PlacementResult
from .robust import unit_offsets

if TYPE_CHECKING:
    from pathlib import Path

    from jaxtyping import Float

    from momapos.model.records import ReachScorer

DEFAULT = PipelineConfig()
Failure: TypeAlias = "Callable[[Float[np.ndarray, 'n 3'], Depth], int | None]"
"""Index of one of some offsets that fails; None where none does."""
RADII = (0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.125, 0.15)
"""Radii of discs that are asked about, smallest first [m]."""
SAMPLES = 100
"""Where so many poses work and none fails, at least 97 % do at a confidence of 95 % [-]."""
FIRST = 24
"""Of the poses in a disc, the farthest, at which the arm is asked first [-]."""
TURN = float(np.radians(0.6) / 0.01)
"""How far it is turned at most, for each meter of the radius [rad/m]."""


def placement_tolerance(
    scene: Scene,
    robot: Robot,
    task: Task,
    base_pose: Float[np.ndarray, "3"] | Sequence[float],
    reach: ReachScorer | None = None,
    *,
    samples: int = SAMPLES,
    config: PipelineConfig = DEFAULT,
    cache_dir: Path | None = None,
    seed: int = 0,
) -> Tolerance:
    """Find the largest disc and turn around a base pose from which the motion is found anew.

    At poses drawn evenly in a disc, turned by at most 0.6 deg for each cm of its radius, a motion
    is looked for that the exact check accepts, see `FoundAnew`. A disc of 5 mm to 15 cm counts
    where one is found at all of them.

    Args:
        scene: The room.
        robot: The robot.
        task: What is to be done, see `make_task`.
        base_pose: x [m], y [m], yaw [rad].
        reach: The robot's reachability map; None to load it, or to build it at the first use.
        samples: Poses in a disc [-].
        config: How to plan.
        cache_dir: Where maps are kept; the user's cache folder by default.
        seed: Same seed, same poses.

    Raises:
        TaskError: The gripper cannot hold the object.
        RobotError: The robot and the task do not fit together.
        InputError: There are no samples.
    """
    if samples < 1:
        raise InputError(f"samples must be at least 1, not {samples}")
    if reach is None:
        reach = load_reach(robot, cache_dir)
    query = PlacementQuery(
        scene, robot, task, reach, None, None, config, seed, Stopwatch(lambda: 0.0)
    )
    base = np.asarray(base_pose, float)
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
    """The same around a base pose whose motion is known.

    Args:
        query: What was asked, with the task that the motion does.
        base: x [m], y [m], yaw [rad].
        motion: A motion there that the exact check accepts.
        samples: Poses in a disc [-].
    """
    if samples < 1:
        raise InputError(f"samples must be at least 1, not {samples}")
    anew = FoundAnew.around(query, base, motion)
    unit = unit_offsets(samples, np.random.default_rng(query.seed))
    radius = largest_radius(unit, lambda offsets, how: anew.failure(base + offsets, how))
    return Tolerance(radius, radius * TURN, samples)


def with_tolerance(
    answer: PlacementResult, *, samples: int = SAMPLES, clock: Clock = time.perf_counter
) -> PlacementResult:
    """The same answer, its plan with the tolerance, and with the time that this took.

    Args:
        answer: An answer of the pipeline; unchanged where it has no motion, or its tolerance.
        samples: Poses in a disc [-].
        clock: Measures the time, which is not in the plan's total; what it raises ends the work.
    """
    plan, query = answer.plan, answer.query
    if plan.tolerance is not None or plan.motion is None or query is None:
        return answer
    watch, base = Stopwatch(clock), np.array(plan.base_pose, float)
    asked = replace(query, task=plan.task, watch=watch)
    with watch.stage("tolerance"):
        found = measured_tolerance(asked, base, plan.motion, samples=samples)
    timing = {**plan.timing, "tolerance": watch.timing["tolerance"]}
    return replace(answer, plan=replace(plan, tolerance=found, timing=timing))


def largest_radius(unit: Float[np.ndarray, "n 3"], failure: Failure) -> float:
    """The largest of `RADII` in whose disc nothing fails [m]; 0 where something does in all.

    What costs little is asked of all poses first, then the arm at the farthest of them, which fail
    most; the disc that is left is looked at in full. No disc counts in which any pose has failed.

    Args:
        unit: Offsets in the unit disc, with turns from -1 to 1.
        failure: Finds an offset that fails.
    """
    level = np.maximum(np.hypot(unit[:, 0], unit[:, 1]), np.abs(unit[:, 2]))
    order = np.argsort(-level, kind="stable")
    unit, level = unit[order], level[order]

    def within(count: int, how: Depth) -> int:
        """How many discs, smallest first, hold no offset of one disc that fails."""
        radius = RADII[count - 1]
        some = unit if how != "arm" else unit[:FIRST]
        index = failure(some * radius * [1.0, 1.0, TURN], how)
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
