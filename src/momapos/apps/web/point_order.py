"""Points in an order in which the first of them, however many, cover a cloud evenly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt32

HALVINGS = 10
"""The cube about the cloud is halved so often along each edge: 1,024 cells of 4 cm in 40 m."""
SPACING = ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249))
"""Shifts and masks that put two zeros between ten bits."""


def spread_order(
    points: Float[np.ndarray, "n 3"], rng: np.random.Generator
) -> Int[np.ndarray, " n"]:
    """One point of each cell of a coarse grid first, then of each of a grid twice as fine, and on.

    Points by chance alone are most where the cloud is dense, and leave holes where it is not.

    Args:
        points: The cloud [m].
        rng: By which a point of a cell is chosen.

    Returns:
        Indices into the points.
    """
    count = len(points)
    if count == 0:
        return np.zeros(0, np.int64)
    # The least of a larger cell is the least of its smaller one, too: no point is taken twice.
    order = rng.permutation(count)
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    cells = morton(points)
    sorted_by_cell = np.argsort(cells)
    cells, ranks = cells[sorted_by_cell], rank[sorted_by_cell]
    level = np.full(count, HALVINGS + 1)
    for halvings in range(HALVINGS, -1, -1):
        cell = cells >> np.uint32(3 * (HALVINGS - halvings))
        begins = np.flatnonzero(np.diff(cell, prepend=cell[0] + 1))
        level[order[np.minimum.reduceat(ranks, begins)]] = halvings
    return np.argsort(level * count + rank)


def morton(points: Float[np.ndarray, "n 3"]) -> UInt32[np.ndarray, " n"]:
    """Cells of the finest grid, numbered so that those of a larger cell are in one row.

    By Morton: A computer oriented geodetic data base, 1966.
    """
    low = points.min(axis=0)
    edge = float(np.ptp(points, axis=0).max()) / 2**HALVINGS
    cells = ((points - low) / (edge or 1.0)).astype(np.uint32)
    cells = np.minimum(cells, np.uint32(2**HALVINGS - 1))
    for shift, mask in SPACING:
        cells = (cells | (cells << np.uint32(shift))) & np.uint32(mask)
    return cells[:, 0] | (cells[:, 1] << np.uint32(1)) | (cells[:, 2] << np.uint32(2))
