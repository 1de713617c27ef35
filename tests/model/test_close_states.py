"""The executed curve of a motion stays near the straight motions between its states."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.model.records.plans import Hold, Motion
from momapos.model.trajectory import MAX_DEVIATION, deviation, time_path, with_close_states

STEP = 0.004


def planned(q: np.ndarray, **more: object) -> Motion:
    Ts = np.tile(np.eye(4), (len(q), 1, 1))
    return Motion(q[:1], q, np.linspace(0.0, 1.5, len(q)), Ts, **more)  # type: ignore[arg-type]


def closer(motion: Motion) -> Motion:
    return with_close_states(motion, lambda q, _: np.tile(np.eye(4), (len(q), 1, 1)))


def executed_off(q: np.ndarray) -> float:
    """Return how far the timed trajectory gets from the straight motions between states."""
    n = q.shape[1]
    timed = time_path(q, np.full(n, 1.0), np.full(n, 2.0), STEP)
    at = np.searchsorted(timed.state_times, np.arange(len(timed)) * STEP, side="right") - 1
    a, b = q[np.clip(at, 0, len(q) - 2)], q[np.clip(at, 0, len(q) - 2) + 1]
    d = b - a
    share = np.clip(((timed.q - a) * d).sum(1) / (d * d).sum(1), 0.0, 1.0)
    return float(np.abs(timed.q - a - share[:, None] * d).max())


def arc(count: int, radius: float, turn: float) -> np.ndarray:
    angle = np.linspace(0.0, turn, count)
    return radius * np.column_stack([np.cos(angle), np.sin(angle), 0.3 * angle])


WIDE = arc(12, 1.0, 2.0)
CURVES = {
    "a wide arc": arc(12, 1.2, 2.5),
    "a tight arc": arc(12, 0.4, 3.0),
    "a wave": np.column_stack([np.linspace(0, 3, 20), np.sin(np.linspace(0, 4, 20))]),
    "an arc after a corner": np.vstack([WIDE, WIDE[-1] + [0.0, 0.0, 0.2]]),
}


@pytest.mark.parametrize("curve", CURVES)
def test_added_states_keep_the_executed_curve_near_the_straight_motions(curve: str) -> None:
    q = CURVES[curve]
    motion = closer(planned(q))
    assert executed_off(q) > 2.0 * MAX_DEVIATION  # before
    assert executed_off(motion.q) < 1.2 * MAX_DEVIATION
    assert deviation(q).max() == pytest.approx(executed_off(q), rel=0.3)


@pytest.mark.parametrize("curve", CURVES)
def test_added_states_are_on_the_curve_and_the_others_remain(curve: str) -> None:
    q, holds = CURVES[curve], (Hold(1, 4), Hold(6, 9))
    motion = closer(planned(q, holds=holds))
    kept = [int(np.abs(motion.q - state).max(1).argmin()) for state in q]
    np.testing.assert_allclose(motion.q[kept], q, atol=1e-12)
    np.testing.assert_allclose(motion.object_q[kept], np.linspace(0.0, 1.5, len(q)), atol=1e-12)
    assert [(h.first, h.last) for h in motion.holds] == [
        (kept[h.first], kept[h.last]) for h in holds
    ]
    assert len(motion.q) == len(motion.object_q) == len(motion.Ts_world_tool)


def test_a_circle_is_followed_between_its_states() -> None:
    motion = closer(planned(arc(12, 1.2, 2.5)))
    radius = np.linalg.norm(motion.q[:, :2], axis=1)
    inner = (motion.object_q > 0.3) & (motion.object_q < 1.2)
    assert np.abs(radius[inner] - 1.2).max() < 1e-3


def test_the_part_never_turns_back_and_rests_where_it_rested() -> None:
    q = arc(16, 1.0, 2.5)
    part = np.concatenate([np.zeros(4), np.linspace(0.0, 1.0, 8), np.ones(4)])
    motion = closer(Motion(q[:1], q, part, np.tile(np.eye(4), (16, 1, 1)), holds=(Hold(3, 11),)))
    assert (np.diff(motion.object_q) >= -1e-12).all()
    (hold,) = motion.holds
    assert (motion.object_q[: hold.first + 1] == 0.0).all()
    assert (motion.object_q[hold.last :] == 1.0).all()


def test_straight_motions_rests_and_moving_bases_keep_their_states() -> None:
    straight = np.linspace([0.0, 0.0], [1.0, 2.0], 5)
    twice = np.repeat(straight, 2, axis=0)
    for q in (straight, twice, straight[:2], straight[:1]):
        np.testing.assert_array_equal(closer(planned(q)).q, q)
    bent = np.column_stack([arc(8, 1.0, 1.5)[:, :2], np.linspace(0.0, 0.5, 8)])
    still = np.zeros((8, 2)) + np.linspace(0.0, 1.0, 8)[:, None]
    moved = closer(planned(still, base=bent))
    assert len(moved.q) == len(moved.base) > 8
