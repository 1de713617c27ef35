"""Yield several answers to a query, for callers with conditions of their own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from momapos.core import InputError, OutOfTimeError, Stopwatch
from momapos.planning.grasps import task_motion
from momapos.planning.placement import OURS, iter_searches

from .plan import plan_to_value
from .query import PlacementQuery
from .result import PlacementResult
from .search_setup import prepare_search


def placements(query: PlacementQuery) -> Iterator[PlacementResult]:
    """Yield one answer after the other: where the robot may stand, and how it moves.

    The first answer is that of `plan_placement`. The others come in rounds. Each round is ordered
    by driving length and samples more base poses than the one before; the last is a grid. All
    objects are modeled for them, and the task is done with one grasp; if it needs two, the first
    answer is the only one. The iteration ends when no base pose is left or after `config.timeout`;
    the time that the caller spends between two answers does not count.

    Args:
        query: The question; its task must name a value.

    Yields:
        Answers with a plan; none if the task is infeasible, for which `plan_placement` gives
            reasons.

    Raises:
        SceneError: The robot collides at its start pose.
        TaskError: The gripper cannot hold the object.
        InputError: The task requests the maximum, or the configuration another method.
    """
    task, config = query.task, query.config
    if config.place.method not in OURS:
        raise InputError(f"iter_placements searches by 'ours', not by {config.place.method!r}")
    if task.farthest:
        raise InputError("iter_placements needs a value; plan_base_placement finds the farthest")
    away = 0.0  # time spent by the caller [s]
    clock = query.watch.clock
    watch = Stopwatch(lambda: clock() - away)
    query = replace(query, watch=watch)
    first = plan_to_value(query)
    if not first.plan.feasible:
        return
    query = replace(query, robot=first.prepared.robot)  # its hand may be less open
    others = _others(query, first)
    answer: PlacementResult | None = first
    while answer is not None:
        left = clock()
        yield answer
        away += clock() - left
        answer = None
        with suppress(OutOfTimeError), query.in_time():
            answer = next(others, None)


def _others(query: PlacementQuery, first: PlacementResult) -> Iterator[PlacementResult]:
    """Yield the answers with one grasp, except at the base pose of the first answer."""
    scene, config = query.scene, query.config
    motion = task_motion(scene, query.robot, query.task, config.motion)
    ready = prepare_search(query, scene, motion)
    for found in iter_searches(ready.problem, config.place, np.random.default_rng(query.seed)):
        result = ready.result(replace(found))
        if result.plan.base_pose != first.plan.base_pose:
            yield replace(result, plan=replace(result.plan, timing=query.watch.timing))
