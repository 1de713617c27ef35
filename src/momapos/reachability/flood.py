"""Which lines of the last axis an arm of any kind reaches: states spread over the grid of lines.

Random arm states give the first lines; from there every line is tried from the states on the lines
beside it, a few Newton steps away, until nothing new is found. No first axis needs to be vertical
and no inverse in closed form to exist. Source of the idea: Zacharias et al., Capturing robot
workspace structure (IROS 2007), with neighbors' states in place of inverse kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.kinematics.chain import Chain
from momapos.kinematics.ik_model import bounded
from momapos.reachability.aim import ALL, AimedArm, LineGrid, aim_all, lines_of
from momapos.reachability.threads import Progress, in_threads

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt64

DRAW = 300_000
"""Random states that are drawn at a time [-]."""
WAVES = 16
"""How often what is new is carried on to the lines beside it, at most [-]."""
_PART = 40_000
"""Lines a thread takes at once."""


@dataclass(frozen=True)
class Flood:
    """What is known of the lines of a grid."""

    shape: tuple[int, ...]
    """Number of lines along z, r, u, v and azimuth."""
    grid: LineGrid
    arm: AimedArm
    words: UInt64[np.ndarray, " lines"]
    """Turns of the tool that are reached on each."""
    states: Float[np.ndarray, "lines n"]
    """A state on each that gave the last of these."""


def flood(
    chain: Chain,
    arm: AimedArm,
    grid: LineGrid,
    shape: tuple[int, ...],
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
    lines = int(np.prod(shape))
    found = Flood(
        shape, grid, arm, np.zeros(lines, np.uint64), np.zeros((lines, chain.size), np.float32)
    )
    rng = np.random.default_rng(0)
    lower, upper = bounded(chain)
    changed = np.zeros(lines, bool)
    for done in range(0, count, DRAW):
        q = rng.uniform(lower, upper, (min(DRAW, count - done), chain.size))
        changed[_draw(found, q)] = True
        progress(0.5 * (done + len(q)) / count)
    fresh = np.flatnonzero(changed)
    for k in range(WAVES):
        if not len(fresh):
            break
        fresh = _carry_on(found, fresh)
        progress(0.5 + 0.5 * (k + 1) / WAVES)
    return found


def _draw(found: Flood, q: Float[np.ndarray, "k n"]) -> Int[np.ndarray, " c"]:
    """Bring random states onto the grid lines nearest to theirs; returns the lines that gain."""
    places = np.empty((len(q), 5))
    in_threads(
        lambda lo, hi: lines_of(q[lo:hi], found.arm, found.grid, places[lo:hi]), len(q), _PART
    )
    nearest = np.round(places).astype(np.int64)
    nearest[:, 4] %= found.shape[4]
    inside = ((nearest >= 0) & (nearest < found.shape)).all(1)
    line = np.ravel_multi_index(tuple(nearest[inside].T), found.shape)
    open_ = found.words[line] != ALL
    rows, line = np.flatnonzero(inside)[open_], line[open_]
    return _try(found, line, q.astype(np.float32), rows)


def _carry_on(found: Flood, fresh: Int[np.ndarray, " f"]) -> Int[np.ndarray, " c"]:
    """Try the lines beside those that have gained, from their states; returns what gains now."""
    at = np.array(np.unravel_index(fresh, found.shape))
    gained: list[np.ndarray] = []
    for axis in range(5):
        for step in (-1, 1):
            beside = at.copy()
            beside[axis] += step
            if axis == 4:
                beside[axis] %= found.shape[4]
            inside = (beside[axis] >= 0) & (beside[axis] < found.shape[axis])
            line = np.ravel_multi_index(tuple(beside[:, inside]), found.shape)
            source = fresh[inside]
            # A neighbor's state gives about the turns that the neighbor has.
            useful = (found.words[source] & ~found.words[line]) != 0
            gained.append(_try(found, line[useful], found.states, source[useful]))
    return np.unique(np.concatenate(gained))


def _try(
    found: Flood,
    line: Int[np.ndarray, " k"],
    starts: Float[np.ndarray, "s n"],
    sources: Int[np.ndarray, " k"],
) -> Int[np.ndarray, " c"]:
    """Aim at lines from states, and keep what is new; returns the lines that gain."""
    places = np.array(np.unravel_index(line, found.shape), float).T.copy()
    words, states = _aimed(found, places, found.words[line], starts, sources)
    new = np.flatnonzero(words)
    np.bitwise_or.at(found.words, line[new], words[new])
    found.states[line[new]] = states[new]
    return np.unique(line[new])


def between(found: Flood, axis: int) -> tuple[Int[np.ndarray, " e"], UInt64[np.ndarray, " e"]]:
    """Turns reached half-way to the next line along an axis, where the two differ.

    Returns:
        The lines at the lower ends, and the words.
    """
    grown = found.words.reshape(found.shape)
    if axis == 4:
        differ = grown != np.roll(grown, -1, 4)
    else:
        differ = np.zeros(found.shape, bool)
        near = np.moveaxis(grown, axis, 0)
        np.moveaxis(differ, axis, 0)[:-1] = near[1:] != near[:-1]
    low = np.flatnonzero(differ.reshape(-1))
    at = np.array(np.unravel_index(low, found.shape))
    high = at.copy()
    high[axis] = (high[axis] + 1) % found.shape[axis]
    up = np.ravel_multi_index(tuple(high), found.shape)
    both = found.words[low] & found.words[up]
    words, places = both.copy(), at.astype(float).T.copy()
    places[:, axis] += 0.5
    for source in (low, up):
        # From the end that has what the other lacks.
        rows = np.flatnonzero((found.words[source] & ~words) != 0)
        out, _ = _aimed(found, places[rows], words[rows], found.states, source[rows])
        # Half-way between two that agree they are taken to agree.
        words[rows] |= out & (found.words[low] | found.words[up])[rows]
    return low, words


def _aimed(
    found: Flood,
    places: Float[np.ndarray, "k 5"],
    known: UInt64[np.ndarray, " k"],
    starts: Float[np.ndarray, "s n"],
    sources: Int[np.ndarray, " k"],
) -> tuple[UInt64[np.ndarray, " k"], Float[np.ndarray, "k n"]]:
    """New turns on lines, and the states on them, each from one state; see `aim_all`."""
    count = len(places)
    words, states = np.empty(count, np.uint64), np.empty((count, starts.shape[1]), np.float32)
    sources = np.ascontiguousarray(sources)

    def part(lo: int, hi: int) -> None:
        aim_all(
            places[lo:hi], starts, sources[lo:hi], known[lo:hi], found.arm, found.grid,
            words[lo:hi], states[lo:hi],
        )  # fmt: skip

    in_threads(part, count, _PART)
    return words, states
