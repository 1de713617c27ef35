"""Find the reachable lines of the last axis of any arm, by flooding the grid of lines with states.

Random arm states give the first lines. From there, every line is tried from the states on
neighboring lines, a few Newton steps away, until nothing new is found. The first axis need not be
vertical, and no closed-form IK is needed. The idea is from Zacharias et al., Capturing robot
workspace structure (IROS 2007), with neighbors' states instead of inverse kinematics.
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
from .spread import AZIMUTH, GROUPS, LineStates, add, aim_beside, aim_between
from .threads import Progress, in_threads

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt64

FLOOD_VERSION = 4
"""Version of the flooding method, part of the map's key."""
STATES_PER_DRAW = 300_000
"""Random states that are drawn together [-]."""
LIMIT_OVERSHOOT = 0.125
"""Share of its range by which a joint is sampled beyond each limit, then clipped to it [-]. States
strictly between the limits would miss lines that need a joint at its limit, such as a raised
torso."""
MAX_WAVES = 16
"""Largest number of times that new lines are spread to their neighbors [-]."""
_PARTS, _MIN_PART = 32, 500
"""Number of parts that work is divided into, so that no thread waits long, and the fewest lines of
a part [-]."""


@dataclass(frozen=True)
class Flood:
    """The reached lines of a grid, with the grid and the arm."""

    lines: LineStates
    grid: LineGrid
    arm: AimedArm


def flood(
    chain: Chain, arm: AimedArm, grid: LineGrid, shape: GridShape, count: int, progress: Progress
) -> Flood:
    """Find the lines that an arm reaches.

    Args:
        chain: The arm.
        arm: The same arm for the kernels.
        grid, shape: The grid of lines.
        count: Number of random start states [-].
        progress: Called with the completed share, in [0, 1].
    """
    size = int(np.prod(shape))
    states = np.zeros((size, GROUPS, chain.size), np.float32)
    found = Flood(LineStates(shape, np.zeros(size, np.uint64), states), grid, arm)
    rng = np.random.default_rng(0)
    lower, upper = bounded(chain)
    gained = np.zeros(size, np.uint64)
    beyond = LIMIT_OVERSHOOT * (upper - lower)
    for done in range(0, count, STATES_PER_DRAW):
        drawn = min(STATES_PER_DRAW, count - done)
        q = rng.uniform(lower - beyond, upper + beyond, (drawn, chain.size))
        q = np.clip(q, lower, upper)
        _add_states(found, q, gained)
        progress(0.05 * (done + len(q)) / count)
    for k in range(MAX_WAVES):
        if not gained.any():
            break
        gained = _spread(found, gained, partial(_wave_progress, progress, k))
    return found


def _wave_progress(progress: Progress, k: int, share: float) -> None:
    # Each wave takes about two thirds of the time of the one before.
    progress(1.0 - 0.95 * 0.65 ** (k + share))


def _add_states(
    found: Flood, q: Float[np.ndarray, "k n"], gained: UInt64[np.ndarray, " lines"]
) -> None:
    """Move random states onto their nearest grid lines, and add the turns that they reach."""
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


def _spread(
    found: Flood, fresh: UInt64[np.ndarray, " lines"], progress: Progress
) -> UInt64[np.ndarray, " lines"]:
    """Try the neighbors of lines with new turns, from their states; return the turns gained."""
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
    found: Flood, axis: int, wanted: np.uint64
) -> tuple[Int[np.ndarray, " e"], UInt64[np.ndarray, " e"]]:
    """Find the turns reached half-way between neighboring lines that differ.

    Args:
        found: The reached lines.
        axis: Axis along which the lines are neighbors.
        wanted: Word of the turns that matter; the other bits of the result are undefined.

    Returns:
        The lines at the lower ends, and the words.
    """
    reached = (found.lines.words & wanted).reshape(found.lines.shape)
    near = np.moveaxis(reached, axis, 0)
    differ = np.moveaxis(np.zeros(reached.shape, bool), axis, 0)
    differ[:-1] = near[1:] != near[:-1]
    if axis == AZIMUTH:
        differ[-1] = near[0] != near[-1]
    low = np.flatnonzero(np.moveaxis(differ, 0, axis))
    words = np.empty(len(low), np.uint64)
    _in_parts(
        lambda lo, hi: aim_between(
            low[lo:hi], axis, wanted, found.lines, found.arm, found.grid, words[lo:hi]
        ),
        len(low),
    )
    return low, words


def _in_parts(work: Callable[[int, int], None], count: int) -> None:
    in_threads(work, count, max(_MIN_PART, count // _PARTS))
