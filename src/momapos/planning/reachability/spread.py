"""Kernels that try neighboring lines, and points half-way to them, from the states on a line."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from momapos.core.compiled import I1, S3, U1, entry, kernel

from .aim import SPAN, AimedArm, LineGrid, aim_from, memory
from .grid import TURNS, GridShape

AZIMUTH = 4
"""The periodic axis of the grid."""
GROUPS = TURNS // SPAN
"""Number of groups of turns; a line stores a state for each [-]."""


class LineStates(NamedTuple):
    """The turns reached on each line of a grid, and arm states that reach them."""

    shape: GridShape
    """Number of lines along each axis."""
    words: U1
    """Tool turns that are reached on each line."""
    states: S3
    """A state per line and group of turns that reaches some of these turns (lines, groups, n).
    Distant turns need different states, and neighboring lines start from each of them."""


@kernel
def group_of_turns(group):
    """Return the word of the turns of a group."""
    return np.uint64(((1 << SPAN) - 1) << (SPAN * group))


@kernel
def _unravel(line, shape, at):
    for k in range(4, -1, -1):
        at[k] = line % shape[k]
        line //= shape[k]


@kernel
def _beside(line, axis, step, shape, at):
    """Return the line some steps along an axis, -1 if outside the grid; `at` becomes its index."""
    _unravel(line, shape, at)
    at[axis] += step
    if axis == AZIMUTH:
        at[AZIMUTH] = (at[AZIMUTH] + shape[AZIMUTH]) % shape[AZIMUTH]
    elif at[axis] < 0 or at[axis] >= shape[axis]:
        return -1
    beside = 0
    for k in range(5):
        beside = beside * shape[k] + int(at[k])
    return beside


@kernel
def _asked_before(states, group, asked):
    """Check whether an earlier group with the same state was already used as a start."""
    for g in range(group):
        if not asked & (1 << g):
            continue
        same = True
        for k in range(states.shape[1]):
            same = same and states[g, k] == states[group, k]
        if same:
            return True
    return False


@entry
def aim_beside(
    rows: I1,
    axis: int,
    step: int,
    fresh: U1,
    known: LineStates,
    arm: AimedArm,
    grid: LineGrid,
    lines: I1,
    words: U1,
    states: S3,
) -> None:
    """Aim the arm at neighboring lines, from the states on the given lines.

    Args:
        rows: The lines that have gained turns (k,).
        axis, step: Where the neighbor of each line is.
        fresh: The turns that each line of the grid has gained; its neighbor is tried for these.
        known: What is known so far. It is not changed, so threads do not see each other's results.
        lines: Output: the neighbor of each line (k,); -1 if outside the grid.
        words: Output: the new turns found on the neighbor (k,).
        states: Output: the states that reach them (k, groups, n), for the groups found.
    """
    own, at = memory(arm), np.empty(5)
    for i in range(len(rows)):
        source = rows[i]
        words[i] = np.uint64(0)
        lines[i] = _beside(source, axis, step, known.shape, at)
        if lines[i] < 0:
            continue
        told, asked = known.words[lines[i]], 0
        for group in range(GROUPS):
            if not fresh[source] & ~told & group_of_turns(group):
                continue
            # One state usually serves several groups.
            if _asked_before(known.states[source], group, asked):
                continue
            asked |= 1 << group
            word = aim_from(at, known.states[source, group], told, arm, grid, own)
            told |= word
            words[i] |= word
            _keep(word, own.q, states[i])


@kernel
def _keep(word, q, states):
    """Store a state for the groups of the turns that it reaches."""
    for group in range(GROUPS):
        if word & group_of_turns(group):
            for k in range(len(q)):
                states[group, k] = q[k]


@entry
def add(lines: I1, words: U1, states: S3, known: LineStates, gained: U1) -> None:
    """Add turns found on lines to `known` and `gained`.

    Args:
        lines: The lines (k,); -1 for none. For a line listed twice the last states are stored;
            threads must not share a line.
        words: Turns found on each line (k,).
        states: The states that reach them (k, groups, n).
        known: What is known so far, changed in place.
        gained: The turns that each line of the grid has gained, changed in place.
    """
    for i in range(len(lines)):
        line, word = lines[i], words[i]
        if not word:
            continue
        known.words[line] |= word
        gained[line] |= word
        for group in range(GROUPS):
            if word & group_of_turns(group):
                for k in range(states.shape[2]):
                    known.states[line, group, k] = states[i, group, k]


@entry
def aim_between(
    low: I1,
    axis: int,
    wanted: np.uint64,
    known: LineStates,
    arm: AimedArm,
    grid: LineGrid,
    words: U1,
) -> None:
    """Find the turns reached half-way between lines and the next ones along an axis.

    Args:
        low: The lines at the lower ends (k,).
        axis: Axis along which the lines are neighbors.
        wanted: Word of the turns that matter; the other bits of the result are undefined.
        known: What is known of the lines.
        words: Output: the turns reached there (k,).
    """
    own, at, to = memory(arm), np.empty(5), np.empty(5)
    ends = np.empty(2, np.int64)
    for i in range(len(low)):
        ends[0], ends[1] = low[i], _beside(low[i], axis, 1, known.shape, to)
        both = known.words[ends[0]] & known.words[ends[1]]
        # Turns on which both ends agree are assumed to agree half-way, too.
        either = known.words[ends[0]] | known.words[ends[1]]
        _unravel(low[i], known.shape, at)
        at[axis] += 0.5
        word = both
        for end in range(2):
            # Start from the end that has turns which the other end lacks.
            for group in range(GROUPS):
                if known.words[ends[end]] & ~word & wanted & group_of_turns(group):
                    start = known.states[ends[end], group]
                    word |= aim_from(at, start, word | ~wanted, arm, grid, own) & either
        words[i] = word
