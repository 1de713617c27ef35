"""Outlines of tops are covered by rectangles."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.perception.segmentation.supports import FloorRaster, Rectangle, rectangles

CELL = 0.03


def covered(*solid: tuple[int, int, int, int]) -> list[Rectangle]:
    """Return the rectangles of an outline filled in these cells, in cells."""
    mask = np.zeros((150, 150), bool)
    for x0, y0, x1, y1 in solid:
        mask[x0:x1, y0:y1] = True
    raster = FloorRaster(np.zeros(2), mask.shape, CELL)
    found = np.array(rectangles(mask, raster)) / CELL
    return [tuple(row) for row in np.rint(found).astype(int).tolist()]


@pytest.mark.parametrize("begins", [6, 38])
def test_a_piece_deeper_than_its_row_extends_from_its_front_to_the_wall(begins: int) -> None:
    row, desk = (30, 66, 45, 150), (12, begins, 45, 66)
    assert set(covered(row, desk)) == {desk, row}


def test_taller_neighbors_hide_the_rear_of_a_top() -> None:
    rear, front = (30, 12, 45, 145), (12, 6, 30, 66)
    assert covered(rear, front) == [(12, 6, 45, 66), (30, 66, 45, 145)]


def test_the_arm_of_a_corner_is_not_a_deeper_piece_of_the_other_arm() -> None:
    arms = covered((25, 10, 45, 110), (45, 90, 120, 110))
    assert arms == [(25, 10, 45, 90), (45, 90, 120, 110), (25, 90, 45, 110)]


def test_a_top_does_not_grow_into_another_one_behind_its_front() -> None:
    rear, front, beside = (30, 12, 45, 145), (12, 6, 30, 66), (36, 0, 70, 11)
    assert {front, (30, 12, 45, 66), (30, 66, 45, 145)} < set(covered(rear, front, beside))
