"""Carry what an arm does on one line of the grid to the lines beside it, and half-way to them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from momapos.core.compiled import I1, S3, U1, entry, kernel

from .aim import SPAN, AimedArm, LineGrid, aim_from, memory
from .grid import TURNS, GridShape

AZIMUTH = 4
"""The axis of the grid that goes around."""
GROUPS = TURNS // SPAN
"""Groups of turns; a line keeps a state for each [-]."""


class Lines(NamedTuple):
    """What is known of the lines of a grid."""

    shape: GridShape
    """Number of lines along each axis."""
    words: U1
    """Turns of the tool that are reached on each."""
    states: S3
    """For each group of turns a state on each line that gave some of them (lines, groups, n): turns
    that lie apart are served by different states, and each is wanted by lines beside this one."""


@kernel
def group_of_turns(group):
    """The turns of a group, as a word."""
    return np.uint64(((1 << SPAN) - 1) << (SPAN * group))


@kernel
def _unravel(line, shape, at):
    """The place of a line along each axis."""
    for k in range(4, -1, -1):
        at[k] = line % shape[k]
        line //= shape[k]


@kernel
def _beside(line, axis, step, shape, at):
    """The line so many steps along an axis, and its place; -1 where there is none."""
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
    """Whether the state of a group is one that was begun from."""
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
    known: Lines,
    arm: AimedArm,
    grid: LineGrid,
    lines: I1,
    words: U1,
    states: S3,
) -> None:
    """Aim at the lines beside some lines, from the states on these.

    Args:
        rows: The lines that have gained (k,).
        axis, step: Which of the lines beside each is aimed at.
        fresh: The turns that each line of the grid has gained: what lies beside is tried for these.
        known: What is known; it is left as it is, so that threads do not see what others find.
        arm: The arm.
        grid: The grid.
        lines: The line beside each, to be filled (k,); -1 where there is none.
        words: The turns found on it that it lacks, to be filled (k,).
        states: The states that serve them (k, groups, n), to be filled for the groups found.
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
            # One state mostly serves several groups.
            if _asked_before(known.states[source], group, asked):
                continue
            asked |= 1 << group
            word = aim_from(at, known.states[source, group], told, arm, grid, own)
            told |= word
            words[i] |= word
            _keep(word, own.q, states[i])


@kernel
def _keep(word, q, states):
    """Keep a state for the groups of which it serves turns."""
    for group in range(GROUPS):
        if word & group_of_turns(group):
            for k in range(len(q)):
                states[group, k] = q[k]


@entry
def add(lines: I1, words: U1, states: S3, known: Lines, gained: U1) -> None:
    """Add turns found on lines to what is known and to what is gained.

    Args:
        lines: The lines (k,); -1 for none. Of one that is named twice the last states are kept;
            threads that share the work name none twice.
        words: Turns found on each (k,).
        states: The states that serve them (k, groups, n).
        known: What is known, changed in place.
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
    low: I1, axis: int, asked: np.uint64, known: Lines, arm: AimedArm, grid: LineGrid, words: U1
) -> None:
    """Turns reached half-way between lines and the next ones along an axis.

    Args:
        low: The lines at the lower ends (k,).
        axis: Along which.
        asked: The turns that matter; of the others the answer says nothing.
        known: What is known of the lines.
        arm: The arm.
        grid: The grid.
        words: Turns that are reached there, to be filled (k,).
    """
    own, at, to = memory(arm), np.empty(5), np.empty(5)
    ends = np.empty(2, np.int64)
    for i in range(len(low)):
        ends[0], ends[1] = low[i], _beside(low[i], axis, 1, known.shape, to)
        both = known.words[ends[0]] & known.words[ends[1]]
        # Half-way between two that agree they are taken to agree.
        either = known.words[ends[0]] | known.words[ends[1]]
        _unravel(low[i], known.shape, at)
        at[axis] += 0.5
        word = both
        for end in range(2):
            # From the end that has what the other lacks.
            for group in range(GROUPS):
                if known.words[ends[end]] & ~word & asked & group_of_turns(group):
                    start = known.states[ends[end], group]
                    word |= aim_from(at, start, word | ~asked, arm, grid, own) & either
        words[i] = word
