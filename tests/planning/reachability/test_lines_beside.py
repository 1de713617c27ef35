"""Spreading states to neighboring lines, against a reference that does it line by line."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.model.kinematics.ik import bounded
from momapos.model.robots.robot import load_robot
from momapos.planning.reachability.aim import (
    ALL,
    GROUPS,
    SPAN,
    AimedArm,
    LineGrid,
    LineStates,
    add,
    aim_all,
    aim_beside,
    aim_between,
    lines_of,
)
from momapos.planning.reachability.arm_axes import arm_frame
from momapos.planning.reachability.flood import STORED, _aimed
from momapos.planning.reachability.grid import GridShape

GRID = LineGrid(-0.1, 0.1, 9, 16)
SHAPE = GridShape(20, 14, 9, 9, 16)
TURNS_OF = [np.uint64(((1 << SPAN) - 1) << (SPAN * g)) for g in range(GROUPS)]


def drawn(name: str, count: int) -> tuple[AimedArm, LineStates]:
    """Return an arm, and the grid lines nearest to some of its states."""
    robot = load_robot(name)
    arm = _aimed(robot, arm_frame(robot.chain, robot.approach_axis))
    n = robot.chain.size
    size = int(np.prod(SHAPE))
    states = np.zeros((size, GROUPS, n), np.float32)
    lines = LineStates(SHAPE, np.zeros(size, np.uint64), states)
    q = np.random.default_rng(0).uniform(*bounded(robot.chain), (count, n))
    places = np.empty((count, 5))
    lines_of(q, arm, GRID, places)
    at = np.round(places)
    at[:, 4] %= SHAPE.azimuth
    inside = ((at >= 0) & (at < SHAPE)).all(1)
    at, starts = at[inside], q[inside].astype(np.float32)
    words, found = aimed(at, starts, np.zeros(len(at), np.uint64), arm)
    line = np.ravel_multi_index(tuple(at.T.astype(int)), SHAPE)
    add(line, words, found[:, None].repeat(GROUPS, 1), lines, np.zeros_like(lines.words))
    return arm, lines


def aimed(
    at: np.ndarray, starts: np.ndarray, known: np.ndarray, arm: AimedArm
) -> tuple[np.ndarray, np.ndarray]:
    """Aim at lines, each from one state; return words and states."""
    words, states = np.empty(len(at), np.uint64), np.empty_like(starts)
    aim_all(at, starts, known, arm, GRID, words, states)
    return words, states


@pytest.mark.parametrize(("axis", "step"), [(0, 1), (1, -1), (3, 1), (4, 1), (4, -1)])
def test_neighboring_lines_are_tried_from_each_state_until_their_turns_are_known(
    axis: int, step: int
) -> None:
    arm, known = drawn("tiago", 3000)
    rows = np.flatnonzero(known.words)
    fresh, before = known.words.copy(), known.words.copy()
    lines, words = np.empty_like(rows), np.empty(len(rows), np.uint64)
    states = np.empty((len(rows), *known.states.shape[1:]), np.float32)
    aim_beside(rows, axis, step, fresh, known, arm, GRID, lines, words, states)
    np.testing.assert_array_equal(known.words, before)
    at = np.array(np.unravel_index(rows, SHAPE)).T
    at[:, axis] += step
    if axis == 4:
        at[:, 4] %= SHAPE.azimuth
    outside = ((at < 0) | (at >= SHAPE)).any(1)
    np.testing.assert_array_equal(lines < 0, outside)
    inside = np.flatnonzero(~outside)
    expected = np.ravel_multi_index(tuple(at[inside].T), SHAPE)
    np.testing.assert_array_equal(lines[inside], expected)
    for i in inside[::5]:
        reached, found, last = before[lines[i]], np.uint64(0), {}
        tried: list[np.ndarray] = []
        for group, turns in enumerate(TURNS_OF):
            start = known.states[rows[i], group]
            if not fresh[rows[i]] & ~reached & turns or any((start == one).all() for one in tried):
                continue
            tried.append(start)
            word, state = aimed(at[i : i + 1].astype(float), start[None], np.array([reached]), arm)
            reached, found = reached | word[0], found | word[0]
            last |= {g: state[0] for g in range(GROUPS) if word[0] & TURNS_OF[g]}
        assert words[i] == found
        for g, state in last.items():
            np.testing.assert_array_equal(states[i, g], state)
    assert (words[inside] > 0).mean() > 0.2
    gained = np.zeros_like(known.words)
    add(lines, words, states, known, gained)
    won = np.flatnonzero(words)
    np.testing.assert_array_equal(known.words[lines[won]], before[lines[won]] | words[won])
    np.testing.assert_array_equal(gained[lines[won]], words[won])
    assert np.count_nonzero(gained) == len(won)


@pytest.mark.parametrize(("axis", "wanted"), [(0, ALL), (2, STORED), (4, ALL)])
def test_points_between_lines_are_reached_from_the_end_that_has_more_turns(
    axis: int, wanted: np.uint64
) -> None:
    arm, known = drawn("tiago", 4000)
    high = np.array(np.unravel_index(np.flatnonzero(known.words), SHAPE))
    high = high[:, high[axis] > 0][:, ::4]
    at = high.copy()
    at[axis] -= 1
    low, up = (np.ravel_multi_index(tuple(k), SHAPE) for k in (at, high))
    words = np.empty(len(low), np.uint64)
    aim_between(low, axis, wanted, known, arm, GRID, words)
    middle = np.ascontiguousarray(at.T, float)
    middle[:, axis] += 0.5
    for i in range(len(low)):
        ends = known.words[low[i]], known.words[up[i]]
        word = ends[0] & ends[1]
        for end, line in zip(ends, (low[i], up[i]), strict=True):
            for group, turns in enumerate(TURNS_OF):
                if end & ~word & wanted & turns:
                    start = known.states[line, group][None]
                    new, _ = aimed(middle[i : i + 1], start, np.array([word | ~wanted]), arm)
                    word |= new[0] & (ends[0] | ends[1])
        assert words[i] == word
    assert 0.2 < (words & wanted > 0).mean() < 1.0
    # Turns that both ends lack are not found between them.
    assert (words & ~(known.words[low] | known.words[up]) == 0).all()
