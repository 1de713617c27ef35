"""Distances over the cells of a floor: to what is blocked, and along paths."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

import numpy as np

from momapos.compiled import B2, F1, I1, I2, entry

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_QUADRANT = ((1, 0), (1, 1), (2, 1), (1, 2))
_MOVES = np.array([m for a, b in _QUADRANT for m in ((a, b), (-b, a), (-a, -b), (b, -a))])
"""Steps (rows, columns) to the sixteen cells around a cell: lengths are at most 2.7 % too long."""
_LENGTHS: np.ndarray = np.hypot(_MOVES[:, 0], _MOVES[:, 1])


def clearance(blocked: Bool[np.ndarray, "rows columns"]) -> Float[np.ndarray, "rows columns"]:
    """Distance of each cell's center from that of the nearest blocked cell [cells].

    Infinite where nothing is blocked.
    """
    return _clearance(np.ascontiguousarray(blocked))


def path_lengths(
    free: Bool[np.ndarray, "rows columns"], sources: Int[np.ndarray, " s"], cell: float
) -> Float[np.ndarray, "rows columns"]:
    """Length of the shortest path to each cell from the nearest source, over free cells.

    Args:
        free: Cells that paths can lead through.
        sources: Flat indices of free cells.
        cell: Edge of a cell [m].

    Returns:
        Lengths [m], infinite where no path leads.
    """
    sources = np.ascontiguousarray(sources, np.int64)
    return _path_lengths(np.ascontiguousarray(free), sources, _MOVES, cell * _LENGTHS)


@entry
def _clearance(blocked: B2) -> np.ndarray:
    """The exact Euclidean distance transform: along the columns, then along the rows."""
    rows, columns = blocked.shape
    out = np.full((rows, columns), np.inf)
    for j in range(columns):
        last = np.inf
        for i in range(rows):
            last = 0.0 if blocked[i, j] else last + 1
            out[i, j] = last
        for i in range(rows - 2, -1, -1):
            out[i, j] = min(out[i, j], out[i + 1, j] + 1)
    line = np.empty(columns)
    for i in range(rows):
        for j in range(columns):
            line[j] = out[i, j]
        for j in range(columns):
            best = line[j] ** 2
            for d in range(1, columns):
                if d * d >= best:
                    break
                if j - d >= 0:
                    best = min(best, line[j - d] ** 2 + d * d)
                if j + d < columns:
                    best = min(best, line[j + d] ** 2 + d * d)
            out[i, j] = np.sqrt(best)
    return out


@entry
def _path_lengths(free: B2, sources: I1, moves: I2, lengths: F1) -> np.ndarray:
    """Dijkstra 1959."""
    rows, columns = free.shape
    out = np.full((rows, columns), np.inf)
    queue = [(np.inf, np.int64(-1))]
    for source in sources:
        out[source // columns, source % columns] = 0.0
        heapq.heappush(queue, (0.0, source))
    while True:
        length, cell = heapq.heappop(queue)
        if cell < 0:
            return out
        i, j = cell // columns, cell % columns
        if length > out[i, j]:
            continue
        for k in range(len(moves)):
            a, b = i + moves[k, 0], j + moves[k, 1]
            if a < 0 or b < 0 or a >= rows or b >= columns or not free[a, b]:
                continue
            if length + lengths[k] < out[a, b]:
                out[a, b] = length + lengths[k]
                heapq.heappush(queue, (out[a, b], a * columns + b))
