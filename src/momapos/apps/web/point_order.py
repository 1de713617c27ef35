"""An order of points whose first ones, however many, cover a cloud evenly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt32

LEVELS = 10
"""Levels of the octree over the cloud: 1,024 cells along each edge, of 4 cm in 40 m [-]."""
MORTON_STEPS = ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249))
"""Shifts and masks that put two zeros between ten bits."""


def spread_order(
    points: Float[np.ndarray, "n 3"], rng: np.random.Generator
) -> Int[np.ndarray, " n"]:
    """Order points by one of each cell of a coarse grid, then of a grid twice as fine, and so on.

    A random order would oversample dense regions and leave holes elsewhere.

    Args:
        points: The cloud [m].
        rng: Chooses the point of a cell.

    Returns:
        Indices into the points.
    """
    count = len(points)
    if count == 0:
        return np.zeros(0, np.int64)
    # The point with the lowest rank in a cell has it in its subcell, too: none is taken twice.
    order = rng.permutation(count)
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    cells = morton(points)
    sorted_by_cell = np.argsort(cells)
    cells, ranks = cells[sorted_by_cell], rank[sorted_by_cell]
    level = np.full(count, LEVELS + 1)
    for depth in range(LEVELS, -1, -1):
        cell = cells >> np.uint32(3 * (LEVELS - depth))
        begins = np.flatnonzero(np.diff(cell, prepend=cell[0] + 1))
        level[order[np.minimum.reduceat(ranks, begins)]] = depth
    return np.argsort(level * count + rank)


def morton(points: Float[np.ndarray, "n 3"]) -> UInt32[np.ndarray, " n"]:
    """Return the Morton codes of points in the finest grid; those of a larger cell are contiguous.

    By Morton: A computer oriented geodetic data base, 1966.
    """
    low = points.min(axis=0)
    edge = float(np.ptp(points, axis=0).max()) / 2**LEVELS
    cells = ((points - low) / (edge or 1.0)).astype(np.uint32)
    cells = np.minimum(cells, np.uint32(2**LEVELS - 1))
    for shift, mask in MORTON_STEPS:
        cells = (cells | (cells << np.uint32(shift))) & np.uint32(mask)
    return cells[:, 0] | (cells[:, 1] << np.uint32(1)) | (cells[:, 2] << np.uint32(2))
