"""Plan the maximum opening of a part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import OutOfTimeError, Stopwatch
from momapos.planning.grasps import slides
from momapos.planning.placement import Method
from momapos.verification import meets_floor_at

from .config import PipelineConfig
from .max_opening import farthest_answer, last_of_all, values_before, values_per_waypoint
from .query import PlacementQuery
from .result import PlacementResult
from .time_limit import cut_short, unless_late, with_note

if TYPE_CHECKING:
    from jaxtyping import Float

Answer: TypeAlias = "Callable[[PlacementQuery], PlacementResult]"
_SAME = 1e-9
"""Values that differ by less are the same [rad] or [m]."""
MIN_TIMEOUT = 0.001
"""Searches start only with more time left than this [s]."""


def plan_max_opening(query: PlacementQuery, answer: Answer) -> PlacementResult:
    """Return the answer for the largest value up to the task's that has one.

    Args:
        query: The question.
        answer: Answers it for the value that a task names.
    """
    task, config, watch = query.task, query.config, query.watch
    assert task.to is not None
    at_once = _answer_to(query, answer, task.to, by_samples(config))
    if at_once.plan.feasible:
        best, sure = at_once, True
    else:
        values = np.append(values_short_of(query), task.to)
        found, sure = find_max_opening(query, answer, values, within=1, timeout=config.timeout)
        if found is not None and found.plan.task.to == task.to:
            sure = True
        left = max(config.timeout - watch.total, MIN_TIMEOUT)
        whole, how = task.to, replace(config, timeout=left)
        best = found or unless_late(lambda: _answer_to(query, answer, whole, how), at_once)
    known = replace(best.plan.task, farthest=sure and best.plan.feasible)
    best = replace(best, plan=replace(best.plan, task=known, timing=watch.timing))
    late = watch.total > config.timeout - MIN_TIMEOUT
    if late and best.plan.feasible and not sure:
        return with_note(best, cut_short("the search for the largest value"))
    return best


def find_max_opening(
    query: PlacementQuery,
    answer: Answer,
    values: Float[np.ndarray, " k"],
    *,
    within: int,
    timeout: float,
) -> tuple[PlacementResult | None, bool]:
    """Find the largest value for which there is a plan.

    The search of base poses is not complete, and may find a value and miss a smaller one. So every
    value beyond the largest one that bisection finds is tried as if the user had requested it: what
    the same seed solves when it is requested directly is never more than the result. Only the time
    limit ends the tries early.

    Args:
        query: The question; the value of its task does not count.
        answer: Answers it for the value that a task names.
        values: The values in opening order [rad] or [m].
        within: Maximum number of values between the answer and one that the grid excludes [-].
        timeout: Time limit, counted by the query's stopwatch from its start [s].

    Returns:
        The answer for that value, if any has one, and whether it is proved that there is no
        larger one: the part itself is blocked at the next value.
    """
    config, stopped = query.config, np.inf
    excluded: set[float] = set()

    def evaluate(value: float, thorough: bool) -> PlacementResult | None:
        nonlocal stopped
        left = timeout - query.watch.total
        is_excluded = value in excluded or abs(value - values[0]) > stopped - _SAME
        if left < MIN_TIMEOUT or is_excluded:
            return None
        how = replace(config if thorough else by_samples(config), timeout=left)
        try:
            result = _answer_to(query, answer, value, how)
        except OutOfTimeError:
            return None
        if result.prepared.blocked:
            stopped = min(stopped, abs(value - values[0]))
        if result.plan.feasible:
            return result
        if thorough:
            excluded.add(value)
        return None

    waypoint = values_per_waypoint(config.motion, slides=slides(query.scene, query.task))
    best = farthest_answer(evaluate, values, waypoint=waypoint, within=within)
    if best is None:
        return None, False
    known = _index_of(best, values)
    best = last_of_all(lambda i: evaluate(values[i], True), known, len(values)) or best
    open_to = int(np.searchsorted(np.abs(values - values[0]), stopped - _SAME))
    return best, bool(_index_of(best, values) + 1 == open_to < len(values))


def _index_of(answer: PlacementResult, values: Float[np.ndarray, " k"]) -> int:
    """Return which of the values an answer reaches."""
    assert answer.plan.task.to is not None
    return int(np.abs(values - answer.plan.task.to).argmin())


def values_short_of(query: PlacementQuery) -> Float[np.ndarray, " k"]:
    """Return the whole degrees or centimeters between the part's value and its goal.

    They end where the part meets the floor.
    """
    task = query.task
    assert task.joint is not None
    assert task.to is not None
    target = query.scene.object(task.object)
    contact = meets_floor_at(target, task.joint, task.to)
    end = task.to if contact is None else contact
    return values_before(target.values()[task.joint], end, slides=slides(query.scene, task))


def _answer_to(
    query: PlacementQuery, answer: Answer, value: float, config: PipelineConfig
) -> PlacementResult:
    """Answer the query for another value; add the time to the query's stopwatch."""
    task = replace(query.task, to=float(value), farthest=False)
    return answer_on_watch(query, replace(query, task=task, config=config), answer)


def answer_on_watch(
    query: PlacementQuery, other: PlacementQuery, answer: Answer
) -> PlacementResult:
    """Answer another question as a part of a query, whose stopwatch counts the time."""
    watch = Stopwatch(query.watch.clock)
    result = answer(replace(other, watch=watch))
    for stage, seconds in watch.seconds.items():
        query.watch.seconds[stage] = query.watch.seconds.get(stage, 0.0) + seconds
    return result


def by_samples(config: PipelineConfig) -> PipelineConfig:
    """Return the configuration of a quick search: one round of samples and no grid."""
    place = config.place
    method: Method = "ours" if place.method == "exhaustive" else place.method
    return replace(config, place=replace(place, rounds=1, grid=False, method=method))
