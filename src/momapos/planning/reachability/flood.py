"""Which lines of the last axis an arm of any kind reaches: states spread over the grid of lines.

Random arm states give the first lines; from there every line is tried from the states on the lines
beside it, a few Newton steps away, until nothing new is found. No first axis needs to be vertical
and no inverse in closed form to exist. Source of the idea: Zacharias et al., Capturing robot
workspace structure (IROS 2007), with neighbors' states in place of inverse kinematics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.kinematics import Chain, bounded

from .aim import AimedArm, LineGrid, aim_all, lines_of
from .grid import GridShape
from .spread import AZIMUTH, GROUPS, Lines, add, aim_beside, aim_between
from .threads import Progress, in_threads

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt64

WAY = 4
"""Counts the ways in which maps have been flooded: a map of another one is not this one's."""
DRAW = 300_000
"""Random states that are drawn at a time [-]."""
AT_LIMITS = 0.125
"""Share of its range by which a joint is drawn beyond each limit, and put there [-]: what needs a
joint at its limit, such as a torso at its height, is found from no state between the limits."""
WAVES = 16
"""How often what is new is carried on to the lines beside it, at most [-]."""
_PARTS, _LEAST = 32, 500
"""In how many parts work is divided, so that no thread waits long for another, and the fewest lines
of a part."""


@dataclass(frozen=True)
class Flood:
    """What is known of the lines of a grid, and what it takes to know more."""

    lines: Lines
    grid: LineGrid
    arm: AimedArm


def flood(
    chain: Chain,
    arm: AimedArm,
    grid: LineGrid,
    shape: GridShape,
    count: int,
    progress: Progress,
) -> Flood:
    """Find the lines that an arm reaches.

    Args:
        chain: The arm.
        arm: The arm as the kernels take it.
        grid, shape: The lines.
        count: Random states to begin with [-].
        progress: Called with the share that is done, in [0, 1].
    """
    size = int(np.prod(shape))
    states = np.zeros((size, GROUPS, chain.size), np.float32)
    found = Flood(Lines(shape, np.zeros(size, np.uint64), states), grid, arm)
    rng = np.random.default_rng(0)
    lower, upper = bounded(chain)
    gained = np.zeros(size, np.uint64)
    beyond = AT_LIMITS * (upper - lower)
    for done in range(0, count, DRAW):
        q = rng.uniform(lower - beyond, upper + beyond, (min(DRAW, count - done), chain.size))
        q = np.clip(q, lower, upper)
        _draw(found, q, gained)
        progress(0.05 * (done + len(q)) / count)
    for k in range(WAVES):
        if not gained.any():
            break
        gained = _carry_on(found, gained, partial(_tell_wave, progress, k))
    return found


def _tell_wave(progress: Progress, k: int, share: float) -> None:
    """Tell how far all is when wave k is so far."""
    # Each wave takes about two thirds of the one before.
    progress(1.0 - 0.95 * 0.65 ** (k + share))


def _draw(found: Flood, q: Float[np.ndarray, "k n"], gained: UInt64[np.ndarray, " lines"]) -> None:
    """Bring random states onto the grid lines nearest to theirs, and add what these gain."""
    lines, arm, grid = found.lines, found.arm, found.grid
    places = np.empty((len(q), 5))
    _in_parts(lambda lo, hi: lines_of(q[lo:hi], arm, grid, places[lo:hi]), len(q))
    nearest = np.round(places)
    nearest[:, AZIMUTH] %= lines.shape.azimuth
    inside = ((nearest >= 0) & (nearest < lines.shape)).all(1)
    line = np.ravel_multi_index(tuple(nearest[inside].T.astype(np.int64)), lines.shape)
    at, starts, known = nearest[inside], q[inside].astype(np.float32), lines.words[line]
    words, states = np.empty(len(line), np.uint64), np.empty_like(starts)
    _in_parts(
        lambda lo, hi: aim_all(
            at[lo:hi], starts[lo:hi], known[lo:hi], arm, grid, words[lo:hi], states[lo:hi]
        ),
        len(line),
    )
    add(line, words, states[:, None].repeat(GROUPS, 1), lines, gained)


def _carry_on(
    found: Flood, fresh: UInt64[np.ndarray, " lines"], progress: Progress
) -> UInt64[np.ndarray, " lines"]:
    """Try the lines beside those that have gained, from their states; returns what gains now."""
    gained = np.zeros(len(fresh), np.uint64)
    rows = np.flatnonzero(fresh)
    lines, words = np.empty_like(rows), np.empty(len(rows), np.uint64)
    states = np.empty((len(rows), *found.lines.states.shape[1:]), np.float32)
    for axis in range(5):
        for step in (-1, 1):

            def aim(lo: int, hi: int, axis: int = axis, step: int = step) -> None:
                aim_beside(
                    rows[lo:hi], axis, step, fresh, found.lines, found.arm, found.grid,
                    lines[lo:hi], words[lo:hi], states[lo:hi],
                )  # fmt: skip

            _in_parts(aim, len(rows))
            _in_parts(
                lambda lo, hi: add(
                    lines[lo:hi], words[lo:hi], states[lo:hi], found.lines, gained
                ),
                len(rows),
            )  # fmt: skip
            progress((2 * axis + (step > 0) + 1) / 10)
    return gained


def between(
    found: Flood, axis: int, asked: np.uint64
) -> tuple[Int[np.ndarray, " e"], UInt64[np.ndarray, " e"]]:
    """Turns reached half-way to the next line along an axis, where the two differ.

    Args:
        found: What is known of the lines.
        axis: Along which.
        asked: The turns that matter, as a word; of the others the answer says nothing.

    Returns:
        The lines at the lower ends, and the words.
    """
    grown = (found.lines.words & asked).reshape(found.lines.shape)
    near = np.moveaxis(grown, axis, 0)
    differ = np.moveaxis(np.zeros(grown.shape, bool), axis, 0)
    differ[:-1] = near[1:] != near[:-1]
    if axis == AZIMUTH:
        differ[-1] = near[0] != near[-1]
    low = np.flatnonzero(np.moveaxis(differ, 0, axis))
    words = np.empty(len(low), np.uint64)
    _in_parts(
        lambda lo, hi: aim_between(
            low[lo:hi], axis, asked, found.lines, found.arm, found.grid, words[lo:hi]
        ),
        len(low),
    )
    return low, words


def _in_parts(work: Callable[[int, int], None], count: int) -> None:
    """Work over rows on all threads, none of which waits long for another."""
    in_threads(work, count, max(_LEAST, count // _PARTS))
