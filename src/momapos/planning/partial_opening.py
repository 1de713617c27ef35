"""Find how far a part can be moved if it cannot be moved to the task's value."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

from momapos.core import Clock, OutOfTimeError, Stopwatch, processor_time, time_limit
from momapos.planning.grasps import slides
from momapos.verification import meets_floor_at

from .max_opening import values_per_waypoint
from .max_opening_plan import MIN_TIMEOUT, find_max_opening, values_short_of
from .opening_by_use import reached_by_use
from .plan import plan_to_value
from .query import PlacementQuery
from .result import PlacementResult
from .time_limit import FARTHEST, cut_short, time_left


def with_max_opening(answer: PlacementResult, *, clock: Clock = processor_time) -> PlacementResult:
    """Add to an infeasible answer how far the part can be moved, and from which base pose.

    The value is in whole degrees or centimeters, and a plan to it exists. It is sure where the part
    itself is blocked at the next value. The time limit of the answer includes this search; a
    note says if it ended the search.

    If the query allows several stops or a moving base, notes say how far each use of the base moves
    the part and what stops it. The value then is the largest of theirs, to an eighth of the way.

    Args:
        answer: The answer; returned unchanged unless it is infeasible, moves a joint and has its
            query.
        clock: Measures the time.
    """
    plan, query = answer.plan, answer.query
    if query is None or plan.status != "infeasible" or plan.task.joint is None:
        return answer
    config, watch = query.config, Stopwatch(clock)
    query = replace(query, task=plan.task, watch=watch)
    limit = time_left(plan, config.timeout)
    words: list[str] = []
    best, sure = None, False
    with suppress(OutOfTimeError), time_limit(limit, clock):
        if config.base == "fixed":
            best, sure = _largest(query, limit)
        else:
            every = reached_by_use(
                replace(query, config=replace(config, timeout=limit)), answer, _from_one_pose
            )
            best = max(every, key=lambda one: one.way).best
            words = [str(one) for one in every]
    late = watch.total > limit - MIN_TIMEOUT
    words += [cut_short("the search for a smaller value")] if late else []
    plan = replace(plan, timing={**plan.timing, FARTHEST: watch.total}, notes=(*plan.notes, *words))
    if best is not None:
        plan = replace(
            plan,
            feasible_to=best.plan.task.to,
            feasible_from=best.plan.base_pose,
            feasible_sure=sure,
        )
    return replace(answer, plan=plan)


def _largest(query: PlacementQuery, limit: float) -> tuple[PlacementResult | None, bool]:
    """Return the answer for the largest value from one base pose, and whether no larger one works.

    Args:
        query: The question.
        limit: Time limit [s].
    """
    task, config, scene = query.task, query.config, query.scene
    waypoint = values_per_waypoint(config.motion, slides=slides(scene, task))
    values = values_short_of(query)
    best, sure = find_max_opening(query, plan_to_value, values, within=waypoint, timeout=limit)
    if best is not None and task.joint is not None:
        # The values end where the part meets the floor, or before the goal, which is infeasible.
        to, target = best.plan.task.to, scene.object(task.object)
        sure |= (
            bool(to == values[-1])
            and meets_floor_at(target, task.joint, task.to or 0.0) is not None
        )
    return best, sure


def _from_one_pose(query: PlacementQuery) -> PlacementResult:
    return plan_to_value(replace(query, config=replace(query.config, base="fixed")))
