"""Find the largest value that works, by bisection and by trying all values beyond.

A motion to a value passes all values before it, so few tries between a value that works and one
that does not find one that is nearly the largest. A search of base poses may miss a value and find
a larger one, so that every value beyond is tried, too. Values are whole degrees or centimeters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from momapos.planning.grasps import MotionConfig

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
