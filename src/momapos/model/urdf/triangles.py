"""Triangle soups: intersect with lines, cut, close rims, find connected parts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_WELD = 1e-5
"""Grid to which corners are rounded to find equal ones [m]."""
TOUCH = 5e-4
"""Surfaces are connected if the distance of their bounding boxes is at most this [m]."""
_SLIVER = 1e-13
"""Triangles with less than this double area are ignored [m^2]."""


def hits_along(
    triangles: Float[np.ndarray, "t 3 3"],
    axis: int,
    u: Float[np.ndarray, " a"],
    v: Float[np.ndarray, " b"],
) -> tuple[Float[np.ndarray, "a b"], Float[np.ndarray, "a b"]]:
    """Return where lines along an axis first and last hit a surface; inf and -inf for no hit."""
    first, last = np.full((len(u), len(v)), np.inf), np.full((len(u), len(v)), -np.inf)
    x, y = [triangles[..., k] for k in range(3) if k != axis]
    i, j, which = _lines_of(x, y, u, v)
    a, b, c = (np.stack([x[which, k], y[which, k]], -1) for k in range(3))
    point = np.stack([u[i], v[j]], -1)
    area = _turn(b - a, c - a)
    weight = np.stack([_turn(b - point, c - point), _turn(c - point, a - point)], -1)
    upright = np.abs(area) < _SLIVER  # parallel to the lines
    weight = weight / np.where(upright, 1.0, area)[:, None]
    weight = np.column_stack([weight, 1.0 - weight.sum(1)])
    met = ~upright & (weight >= -1e-9).all(1)
    z = (weight[met] * triangles[which[met], :, axis]).sum(1)
    np.minimum.at(first, (i[met], j[met]), z)
    np.maximum.at(last, (i[met], j[met]), z)
    return first, last


def _lines_of(
    x: Float[np.ndarray, "t 3"],
    y: Float[np.ndarray, "t 3"],
    u: Float[np.ndarray, " a"],
    v: Float[np.ndarray, " b"],
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return which lines (row, column) pass through the bounding box of which triangle."""
    i0, i1 = np.searchsorted(u, x.min(1) - 1e-9), np.searchsorted(u, x.max(1) + 1e-9)
    j0, j1 = np.searchsorted(v, y.min(1) - 1e-9), np.searchsorted(v, y.max(1) + 1e-9)
    width = j1 - j0
    count = (i1 - i0) * width
    which = np.repeat(np.arange(len(x)), count)
    step = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    return i0[which] + step // width[which], j0[which] + step % width[which], which


def _turn(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def double_areas(triangles: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, " t"]:
    """Return twice the areas of triangles [m^2]."""
    a, b, c = triangles.transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


def split_at(
    triangles: Float[np.ndarray, "t 3 3"], height: Float[np.ndarray, "t 3"]
) -> tuple[Float[np.ndarray, "a 3 3"], Float[np.ndarray, "b 3 3"]]:
    """Cut triangles at height zero; return those below and those above."""
    above = height >= 0
    count = above.sum(1)
    crossing = (count == 1) | (count == 2)
    lone = (count == 1)[crossing]
    # The corner that is alone on its side comes first.
    first = np.where(lone, above[crossing].argmax(1), (~above[crossing]).argmax(1))
    turn = (first[:, None] + np.arange(3)) % 3
    corner = np.take_along_axis(triangles[crossing], turn[..., None], 1)
    h = np.take_along_axis(height[crossing], turn, 1)
    p, q, r = corner.transpose(1, 0, 2)
    pq = p + (h[:, 0] / (h[:, 0] - h[:, 1]))[:, None] * (q - p)
    pr = p + (h[:, 0] / (h[:, 0] - h[:, 2]))[:, None] * (r - p)
    tip = np.stack([p, pq, pr], 1)
    base = np.concatenate([np.stack([pq, q, r], 1), np.stack([pq, r, pr], 1)])
    both = np.tile(lone, 2)
    below = np.concatenate([triangles[count == 0], tip[~lone], base[both]])
    over = np.concatenate([triangles[count == 3], tip[lone], base[~both]])
    return below[double_areas(below) > _SLIVER], over[double_areas(over) > _SLIVER]


def close_rims(triangles: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, "u 3 3"]:
    """Close the rims of a surface by fans, so that bars without ends and fronts become solid.

    Duplicate triangles, usually one for each side, count once.
    """
    corners, corner = _welded(triangles)
    faces = np.unique(np.sort(corner, axis=1), axis=0)
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges = edges[edges[:, 0] != edges[:, 1]]
    edges, count = np.unique(edges, axis=0, return_counts=True)
    rim = edges[count == 1]
    if not len(rim):
        return triangles
    group = _linked(rim, len(corners))[rim[:, 0]]
    number = np.unique(group, return_inverse=True)[1]
    ends = corners[rim]
    middle = np.stack([np.bincount(number, ends[..., k].sum(1)) for k in range(3)], -1)
    middle = middle / (2.0 * np.bincount(number)[:, None])
    fans = np.concatenate([ends, middle[number][:, None]], axis=1)
    return np.concatenate([triangles, fans])


def _welded(
    triangles: Float[np.ndarray, "t 3 3"],
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "t 3"]]:
    """Return the distinct corners, and the triangles as indices into them."""
    points = triangles.reshape(-1, 3)
    rounded = np.round(points / _WELD).astype(np.int64)
    _, first, number = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    return points[first], number.reshape(-1, 3)


def _linked(edges: Int[np.ndarray, "e 2"], size: int) -> Int[np.ndarray, " n"]:
    """Return the connected component of each node of a graph."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(edges)), edges.T), shape=(size, size))
    return np.asarray(connected_components(graph, directed=False)[1])


def connected_parts(triangles: Float[np.ndarray, "t 3 3"]) -> list[Float[np.ndarray, "k 3 3"]]:
    """Divide a surface into parts connected by shared corners or touching bounding boxes."""
    from scipy.sparse.csgraph import connected_components

    if not len(triangles):
        return []
    corners, corner = _welded(triangles)
    group = _linked(np.concatenate([corner[:, :2], corner[:, 1:]]), len(corners))[corner[:, 0]]
    group = np.unique(group, return_inverse=True)[1]
    fewer, number = -1, int(group.max()) + 1
    while fewer != number:
        number = int(group.max()) + 1
        low, high = np.full((number, 3), np.inf), np.full((number, 3), -np.inf)
        np.minimum.at(low, group, triangles.min(1))
        np.maximum.at(high, group, triangles.max(1))
        near = ((low[:, None] <= high + TOUCH) & (low <= high[:, None] + TOUCH)).all(2)
        fewer, joined = connected_components(near, directed=False)
        group = joined[group]
    return [triangles[group == k] for k in range(number)]
