"""Move the tool along a path: from one base pose, from several, or while the base moves.

A path is a task like any other, whose tool poses are given. Where no base pose serves all of it, it
is cut at its breaks: each stop serves as many stretches as any, which makes the fewest stops.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .config import PipelineConfig
from .max_opening import by_samples, last_that_works
from .plan import plan_placement
from .query import PlacementQuery
from .result import PlacementResult
from .tour import Tour


def plan_path_stops(query: PlacementQuery, breaks: Sequence[int] = ()) -> Tour:
    """Return from where a robot moves its tool along a path, and how.

    Args:
        query: The question; its task has the poses of the path.
        breaks: Indices of the poses at which the tool may leave the path; ascending.

    Returns:
        One answer for each stretch, from one base pose or else the fewest that the search finds. A
        last one without a plan is for the first stretch that no base pose serves.

    Raises:
        InputError: The path jumps, or touches several objects.
        SceneError: The robot collides at its start pose.
        OutOfTimeError: The time was over.
    """
    began = query.watch.clock()
    stands = query
    if breaks:  # where many stretches are tried, samples must do
        stands = replace(query, config=by_samples(replace(query.config, base="fixed")))
    steps = [plan_placement(stands)]
    if steps[0].plan.status == "infeasible" and breaks:
        steps = _stretches(stands, breaks, steps[0], query.config)
        moves = query.config.base in ("moving", "auto")
        if moves and not steps[-1].plan.feasible and query.config.timeout > query.watch.total:
            moved = plan_placement(query)
            steps = [moved] if moved.plan.feasible else steps
    stops = tuple(range(1, 1 + len(steps)))
    seconds = query.watch.clock() - began
    return Tour(tuple(steps), stops, seconds=seconds, scenes=(query.scene,) * len(steps))


def _stretches(
    query: PlacementQuery, breaks: Sequence[int], whole: PlacementResult, thorough: PipelineConfig
) -> list[PlacementResult]:
    """Return an answer for each stretch, the longest from each stop; the last may have no plan.

    Args:
        query: The question, to be answered quickly.
        breaks: Indices of the poses at which the path may be cut.
        whole: The answer for the whole path, which has no plan.
        thorough: How to search for the shortest stretch, before there is none.
    """
    poses, start, at, failed = query.task.poses, query.start, 0, whole
    done: list[PlacementResult] = []
    ends = [*breaks, len(poses) - 1]

    def plan(index: int, config: PipelineConfig = query.config) -> PlacementResult | None:
        nonlocal failed
        task = replace(query.task, poses=poses[at : ends[index] + 1])
        answer = plan_placement(replace(query, task=task, start=start, config=config))
        if answer.plan.feasible:
            return answer
        failed = answer
        return None

    while ends:
        last = len(ends) - 1
        stop, found = last, plan(last) if done else None  # the whole path has no plan
        if found is None:
            stop, found = last_that_works(plan, -1, last, first_step=1)
        if found is None:
            stop, found = 0, plan(0, replace(thorough, base="fixed"))
        if found is None:
            return [*done, failed]
        done.append(found)
        assert found.plan.base_pose is not None
        at, start, ends = ends[stop], np.array(found.plan.base_pose), ends[stop + 1 :]
    return done
