"""Answers one after the other, for those who have more to ask of a base pose than we know."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Clock, InputError, Stopwatch
from momapos.model.records import ANYWHERE, BaseRegion, ReachScorer, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.grasps import task_motion
from momapos.planning.placement import OURS, PoseFilter, search_every
from momapos.planning.reachability import load_reach

from .config import PipelineConfig
from .plan import answer
from .query import PlacementQuery
from .result import PlacementResult
from .search_setup import ready_search

if TYPE_CHECKING:
    from jaxtyping import Float

DEFAULT = PipelineConfig()


def iter_placements(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer | None = None,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    pose_filter: PoseFilter | None = None,
    region: BaseRegion = ANYWHERE,
    config: PipelineConfig = DEFAULT,
    cache_dir: Path | None = None,
    seed: int = 0,
    clock: Clock = time.perf_counter,
) -> Iterator[PlacementResult]:
    """Answer again and again where the robot may stand, and how it moves, to do a task.

    The first answer is that of `plan_base_placement`. The others come in rounds, each in the
    order of driving length and of more base poses than the one before, the last a grid; all
    objects are modeled for them, and each does the task in one hold; of a task that needs two the
    first answer is the only one. It ends where no base pose is left, where it is closed, or when
    the time of `config.timeout` is over; what the caller does between two answers does not count.

    Args:
        scene: The room.
        robot: The mobile manipulator.
        task: What is to be done, see `make_task`; to a value, not as far as possible.
        reach: The robot's reachability map; None to load it, or to build it at the first use.
        start: Where the base is now: x [m], y [m], yaw [rad]; the scene's start by default.
        pose_filter: Rules base poses out.
        region: Where the base is allowed to stand.
        config: How to search.
        cache_dir: Where maps are kept; the user's cache folder by default.
        seed: Same seed, same answers.
        clock: Measures the timeout.

    Yields:
        Solved answers alone; none where the task is infeasible, for which `plan_base_placement`
        gives the reasons.

    Raises:
        SceneError: The start is no free pose.
        TaskError: The gripper cannot hold the object.
        InputError: The task asks for as far as possible, or the configuration for another method.
    """
    if config.place.method not in OURS:
        raise InputError(f"iter_placements searches by 'ours', not by {config.place.method!r}")
    if task.farthest:
        raise InputError("iter_placements needs a value; plan_base_placement finds the farthest")
    away = 0.0  # with the caller [s]
    watch = Stopwatch(lambda: clock() - away)
    if reach is None:
        reach = load_reach(robot, cache_dir)
    query = PlacementQuery(
        scene, robot, task, reach, start, pose_filter, config, seed, watch, region=region
    )
    first = answer(query)
    if first.plan.status != "solved":
        return
    left = clock()
    yield first
    away += clock() - left
    motion = task_motion(scene, robot, task, config.motion)
    ready = ready_search(query, scene, motion)
    for found in search_every(ready.problem, config.place, np.random.default_rng(seed)):
        result = ready.result(replace(found))
        if result.plan.base_pose == first.plan.base_pose:
            continue
        result = replace(result, plan=replace(result.plan, timing=watch.timing))
        left = clock()
        yield result
        away += clock() - left
