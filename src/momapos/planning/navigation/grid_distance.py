"""Distances over the cells of a floor: to the nearest blocked cell, and along paths."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import B2, F1, I1, I2, entry

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_QUADRANT = ((1, 0), (1, 1), (2, 1), (1, 2))
_MOVES = np.array([m for a, b in _QUADRANT for m in ((a, b), (-b, a), (-a, -b), (b, -a))])
"""Steps (rows, columns) to sixteen neighbors of a cell: lengths are at most 2.7 % too long."""
_LENGTHS: np.ndarray = np.hypot(_MOVES[:, 0], _MOVES[:, 1])


def clearance(
    blocked: Bool[np.ndarray, "rows columns"], *, cap: float = np.inf
) -> Float[np.ndarray, "rows columns"]:
    """Compute the distance between the centers of each cell and the nearest blocked cell [cells].

    Args:
        blocked: Which cells are blocked; without any, distances are infinite.
        cap: Upper bound of the distances [cells].
    """
    return _clearance(np.ascontiguousarray(blocked), float(cap))


def path_lengths(
    free: Bool[np.ndarray, "rows columns"], sources: Int[np.ndarray, " s"], cell: float
) -> Float[np.ndarray, "rows columns"]:
    """Compute the length of the shortest path over free cells from the nearest source to each cell.

    Args:
        free: Which cells are free.
        sources: Flat indices of free cells.
        cell: Edge of a cell [m].

    Returns:
        Lengths [m], infinite without a path.
    """
    sources = np.ascontiguousarray(sources, np.int64)
    return _path_lengths(np.ascontiguousarray(free), sources, _MOVES, cell * _LENGTHS)


@entry
def _clearance(blocked: B2, most: float) -> np.ndarray:
    """Compute the exact Euclidean distance transform: along the columns, then along the rows."""
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
            best = min(line[j], most) ** 2
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
    """Run Dijkstra's algorithm (1959) with two unsorted lists as queue (Davidson et al. 2014).

    Cells below a bound are processed in any order, the others wait; then the bound rises by the
    shortest step. A cell whose length decreases is processed again, so the lengths equal those of
    a sorted queue to the last bit.
    """
    rows, columns = free.shape
    out, taken = np.full((rows, columns), np.inf), np.full((rows, columns), np.inf)
    step = lengths.min()
    bound = step
    near, far = [np.int64(-1)], [np.int64(-1)]
    for source in sources:
        out[source // columns, source % columns] = 0.0
        near.append(source)
    while True:
        while near[-1] >= 0:
            cell = near.pop()
            i, j = cell // columns, cell % columns
            length = out[i, j]
            if length == taken[i, j]:
                continue
            taken[i, j] = length
            for k in range(len(moves)):
                a, b = i + moves[k, 0], j + moves[k, 1]
                if a < 0 or b < 0 or a >= rows or b >= columns or not free[a, b]:
                    continue
                if length + lengths[k] < out[a, b]:
                    out[a, b] = length + lengths[k]
                    (near if out[a, b] < bound else far).append(a * columns + b)
        if len(far) == 1:
            return out
        bound += step
        waiting, far = far, [np.int64(-1)]
        for cell in waiting[1:]:
            length = out[cell // columns, cell % columns]
            if length < taken[cell // columns, cell % columns]:
                (near if length < bound else far).append(cell)
