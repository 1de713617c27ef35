"""Which lines of the last axis an arm of any kind reaches: states spread over the grid of lines.

Random arm states give the first lines; from there every line is tried from the states on the lines
beside it, a few Newton steps away, until nothing new is found. No first axis needs to be vertical
and no inverse in closed form to exist. Source of the idea: Zacharias et al., Capturing robot
workspace structure (IROS 2007), with neighbors' states in place of inverse kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from momapos.kinematics.chain import Chain
from momapos.kinematics.ik_model import bounded
from momapos.reachability.aim import ALL, SPAN, AimedArm, LineGrid, aim_all, lines_of
from momapos.reachability.grid import TURNS
from momapos.reachability.threads import Progress, in_threads

if TYPE_CHECKING:
    from jaxtyping import Float, Float16, Int, UInt64

WAY = 3
"""Counts the ways in which maps have been flooded: a map of another one is not this one's."""
DRAW = 300_000
"""Random states that are drawn at a time [-]."""
AT_LIMITS = 0.125
"""Share of its range by which a joint is drawn beyond each limit, and put there [-]: what needs a
joint at its limit, such as a torso at its height, is found from no state between the limits."""
WAVES = 16
"""How often what is new is carried on to the lines beside it, at most [-]."""
GROUPS = tuple(np.uint64(((1 << SPAN) - 1) << low) for low in range(0, TURNS, SPAN))
"""The turns of each group, as words; a state is kept for each."""
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
    states: Float16[np.ndarray, "lines groups n"]
    """For each group of turns a state on each line that gave some of them: turns that lie apart are
    served by different states, and each is wanted by lines beside this one."""


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
        shape, grid, arm, np.zeros(lines, np.uint64),
        np.zeros((lines, len(GROUPS), chain.size), np.float16),
    )  # fmt: skip
    rng = np.random.default_rng(0)
    lower, upper = bounded(chain)
    gained = np.zeros(lines, np.uint64)
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
    places = np.empty((len(q), 5))
    in_threads(
        lambda lo, hi: lines_of(q[lo:hi], found.arm, found.grid, places[lo:hi]), len(q), _PART
    )
    nearest = np.round(places).astype(np.int64)
    nearest[:, 4] %= found.shape[4]
    inside = ((nearest >= 0) & (nearest < found.shape)).all(1)
    line = np.ravel_multi_index(tuple(nearest[inside].T), found.shape)
    open_ = found.words[line] != ALL
    _try(found, line[open_], q[inside][open_].astype(np.float32), gained)


def _carry_on(
    found: Flood, fresh: UInt64[np.ndarray, " lines"], progress: Progress
) -> UInt64[np.ndarray, " lines"]:
    """Try the lines beside those that have gained, from their states; returns what gains now."""
    gained = np.zeros(len(fresh), np.uint64)
    rows = np.flatnonzero(fresh)
    at = np.array(np.unravel_index(rows, found.shape))
    for axis in range(5):
        for step in (-1, 1):
            beside = at.copy()
            beside[axis] += step
            if axis == 4:
                beside[axis] %= found.shape[4]
            inside = (beside[axis] >= 0) & (beside[axis] < found.shape[axis])
            line = np.ravel_multi_index(tuple(beside[:, inside]), found.shape)
            _try_beside(found, line, rows[inside], fresh, gained)
            progress((2 * axis + (step > 0) + 1) / 10)
    return gained


def _try_beside(
    found: Flood,
    line: Int[np.ndarray, " k"],
    source: Int[np.ndarray, " k"],
    fresh: UInt64[np.ndarray, " lines"],
    gained: UInt64[np.ndarray, " lines"],
) -> None:
    """Aim at lines from the states of lines beside them, which give about the turns of those."""
    tried = np.zeros((len(line), len(GROUPS)), bool)
    for group, turns in enumerate(GROUPS):
        wanted = np.flatnonzero(fresh[source] & ~found.words[line] & turns)
        states = found.states[source[wanted]]
        # One state mostly serves several groups.
        same = (states[:, :group] == states[:, group : group + 1]).all(2)
        anew = ~(same & tried[wanted, :group]).any(1)
        wanted = wanted[anew]
        tried[wanted, group] = True
        _try(found, line[wanted], states[anew, group].astype(np.float32), gained)


def _try(
    found: Flood,
    line: Int[np.ndarray, " k"],
    starts: Float[np.ndarray, "k n"],
    gained: UInt64[np.ndarray, " lines"],
) -> None:
    """Aim at lines, each from a state; keep what is new, and add it to what is gained."""
    places = np.array(np.unravel_index(line, found.shape), float).T.copy()
    words, states = _aimed(found, places, found.words[line], starts)
    np.bitwise_or.at(found.words, line, words)
    np.bitwise_or.at(gained, line, words)
    for group, turns in enumerate(GROUPS):
        new = np.flatnonzero(words & turns)
        found.states[line[new], group] = states[new]


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
    grown = (found.words & asked).reshape(found.shape)
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
        for group, turns in enumerate(GROUPS):
            rows = np.flatnonzero(found.words[source] & ~words & turns & asked)
            start = found.states[source[rows], group].astype(np.float32)
            out, _ = _aimed(found, places[rows], words[rows] | ~asked, start)
            # Half-way between two that agree they are taken to agree.
            words[rows] |= out & (found.words[low] | found.words[up])[rows]
    return low, words


def _aimed(
    found: Flood,
    places: Float[np.ndarray, "k 5"],
    known: UInt64[np.ndarray, " k"],
    starts: Float[np.ndarray, "k n"],
) -> tuple[UInt64[np.ndarray, " k"], Float[np.ndarray, "k n"]]:
    """New turns on lines, and the states on them, each from one state; see `aim_all`."""
    count = len(places)
    words, states = np.empty(count, np.uint64), np.empty((count, starts.shape[1]), np.float32)

    def part(lo: int, hi: int) -> None:
        aim_all(
            places[lo:hi], starts[lo:hi], known[lo:hi], found.arm, found.grid,
            words[lo:hi], states[lo:hi],
        )  # fmt: skip

    in_threads(part, count, _PART)
    return words, states
