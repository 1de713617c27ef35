"""Convex hulls on the floor."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from momapos.core.geometry.polygons import convex_hull, signed_area


@pytest.mark.parametrize("count", [3, 4, 10, 100, 1000])
@pytest.mark.parametrize("seed", range(3))
def test_the_corners_equal_those_of_qhull(count: int, seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(count, 2))
    found, expected = convex_hull(points), points[ConvexHull(points).vertices]
    first = int(np.lexsort((expected[:, 1], expected[:, 0]))[0])
    np.testing.assert_array_equal(found, np.roll(expected, -first, axis=0))
    assert signed_area(found) > 0


def test_repeated_points_and_points_on_edges_are_not_corners() -> None:
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 5), np.linspace(0, 0.3, 4)), -1).reshape(-1, 2)
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    points = np.concatenate([grid, grid[::-1]]) @ turn.T
    corners = np.array([[-1, 0], [1, 0], [1, 0.3], [-1, 0.3]]) @ turn.T
    found = convex_hull(points)
    first = int(np.argmin(corners[:, 0]))
    np.testing.assert_allclose(found, np.roll(corners, -first, axis=0), atol=1e-12)
