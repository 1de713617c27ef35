"""The first points of the order, however many, cover the cloud evenly."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.apps.web.scan_view import LEVELS, spread_order


def uneven(rng: np.random.Generator) -> np.ndarray:
    """Return points of a floor, and of an object with half of all points."""
    floor = rng.uniform([0.0, 0.0, 0.0], [8.0, 5.0, 0.02], (4000, 3))
    return np.concatenate([floor, rng.uniform([2.0, 2.0, 0.5], [2.1, 2.2, 0.7], (4000, 3))])


def cells_of(points: np.ndarray, depth: int) -> np.ndarray:
    """Return the cell of each point, as three numbers."""
    low, wide = points.min(0), np.ptp(points, axis=0).max()
    at = np.floor((points - low) / wide * 2**LEVELS).astype(int)
    return np.minimum(at, 2**LEVELS - 1) >> (LEVELS - depth)


@pytest.mark.parametrize("depth", [0, 3, 6, LEVELS])
def test_the_first_points_are_in_different_cells(depth: int) -> None:
    points = uneven(np.random.default_rng(3))
    order = spread_order(points, np.random.default_rng(0))
    every = cells_of(points, depth)
    count = len(np.unique(every, axis=0))
    assert len(np.unique(every[order[:count]], axis=0)) == count


def test_every_point_is_taken_once_in_an_order_that_depends_only_on_the_seed() -> None:
    points = uneven(np.random.default_rng(4))
    order = spread_order(points, np.random.default_rng(0))
    np.testing.assert_array_equal(np.sort(order), np.arange(len(points)))
    again = spread_order(points, np.random.default_rng(0))
    np.testing.assert_array_equal(order, again)
    assert (order != spread_order(points, np.random.default_rng(1))).any()


def test_few_points_leave_smaller_holes_than_a_random_choice() -> None:
    from scipy.spatial import cKDTree

    points = uneven(np.random.default_rng(5))
    order = spread_order(points, np.random.default_rng(0))
    chance = np.random.default_rng(0).permutation(len(points))
    for count in (200, 1000, 3000):
        holes = [cKDTree(points[taken[:count]]).query(points)[0] for taken in (order, chance)]
        even, by_chance = (np.quantile(hole, 0.99) for hole in holes)
        assert even < 0.9 * by_chance


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.ones((1, 3)), np.full((5, 3), 2.0)])
def test_empty_single_and_coincident_points_are_all_taken(points: np.ndarray) -> None:
    order = spread_order(points, np.random.default_rng(0))
    np.testing.assert_array_equal(np.sort(order), np.arange(len(points)))
