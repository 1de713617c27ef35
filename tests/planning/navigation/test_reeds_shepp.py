"""Curves of a car-like base between two poses."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float

from momapos.core.compiled import F2, F3, I1, entry
from momapos.core.geometry.transforms import wrap_angle
from momapos.planning.navigation.reeds_shepp import (
    MAX_CURVES,
    MAX_PIECES,
    along,
    bend_between,
    curves_between,
    shortest_lengths,
)

RADIUS = 0.8


@entry
def _all_curves(a: F2, b: F2, radius: float, out: F3, count: I1) -> int:
    """Compute the curves between pairs of poses, one pair after the other; return their number."""
    total = 0
    for k in range(len(a)):
        count[k] = curves_between(a[k], b[k], radius, out[total:])
        total += count[k]
    return total


@entry
def _bends(a: F2, b: F2, radius: float, out: F3) -> int:
    total = 0
    for k in range(len(a)):
        total += bend_between(a[k], b[k], radius, out[total:])
    return total


@entry
def _along(poses: F2, curves: F3) -> np.ndarray:
    out = poses.copy()
    for k in range(len(poses)):
        for piece in range(curves.shape[1]):
            along(out[k], curves[k, piece, 0], curves[k, piece, 1], out[k])
    return out


def driven(
    start: Float[np.ndarray, "n 3"], curves: Float[np.ndarray, "n p 2"]
) -> Float[np.ndarray, "n 3"]:
    """Return the ends of curves, by the closed form of an arc around its center."""
    x, y, yaw = start.T
    for length, curvature in np.moveaxis(curves, 1, 0).transpose(0, 2, 1):
        straight = np.abs(curvature) < 1e-12
        bent = np.where(straight, 1.0, curvature)
        after = yaw + curvature * length
        x = x + np.where(straight, length * np.cos(yaw), (np.sin(after) - np.sin(yaw)) / bent)
        y = y + np.where(straight, length * np.sin(yaw), (np.cos(yaw) - np.cos(after)) / bent)
        yaw = after
    return np.stack([x, y, yaw], -1)


@pytest.fixture(scope="module")
def pairs() -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of poses: far, near, with equal headings, and equal ones."""
    rng = np.random.default_rng(0)
    a, b = rng.uniform(-3, 3, (2, 400, 3))
    b[100:200] = a[100:200] + rng.normal(0, 0.05, (100, 3))
    b[200:300, 2] = a[200:300, 2]
    b[300:350] = a[300:350] + np.array([[0.0, 0.0, 1.0]]) * rng.uniform(-3, 3, (50, 1))
    b[350] = a[350]
    return a, b


def test_every_curve_ends_at_its_goal_and_turns_no_tighter(
    pairs: tuple[np.ndarray, np.ndarray],
) -> None:
    a, b = pairs
    curves, count = np.zeros((len(a) * MAX_CURVES, MAX_PIECES, 2)), np.zeros(len(a), np.int64)
    total = _all_curves(a, b, RADIUS, curves, count)
    assert count.min() >= 1
    assert count.max() <= MAX_CURVES
    start, goal = np.repeat(a, count, axis=0), np.repeat(b, count, axis=0)
    ends = driven(start, curves[:total])
    np.testing.assert_allclose(ends[:, :2], goal[:, :2], atol=1e-6)
    np.testing.assert_allclose(wrap_angle(ends[:, 2] - goal[:, 2]), 0.0, atol=1e-6)
    assert np.abs(curves[:total, :, 1]).max() <= 1 / RADIUS + 1e-9
    np.testing.assert_allclose(_along(start, curves[:total])[:, :2], ends[:, :2], atol=1e-9)


@pytest.mark.parametrize(
    ("goal", "length"),
    [
        # Lengths of OMPL 2.0.1 (`ReedsSheppStateSpace(1.0).distance`), which agree with ours to
        # 1e-13 in 3000 random pairs.
        ((2.0, 0.0, 0.0), 2.0),
        ((0.0, 0.0, 3.1416), 3.141593),
        ((0.0, 1.0, 0.0), 2.636232),
        ((-0.3, 0.2, 0.4), 1.096305),
        ((3.0, -2.0, 2.5), 4.717383),
        ((0.5, 0.1, -1.2), 1.266496),
        ((0.0, 4.0, 3.1416), 5.141593),
        ((-2.0, -1.0, -0.7), 2.781013),
        ((0.1, 0.3, 1.5), 1.5),
        ((1.2, 1.9, -2.9), 3.306791),
    ],
)
def test_the_shortest_length_is_that_of_reeds_and_shepp(
    goal: tuple[float, float, float], length: float
) -> None:
    start, end = np.zeros((1, 3)), np.array([goal])
    assert shortest_lengths(start, end, 1.0)[0] == pytest.approx(length, abs=1e-5)
    wide = end * [2.5, 2.5, 1.0]
    assert shortest_lengths(start, wide, 2.5)[0] == pytest.approx(2.5 * length, abs=1e-4)


def test_a_curve_is_as_long_backwards_and_no_shorter_than_the_distance(
    pairs: tuple[np.ndarray, np.ndarray],
) -> None:
    a, b = pairs
    there, back = shortest_lengths(a, b, RADIUS), shortest_lengths(b, a, RADIUS)
    np.testing.assert_allclose(there, back, atol=1e-6)
    turn = np.abs(wrap_angle(b[:, 2] - a[:, 2]))
    assert (there >= np.hypot(*(b - a)[:, :2].T) - 1e-9).all()
    assert (there >= RADIUS * turn - 1e-6).all()
    detour = shortest_lengths(a, np.roll(b, 1, 0), RADIUS) + shortest_lengths(
        np.roll(b, 1, 0), b, RADIUS
    )
    assert (there <= detour + 1e-6).all()


def test_a_bend_is_a_straight_piece_and_one_wide_arc() -> None:
    rng = np.random.default_rng(1)
    start = rng.uniform(-2, 2, (200, 3))
    before, after = rng.uniform(0.4, 1.0, (2, 200)) * rng.choice([-1.0, 1.0], 200)
    turn = rng.uniform(0.1, 0.4, 200) * rng.choice([-1.0, 1.0], 200)
    yaw = start[:, 2] + turn
    x = start[:, 0] + before * np.cos(start[:, 2]) + after * np.cos(yaw)
    y = start[:, 1] + before * np.sin(start[:, 2]) + after * np.sin(yaw)
    goal = np.stack([x, y, wrap_angle(yaw)], -1)
    curves = np.zeros((200, MAX_PIECES, 2))
    assert _bends(start, goal, RADIUS, curves) == 200
    ends = driven(start, curves)
    np.testing.assert_allclose(ends[:, :2], goal[:, :2], atol=1e-6)
    assert (np.abs(curves[:, :, 0]) > 1e-9).sum(1).max() <= 2
    assert np.abs(curves[:, :, 1]).max() < 1 / RADIUS
    assert (curves[:, :, 0] * np.sign(before)[:, None] >= -1e-9).all()
