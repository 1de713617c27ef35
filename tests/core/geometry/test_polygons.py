"""Polygons on the floor agree with matplotlib and with dense sampling."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float
from matplotlib.path import Path
from numpy.testing import assert_allclose

from momapos.core.geometry.polygons import (
    all_inside,
    contains,
    edge_distances,
    inscribed_radius,
    signed_area,
    triangulated,
)

# A room with a niche: a straight line across the gap crosses the wall.
U_SHAPE = np.array([[0.0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]])
HEXAGON = np.array([[0.0, 0], [2, -0.4], [3.2, 0.1], [3, 2.2], [1.5, 3.1], [-0.1, 2.5]])


def star(corners: int, rng: np.random.Generator) -> Float[np.ndarray, "k 2"]:
    """Return a simple, usually nonconvex polygon, counterclockwise about the origin."""
    angle = np.sort(rng.uniform(-np.pi, np.pi, corners))
    radius = rng.uniform(0.3, 2.0, corners)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)


def to_edges(polygon: np.ndarray, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Reference: the distance of points from the outline."""
    a = polygon
    edge = np.roll(a, -1, axis=0) - a
    w = points[:, None] - a
    t = np.clip(np.einsum("nkd,kd->nk", w, edge) / (edge**2).sum(1), 0, 1)
    return np.linalg.norm(w - t[..., None] * edge, axis=-1).min(1)


@pytest.mark.parametrize("seed", range(20))
def test_contains_agrees_with_matplotlib(seed: int) -> None:
    rng = np.random.default_rng(seed)
    polygon = star(int(rng.integers(3, 15)), rng)
    points = rng.uniform(-2.2, 2.2, (500, 2))
    sure = to_edges(polygon, points) > 1e-9
    expected = Path(np.vstack([polygon, polygon[:1]]), closed=True).contains_points(points)
    np.testing.assert_array_equal(contains(polygon, points)[sure], expected[sure])
    np.testing.assert_array_equal(contains(polygon[::-1], points)[sure], expected[sure])


def test_points_level_with_corners_are_counted_once() -> None:
    """A ray through a corner meets two edges and must count exactly one."""
    diamond = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])
    points = np.array([[0.0, 0.0], [0.5, 0.0], [-2.0, 0.0], [2.0, 0.0], [-2.0, 1.0], [-2.0, -1.0]])
    np.testing.assert_array_equal(
        contains(diamond, points), [True, True, False, False, False, False]
    )


def rectangles(count: int, rng: np.random.Generator, size: float) -> Float[np.ndarray, "n 4 2"]:
    half = rng.uniform(0.05, size, (count, 1, 2))
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half
    yaw = rng.uniform(-np.pi, np.pi, count)
    R = np.stack([np.cos(yaw), -np.sin(yaw), np.sin(yaw), np.cos(yaw)], -1).reshape(-1, 2, 2)
    return corners @ np.swapaxes(R, 1, 2) + rng.uniform(-0.5, 3.5, (count, 1, 2))


@pytest.mark.parametrize("floor", [U_SHAPE, U_SHAPE[::-1], HEXAGON, HEXAGON[::-1]])
def test_an_outline_is_inside_if_all_points_of_its_edges_are(
    floor: Float[np.ndarray, "k 2"],
) -> None:
    rng = np.random.default_rng(0)
    outlines = rectangles(1500, rng, 0.5)
    t = np.linspace(0, 1, 60)[:, None, None]
    ends = np.roll(outlines, -1, axis=1)
    # Points along all edges: (60, n, 4, 2).
    along = outlines + t[..., None] * (ends - outlines)
    points = np.moveaxis(along, 1, 0).reshape(1500, -1, 2)
    flat = points.reshape(-1, 2)
    inside = contains(floor, flat).reshape(1500, -1)
    corner_near = np.array([to_edges(o, floor).min() for o in outlines]) < 0.03
    sure = ~corner_near
    expected = inside.all(1)
    assert 0.05 < expected.mean() < 0.9
    np.testing.assert_array_equal(all_inside(floor, outlines)[sure], expected[sure])


@pytest.mark.parametrize("floor", [U_SHAPE, HEXAGON])
def test_all_inside_accepts_an_empty_batch(floor: Float[np.ndarray, "k 2"]) -> None:
    assert all_inside(floor, np.zeros((0, 4, 2))).shape == (0,)


def test_all_corners_inside_is_not_enough() -> None:
    """A beam across the niche has its corners on the floor and its middle in the wall."""
    beam = np.array([[[0.2, 2.0], [2.8, 2.0], [2.8, 2.3], [0.2, 2.3]]])
    assert contains(U_SHAPE, beam[0]).all()
    assert not all_inside(U_SHAPE, beam)[0]
    assert all_inside(U_SHAPE, beam - [0, 1.5])[0]
    assert all_inside(U_SHAPE[::-1], beam - [0, 1.5])[0]


def test_an_outline_around_the_whole_floor_is_not_inside() -> None:
    around = np.array([[[-1.0, -1], [4, -1], [4, 4], [-1, 4]]])
    assert not all_inside(U_SHAPE, around)[0]


@pytest.mark.parametrize("seed", range(5))
def test_the_area_agrees_with_sampling_and_its_sign_with_the_orientation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    polygon = star(9, rng)
    points = rng.uniform(-2, 2, (40_000, 2))
    area = signed_area(polygon)
    assert_allclose(abs(area), 16 * contains(polygon, points).mean(), atol=0.15)
    assert_allclose(signed_area(polygon[::-1]), -area)
    assert_allclose(signed_area(polygon + 5), area)
    assert signed_area(U_SHAPE) == pytest.approx(7.0)


@pytest.mark.parametrize("seed", range(10))
def test_the_inscribed_circle_is_the_largest_that_fits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(-np.pi, np.pi, 8))
    convex = np.stack([1.2 * np.cos(angle), 0.8 * np.sin(angle)], -1) + rng.uniform(-0.1, 0.1, 2)
    radius = inscribed_radius(convex)
    turn = np.linspace(-np.pi, np.pi, 4000)
    circle = np.stack([np.cos(turn), np.sin(turn)], -1)
    if not contains(convex, np.zeros((1, 2)))[0]:
        assert radius == 0.0
        return
    assert contains(convex, (radius - 1e-6) * circle).all()
    assert not contains(convex, (radius + 1e-4) * circle).all()


def test_the_inscribed_radius_is_zero_if_the_origin_is_outside() -> None:
    assert inscribed_radius(np.array([[1.0, 0], [2, 0], [2, 1], [1, 1]])) == 0.0


def test_edge_distances_of_a_batch_agree_with_the_reference() -> None:
    rng = np.random.default_rng(3)
    polygons = np.stack([star(7, rng) for _ in range(5)])
    points = rng.uniform(-3, 3, (5, 40, 2))
    expected = [to_edges(polygon, some) for polygon, some in zip(polygons, points, strict=True)]
    assert_allclose(edge_distances(points, polygons), expected, atol=1e-12)


def test_a_floor_with_a_notch_is_covered_once() -> None:
    notched = np.array([[0, 0], [4, 0], [4, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3.0]])
    for polygon in (notched, notched[::-1].copy()):
        a, b, c = (polygon[triangulated(polygon)[:, k]] for k in range(3))
        u, v = b - a, c - a
        areas = (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2
        assert (areas > 0).all()
        assert areas.sum() == pytest.approx(10.0)
