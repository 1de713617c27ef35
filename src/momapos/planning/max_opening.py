"""How far a part can be moved: the last value that works, found by halving.

A motion that works to a value works to every value before it, so between one that works and one
that does not a few questions find the last. Values are whole degrees or centimeters, as people ask
for them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from momapos.planning.grasps import MotionConfig

if TYPE_CHECKING:
    from jaxtyping import Float

T = TypeVar("T")
_SAME = 1e-6
"""Shares of a degree or a centimeter that are none [-]."""


def values_before(begin: float, goal: float, *, slides: bool) -> Float[np.ndarray, " k"]:
    """Values in whole degrees or centimeters between two, the nearest to the first one first.

    Args:
        begin: Where the part is [rad] or [m]; it is not among them.
        goal: Where it shall go [rad] or [m]; it is not among them either.
        slides: Whether it slides [m]; it turns otherwise [rad].
    """
    unit = 0.01 if slides else math.radians(1.0)
    low, high = sorted((begin / unit, goal / unit))
    whole = np.arange(math.floor(low + _SAME) + 1, math.ceil(high - _SAME))
    return unit * (whole if goal > begin else whole[::-1])


def last_that_works(
    ask: Callable[[int], T | None],
    low: int,
    high: int,
    *,
    within: int = 1,
    first_step: int | None = None,
) -> tuple[int, T | None]:
    """Find the last index that works, between one that does and one that does not.

    Args:
        ask: What comes of an index, None where it does not work.
        low: An index that works, or the one before the first.
        high: An index that does not work, or the one after the last.
        within: The answer is at most so many before one that does not work.
        first_step: Step ahead first by so many, then by twice as many: for a low one that is near
            the last. Without it, always halve.

    Returns:
        The index, and what came of it; None where it is still the low one, which was not asked.
    """
    best, step = None, first_step
    while high - low > within:
        middle = (low + high) // 2
        at = middle if step is None else min(low + step, max(middle, low + within))
        answer = ask(at)
        if answer is None:
            high, step = at, None
        else:
            low, best = at, answer
            step = None if step is None else 2 * step
    return low, best


def from_the_top(ask: Callable[[int], T | None], count: int, stride: int) -> T | None:
    """What comes of the last of some indices that works, looked for from the end.

    For answers that hold no more than mostly: one that fails among some that work is passed by.

    Args:
        ask: What comes of an index, None where it does not work.
        count: How many indices there are.
        stride: Only every so many-th is asked until one works, then those after it.
    """
    top = count
    for index in range(count - 1, -1, -stride):
        found = ask(index)
        if found is not None:
            return _first(ask, range(top - 1, index, -1)) or found
        top = index
    return _first(ask, range(top - 1, -1, -1))


def _first(ask: Callable[[int], T | None], indices: range) -> T | None:
    return next((found for i in indices if (found := ask(i)) is not None), None)


def farthest_answer(
    ask: Callable[[float, bool], T | None],
    values: Float[np.ndarray, " k"],
    *,
    waypoint: int,
    within: int,
) -> T | None:
    """The answer for the farthest of some values that has one.

    Samples alone say quickly how far it goes about; from there on a grid decides, a waypoint
    farther at first.

    Args:
        ask: The answer for a value, by samples alone or by a grid as well (True), if there is one.
        values: The values, the nearest to where the part is first [rad] or [m].
        waypoint: How many values lie between two waypoints [-].
        within: The answer is at most so many values before one for which the grid has none [-].
    """
    some, best = last_that_works(lambda i: ask(values[i], False), -1, len(values))
    _, better = last_that_works(
        lambda i: ask(values[i], True), some, len(values), within=within, first_step=waypoint
    )
    return best if better is None else better


def values_per_waypoint(config: MotionConfig, *, slides: bool) -> int:
    """How many whole degrees or centimeters lie between two waypoints [-]."""
    step = 100.0 * config.waypoint_slide if slides else config.waypoint_angle
    return max(1, math.floor(step + _SAME))
