"""Move the tool along a path: from one base pose, from several, or while the base moves.

A path is a task like any other, whose tool poses are given. Where no base pose serves all of it, it
is cut at its breaks: each stop serves as many stretches as any, which makes the fewest stops.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

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
        steps = _stretches(stands, breaks, steps[0])
        moves = query.config.base in ("moving", "auto")
        if moves and not steps[-1].plan.feasible and query.config.timeout > query.watch.total:
            moved = plan_placement(query)
            steps = [moved] if moved.plan.feasible else steps
    stops = tuple(range(1, 1 + len(steps)))
    seconds = query.watch.clock() - began
    return Tour(tuple(steps), stops, seconds=seconds, scenes=(query.scene,) * len(steps))


def _stretches(
    query: PlacementQuery, breaks: Sequence[int], whole: PlacementResult
) -> list[PlacementResult]:
    """Return an answer for each stretch, the longest from each stop; the last may have no plan."""
    poses, start, at = query.task.poses, query.start, 0
    last, done = len(poses) - 1, list[PlacementResult]()
    while at < last:
        ends = [k for k in (*breaks, last) if k > at]
        failed: PlacementResult | None = None

        def plan(index: int) -> PlacementResult | None:
            nonlocal failed
            task = replace(query.task, poses=poses[at : ends[index] + 1])  # noqa: B023
            answer = plan_placement(replace(query, task=task, start=start))  # noqa: B023
            failed = failed if answer.plan.feasible else answer
            return answer if answer.plan.feasible else None

        found = plan(len(ends) - 1) if done else None
        stop = len(ends) - 1
        if found is None:
            stop, found = last_that_works(plan, -1, len(ends) - 1, first_step=1)
        if found is None:
            return [*done, failed or whole]
        done.append(found)
        assert found.plan.base_pose is not None
        at, start = ends[stop], np.array(found.plan.base_pose)
    return done
