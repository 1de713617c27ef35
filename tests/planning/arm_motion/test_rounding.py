"""Rounded corners are smooth, free, and end where the path does."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float
from tests.planning.arm_motion.test_arm_planner import gantry, motions_of

from momapos.model.collision.spheres import Spheres
from momapos.model.kinematics.chain import Chain
from momapos.planning.arm_motion.arm_planner import (
    CORNER,
    RESOLUTION,
    fill_curve,
    interpolate,
    round_corners,
)

__all__ = ["gantry"]


def turns(states: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " k"]:
    """Return the angle between successive motions."""
    steps = np.diff(states, axis=0)
    unit = steps[np.linalg.norm(steps, axis=1) > 1e-9]
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    return np.asarray(np.arccos(np.clip((unit[1:] * unit[:-1]).sum(1), -1.0, 1.0)))


@pytest.mark.parametrize(
    "corners", [[[-1, 0], [0, 1], [1, 0]], [[-1, 0], [-0.8, 1], [-0.7, 0.2], [1, 1], [1, 0]]]
)
def test_a_path_without_obstacles_has_no_corners_left(
    gantry: tuple[Chain, Spheres], corners: list[list[float]]
) -> None:
    path = interpolate(np.array(corners, float))
    smooth = round_corners(path, motions_of(gantry), RESOLUTION)
    np.testing.assert_array_equal(smooth[[0, -1]], path[[0, -1]])
    assert turns(path).max() > 3 * CORNER
    assert turns(smooth).max() < CORNER
    assert np.abs(np.diff(smooth, axis=0)).max() < 1.1 * RESOLUTION


def test_a_corner_around_an_obstacle_stays_free(gantry: tuple[Chain, Spheres]) -> None:
    free = motions_of(gantry, (0.0, 0.0, 0.5, 0.5))
    for gap, rounded in ((0.5, True), (0.1, True), (0.011, False)):
        side = 0.5 + gap
        path = interpolate(np.array([[-side, 0.0], [-side, side], [side, side], [side, 0.0]]))
        smooth = round_corners(path, free, RESOLUTION)
        assert free.along(path)
        assert free.along(smooth)
        assert bool(turns(smooth).max() < CORNER) is rounded


def test_a_corner_without_room_remains(gantry: tuple[Chain, Spheres]) -> None:
    blocked = motions_of(gantry, (0.0, 0.0, 9.0, 9.0))
    path = interpolate(np.array([[-1.0, 0.0], [0.0, 1.0], [1.0, 0.0]]))
    np.testing.assert_array_equal(round_corners(path, blocked, RESOLUTION), path)


def test_a_filled_curve_contains_its_states_and_is_nearer_to_it() -> None:
    angle = np.linspace(0.0, 1.5, 7)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    filled = fill_curve(circle, 0.02)
    np.testing.assert_allclose(filled[:: (len(filled) - 1) // 6], circle, atol=1e-12)
    assert np.abs(np.diff(filled, axis=0)).max() < 0.022
    assert np.abs(np.linalg.norm(filled, axis=1) - 1.0).max() < 1e-3


@pytest.mark.parametrize("count", [3, 4, 5, 12, 80])
def test_a_filled_curve_is_the_not_a_knot_spline_of_scipy(count: int) -> None:
    from scipy.interpolate import CubicSpline

    states = np.random.default_rng(count).uniform(-3.0, 3.0, (count, 7))
    filled = fill_curve(states, 0.1)
    at = np.linspace(0.0, count - 1.0, len(filled))
    np.testing.assert_allclose(filled, CubicSpline(np.arange(count), states)(at), atol=1e-12)


def test_a_filled_curve_repeats_a_cubic() -> None:
    t = np.arange(9.0)[:, None]
    filled = fill_curve(t**3 - 5.0 * t**2, 7.0)
    u = np.linspace(0.0, 8.0, len(filled))[:, None]
    np.testing.assert_allclose(filled, u**3 - 5.0 * u**2, atol=1e-10)
