"""Laws of the drivable floor."""

from __future__ import annotations

import numpy as np
import pytest
from tests.planning.navigation.boxes import room, square

from momapos.core.geometry.polygons import inscribed_radius
from momapos.model.robots.robot import load_robot
from momapos.planning.navigation.convex_polygons import ConvexPolygons, _covered, pack
from momapos.planning.navigation.reachable_floor import drivable_floor

START = np.array([-2.0, 0.0, 0.0])
ROBOT = load_robot("fetch")
RADIUS = float(inscribed_radius(ROBOT.footprint))


@pytest.mark.parametrize("extra", [-0.02, 0.06])
def test_a_doorway_is_passed_if_the_circle_fits_with_a_cell_to_spare(extra: float) -> None:
    gap = 2 * RADIUS + extra
    length = 3.0 - gap / 2
    walls = [(0.0, s * (gap / 2 + length / 2), 0.1, length, 0.0) for s in (1, -1)]
    found = drivable_floor(room(walls, floor=square(6.0)), ROBOT, START)
    share = found.reachable_area / found.free_area
    assert share == pytest.approx(1.0 if extra > 0 else 0.5, abs=0.02)


def test_the_free_area_of_an_empty_floor_is_that_of_the_shrunken_square() -> None:
    found = drivable_floor(room([], floor=square(6.0)), ROBOT, START)
    assert found.free_area == pytest.approx((6 - 2 * RADIUS) ** 2, rel=0.02)
    assert found.reachable_area == found.free_area
    assert np.abs(found.cells).max() < 3 - RADIUS + 0.01


def test_obstacles_above_the_base_do_not_count() -> None:
    wall = [(0.0, 0.0, 0.1, 6.0, 0.0)]
    above = drivable_floor(room(wall, floor=square(6.0), low=1.2, high=1.9), ROBOT, START)
    empty = drivable_floor(room([], floor=square(6.0)), ROBOT, START)
    assert above.free_area == empty.free_area


def test_covered_outlines_are_those_inside_another_one() -> None:
    rng = np.random.default_rng(3)
    polygons, layers = [], []
    for _ in range(150):
        angle = np.sort(rng.uniform(0, 2 * np.pi, 6))
        shape = np.column_stack([np.cos(angle), np.sin(angle)]) * rng.uniform(0.05, 0.8)
        polygons.append(shape + rng.uniform(-0.3, 0.3, 2))
        layers.append(int(rng.integers(2)))
    polygons, layers = [*polygons, polygons[0], polygons[1]], [*layers, layers[0], layers[1]]
    outlines = pack(polygons, layers, ["x"] * len(polygons))
    assert _covered(outlines).tolist() == _covered_reference(outlines).tolist()
    assert 10 < _covered(outlines).sum() < 150


def _covered_reference(outlines: ConvexPolygons) -> np.ndarray:
    covered = np.zeros(len(outlines), bool)
    for i in (k for k in range(len(outlines))):
        if covered[i]:
            continue
        edge = slice(outlines.first[i], outlines.first[i + 1])
        beyond = (outlines.corner @ outlines.normal[edge].T > outlines.level[edge] + 1e-9).any(1)
        inner = ~np.logical_or.reduceat(beyond, outlines.first[:-1])
        inner &= outlines.layer == outlines.layer[i]
        inner[i] = False
        covered |= inner
    return covered
