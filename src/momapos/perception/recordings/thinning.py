"""Thin large clouds, and move clouds from far away to the origin, before anything is computed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .ply import Columns

if TYPE_CHECKING:
    from jaxtyping import Float, Int

AXES = ("x", "y", "z")
"""Usual names of the columns of coordinates."""
MAX_POINTS = 1_500_000
"""Larger clouds are thinned [-]: a kitchen fused in voxels of 15 mm has about 400,000 points."""
SPACING = 0.01
"""Edge of the cells of which a thinned cloud has one point each [m]."""
MAX_DISTANCE = 1e9
"""Larger coordinates are damaged [m]; coordinates of maps reach 1e7 m."""
FAR = 1000.0
"""Clouds whose middle is farther from the origin are moved to it [m]."""
_BITS = 21
"""Bits of a cell's number along each axis."""
_CHUNK = 2_000_000


def origin_of(columns: Columns) -> Float[np.ndarray, "3"] | None:
    """Return the middle of a cloud in whole meters if it is far from the origin, else None."""
    step = max(1, len(columns["x"]) // 100_000)
    with np.errstate(invalid="ignore"):
        sample = np.stack([columns[name][::step].astype(float) for name in AXES], axis=1)
        sample = sample[(np.abs(sample) < MAX_DISTANCE).all(axis=1)]
    if not len(sample):
        return None
    middle = np.round(np.median(sample, axis=0))
    return middle if np.abs(middle).max() > FAR else None


def thinned(
    columns: Columns, origin: Float[np.ndarray, "3"]
) -> tuple[Int[np.ndarray, " kept"], Int[np.ndarray, " file"], float]:
    """Choose one point per cell of a large cloud, and all points of a small one.

    Args:
        columns: Coordinates by name.
        origin: Subtracted from the coordinates [m].

    Returns:
        Indices of the chosen points, ascending; the number of the chosen point for each point of
        the file, -1 if it is not finite; and the edge of the cells [m], 0 if none is left out.
    """
    count = len(columns["x"])
    finite = np.empty(count, bool)
    for start in range(0, count, _CHUNK):
        finite[start : start + _CHUNK] = np.isfinite(_part(columns, origin, start)).all(axis=1)
    rows = np.where(finite, np.cumsum(finite, dtype=np.int32) - 1, np.int32(-1))
    kept, spacing = np.flatnonzero(finite), 0.0
    while len(kept) > MAX_POINTS:
        spacing = SPACING if spacing == 0.0 else 1.5 * spacing
        cells = np.concatenate([
            _cells(_part(columns, origin, start, kept), spacing)
            for start in range(0, len(kept), _CHUNK)
        ])  # fmt: skip
        first, number = _first_of_each(cells)
        rows = np.where(finite, number[np.maximum(rows, 0)], np.int32(-1))
        kept = kept[first]
    return kept, rows, spacing


def _part(
    columns: Columns,
    origin: Float[np.ndarray, "3"],
    start: int,
    among: Int[np.ndarray, " kept"] | None = None,
) -> Float[np.ndarray, "n 3"]:
    """Return some points from `start` on, moved; NaN or infinite if damaged."""
    which = slice(start, start + _CHUNK) if among is None else among[start : start + _CHUNK]
    with np.errstate(invalid="ignore", over="ignore"):
        points = np.stack([columns[name][which].astype(float) for name in AXES], axis=1)
        points[~(np.abs(points) < MAX_DISTANCE)] = np.nan
    return points - origin


def _cells(points: Float[np.ndarray, "n 3"], spacing: float) -> Int[np.ndarray, " n"]:
    """Return one number per cell; cells many kilometers away share numbers."""
    index = np.floor(points / spacing).astype(np.int64) & (2**_BITS - 1)
    return (index[:, 0] << 2 * _BITS) | (index[:, 1] << _BITS) | index[:, 2]


def _first_of_each(
    cells: Int[np.ndarray, " n"],
) -> tuple[Int[np.ndarray, " kept"], Int[np.ndarray, " n"]]:
    """Return the first entry of each number, ascending, and which of them each entry belongs to."""
    order = np.argsort(cells, kind="stable").astype(np.int32)
    cells = cells[order]
    new = np.concatenate([[True], cells[1:] != cells[:-1]])
    del cells
    first = order[new]
    group = np.cumsum(new, dtype=np.int32) - 1
    ranks = np.empty(len(first), np.int32)
    ranks[np.argsort(first)] = np.arange(len(first), dtype=np.int32)
    number = np.empty(len(order), np.int32)
    number[order] = ranks[group]
    return np.sort(first), number
