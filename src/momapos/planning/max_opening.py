"""Find the largest value that works, by bisection and by trying all values beyond.

A motion to a value passes all values before it, so few tries between a value that works and one
that does not find one that is nearly the largest. A search of base poses may miss a value and find
a larger one, so that every value beyond is tried, too. Values are whole degrees or centimeters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from momapos.core import OutOfTimeError, Stopwatch
from momapos.planning.grasps import MotionConfig, slides
from momapos.planning.placement import Method
from momapos.verification import meets_floor_at

from .config import PipelineConfig
from .query import PlacementQuery
from .result import Answer, PlacementResult
from .time_limit import cut_short, unless_late, with_note

if TYPE_CHECKING:
    from jaxtyping import Float


T = TypeVar("T")
STEPS_AHEAD = (3, 6, 1, 2)
"""Values tried first beyond the last one that works, in this order, then every sixth, then the
others: of six openings that a search had stated too small, five went on 3 to 4 degrees farther and
one 6 degrees [-]."""
_ROUNDING = 1e-6
"""Fractions of a degree or a centimeter that count as rounding errors [-]."""


def values_before(begin: float, goal: float, *, slides: bool) -> Float[np.ndarray, " k"]:
    """Return the whole degrees or centimeters between two values, starting at the first one.

    Args:
        begin: The part's value [rad] or [m], excluded.
        goal: The value it must reach [rad] or [m], excluded.
        slides: Whether it slides [m]; otherwise it turns [rad].
    """
    unit = 0.01 if slides else math.radians(1.0)
    low, high = sorted((begin / unit, goal / unit))
    whole = np.arange(math.floor(low + _ROUNDING) + 1, math.ceil(high - _ROUNDING))
    return unit * (whole if goal > begin else whole[::-1])


def last_that_works(
    evaluate: Callable[[int], T | None],
    low: int,
    high: int,
    *,
    within: int = 1,
    first_step: int | None = None,
) -> tuple[int, T | None]:
    """Find the last index that works, between one that does and one that does not.

    Args:
        evaluate: Returns the result for an index, None if it does not work.
        low: An index that works, or the one before the first.
        high: An index that does not work, or the one after the last.
        within: Maximum distance of the returned index from one that does not work.
        first_step: First step ahead, doubled each time, if `low` is close to the last index that
            works; None always bisects.

    Returns:
        The index and its result; None if it is `low`, which was not tried.
    """
    best, step = None, first_step
    while high - low > within:
        middle = (low + high) // 2
        at = middle if step is None else min(low + step, max(middle, low + within))
        answer = evaluate(at)
        if answer is None:
            high, step = at, None
        else:
            low, best = at, answer
            step = None if step is None else 2 * step
    return low, best


def from_the_top(evaluate: Callable[[int], T | None], count: int, stride: int) -> T | None:
    """Return the result of the last index that works, searching from the end.

    Unlike bisection it skips an index that fails among some that work.

    Args:
        evaluate: Returns the result for an index, None if it does not work.
        count: Number of indices.
        stride: Step between tried indices until one works; then those after it are tried.
    """
    top = count
    for index in range(count - 1, -1, -stride):
        found = evaluate(index)
        if found is not None:
            return _first(evaluate, range(top - 1, index, -1)) or found
        top = index
    return _first(evaluate, range(top - 1, -1, -1))


def _first(evaluate: Callable[[int], T | None], indices: range) -> T | None:
    return next((found for i in indices if (found := evaluate(i)) is not None), None)


def farthest_answer(
    evaluate: Callable[[float, bool], T | None],
    values: Float[np.ndarray, " k"],
    *,
    waypoint: int,
    within: int,
) -> T | None:
    """Return the result for the largest value that has one.

    Samples estimate it quickly; from there on a grid decides, first one waypoint farther.

    Args:
        evaluate: Returns the result for a value, from samples alone or (True) also from a grid.
        values: The values in opening order [rad] or [m].
        waypoint: Number of values between two waypoints [-].
        within: Maximum number of values between the result and one that the grid excludes [-].
    """
    some, best = last_that_works(lambda i: evaluate(values[i], False), -1, len(values))
    _, better = last_that_works(
        lambda i: evaluate(values[i], True), some, len(values), within=within, first_step=waypoint
    )
    return best if better is None else better


def last_of_all(evaluate: Callable[[int], T | None], known: int, count: int) -> T | None:
    """Return the result for the last index that works, trying every one beyond a known one.

    Args:
        evaluate: Returns the result for an index, None if it does not work.
        known: The last index known to work; -1 if none is.
        count: Number of indices.
    """
    best: T | None = None
    failed: set[int] = set()
    while True:
        i = next((i for i in _ahead(known, count) if i not in failed), None)
        if i is None:
            return best
        found = evaluate(i)
        if found is None:
            failed.add(i)
        else:
            known, best = i, found


def _ahead(known: int, count: int) -> Iterator[int]:
    """Yield all indices beyond a known one, in the order of trying them."""
    leap = max(STEPS_AHEAD)
    first = [known + step for step in (*STEPS_AHEAD, *range(2 * leap, count - known, leap))]
    yield from (i for i in first if i < count)
    yield from sorted(set(range(known + 1, count)) - set(first))


def values_per_waypoint(config: MotionConfig, *, slides: bool) -> int:
    """Return the number of whole degrees or centimeters between two waypoints [-]."""
    step = 100.0 * config.waypoint_slide if slides else config.waypoint_angle
    return max(1, math.floor(step + _ROUNDING))


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
