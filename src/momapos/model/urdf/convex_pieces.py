"""Divide a nonconvex mesh into convex pieces that cover its whole surface.

A handle and its panel are often one mesh, whose hull fills the space behind the handle. Free space
is what lines along the axes of the mesh's box reach from outside before they meet the surface. The
mesh is cut into slabs across one axis, and the connected parts of a slab are pieces. Neighbors are
merged again if their common hull contains no more free space. Pieces whose hull contains free space
are cut across another axis. The mesh may be open, duplicated, or inside out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import look
from momapos.core.geometry import apply

from .hulls import Hull, fit_box, hull_around, unique_rows
from .meshes import mesh_triangles
from .reader import Geometry

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


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


MIN_DEPTH = 0.005
"""A free cell counts if its center is at least this deep in the hull [m]."""
MAX_TRIANGLES = 20_000
"""Larger meshes stay one hull, since cutting them takes seconds [-]."""
MAX_DISTANCES = 4_000_000
"""Largest number of distances of points to planes in memory at once [-]."""
MAX_FLAT_FACES = 8
"""Number of flat faces that bound slabs, largest first [-]."""
CUT_OFFSET = 2e-4
"""Distance of the two cuts on both sides of a flat face [m]."""
MAX_REMAINING = 0.98
"""A cut is kept if at most this share of the free space, or of the hollow volume, remains [-]."""
MAX_EDGE = 0.02
"""Longest edge of a surface that pieces of a coarser one are made to contain, as a share of its
size [-]."""
MAX_COMPARED = 8
"""Number of pieces of a slab that a new piece is compared with [-]."""


@dataclass(frozen=True)
class CutConfig:
    """How finely a mesh is cut; the defaults leave space for fingers behind a handle."""

    max_void: float = 3e-6
    """A hull that contains more free space is cut; about the volume of a fingertip [m^3]."""
    max_pieces: int = 24
    """Largest number of pieces of a mesh [-]."""
    max_triangles: int = MAX_TRIANGLES
    """Larger meshes stay one hull [-]."""
    max_slabs: int = 10
    """Largest number of slabs of equal thickness per axis, in addition to those at flat faces."""
    min_slab: float = 0.003
    """Smallest distance of flat faces that bound different slabs [m]."""
    min_even_slab: float = 0.012
    """Smallest thickness of slabs of equal thickness [m]."""
    min_free_share: float = 0.0
    """A mesh is hollow if at least this share of its hull is free [-]."""
    min_free_volume: float = 0.0
    """A mesh is hollow if its hull has at least this free volume [m^3]."""
    max_remaining: float = 1.0
    """The pieces of a hollow mesh are used if they have at most this share of the hull's volume
    [-]."""
    max_added: float = 0.0
    """Two of these pieces are merged if that adds at most this share of the hull's volume [-]."""
    max_detail: int = 0
    """A mesh with more triangles is cut as a coarser one with this many; 0: as it is [-]."""


FINE = CutConfig()


@dataclass(frozen=True, eq=False)
class _FreeCells:
    """Cells around a mesh that lines along the axes reach from outside."""

    center: Float[np.ndarray, "n 3"]
    volume: Float[np.ndarray, " n"]

    def inside(self, hull: _HullPlanes, depth: float) -> _FreeCells:
        """Return the cells whose center is inside a hull by at least a depth [m]."""
        near = ((self.center > hull.low) & (self.center < hull.high)).all(1)
        away = (self.center[near] @ hull.planes[:, :3].T + hull.planes[:, 3]).max(1)
        rows = np.flatnonzero(near)[away < -depth]
        return _FreeCells(self.center[rows], self.volume[rows])


@dataclass(frozen=True, eq=False)
class _HullPlanes:
    """The convex hull of a part of the surface."""

    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]
    planes: Float[np.ndarray, "k 4"]
    """Outward unit normals, and offsets that are negative inside."""
    volume: float


@dataclass(frozen=True, eq=False)
class _Piece:
    """A part of the surface."""

    triangles: Float[np.ndarray, "t 3 3"]
    hull: _HullPlanes
    void: float
    """Free space in its hull [m^3]."""

    def is_hollow(self, config: CutConfig) -> bool:
        return self.void > config.max_void


def pieces_of(geometry: Geometry, hull: Hull, config: CutConfig = FINE) -> tuple[Hull, ...]:
    """Return the convex pieces of a shape in the link frame; one hull if it is nearly convex.

    Raises:
        UrdfError: As for `mesh_triangles`.
    """
    if geometry.kind != "mesh":
        return (hull,)
    pieces = convex_pieces(triangles_of(geometry), config)
    if len(pieces) == 1:
        return (hull,)
    return tuple(hull_around(points, hull.name) for points in pieces)


def triangles_of(geometry: Geometry) -> Float[np.ndarray, "t 3 3"]:
    """Return the triangles of a mesh in the link frame [m].

    Raises:
        UrdfError: As for `mesh_triangles`.
    """
    assert geometry.mesh is not None
    corners = (mesh_triangles(geometry.mesh) * np.array(geometry.size)).reshape(-1, 3)
    return apply(geometry.T_link_geometry, corners).reshape(-1, 3, 3)


def free_volume(triangles: Float[np.ndarray, "t 3 3"]) -> float:
    """Return the free space in the hull of a surface [m^3]; 0 if it is nearly convex."""
    if not len(triangles) or not is_concave(triangles):
        return 0.0
    surface = close_rims(triangles) @ fit_box(triangles.reshape(-1, 3))[1]
    free = _free_cells(surface, surface, FINE).inside(_hull_planes(surface), MIN_DEPTH)
    return float(free.volume.sum())


def decimated(triangles: Float[np.ndarray, "t 3 3"], most: int) -> Float[np.ndarray, "u 3 3"]:
    """Return a coarser surface: the vertices in a cell of a grid become one, at their mean.

    Args:
        triangles: The surface [m].
        most: Number of triangles of the result [-].
    """
    points = triangles.reshape(-1, 3)
    low = points.min(0)
    # Each square of a grid on the surface is two triangles.
    cell = float(np.sqrt(double_areas(triangles).sum() / most))
    while True:
        index = np.floor((points - low) / cell).astype(np.int64)
        _, group = np.unique(index, axis=0, return_inverse=True)
        group = group.reshape(-1)
        count = np.bincount(group)
        middle = np.stack([np.bincount(group, points[:, k]) / count for k in range(3)], -1)
        corners = group.reshape(-1, 3)
        whole = (corners != np.roll(corners, 1, axis=1)).all(1)
        _, first = np.unique(np.sort(corners[whole], axis=1), axis=0, return_index=True)
        if len(first) <= most:
            return np.asarray(middle[corners[whole][first]])
        cell *= 1.2


def containing(pieces: Sequence[Hull], triangles: Float[np.ndarray, "t 3 3"]) -> tuple[Hull, ...]:
    """Return convex pieces that contain a surface: each grows by the triangles nearest to it.

    Triangles with edges longer than `MAX_EDGE` are divided, so that pieces grow by little.
    """
    most = MAX_EDGE * float(np.linalg.norm(np.ptp(triangles, axis=(0, 1))))
    while len(rows := np.flatnonzero(_longest(triangles)[1] > most)):
        turn = (_longest(triangles[rows])[0][:, None] + np.arange(3)) % 3
        p, q, r = np.take_along_axis(triangles[rows], turn[..., None], 1).transpose(1, 0, 2)
        middle = (p + q) / 2
        halves = np.stack([p, middle, r], 1), np.stack([middle, q, r], 1)
        triangles = np.concatenate([np.delete(triangles, rows, 0), *halves])
    points, corners = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    corners = corners.reshape(-1, 3)
    nearest, least = np.zeros(len(corners), np.int64), np.full(len(corners), np.inf)
    for k, piece in enumerate(pieces):
        planes = _hull_planes(piece.vertices[piece.faces]).planes
        blocks = np.array_split(points, 1 + len(points) * len(planes) // MAX_DISTANCES)
        beyond = np.concatenate([(b @ planes[:, :3].T + planes[:, 3]).max(1) for b in blocks])
        worst = beyond[corners].max(1)
        nearest, least = np.where(worst < least, k, nearest), np.minimum(worst, least)
    grown = []
    for k, piece in enumerate(pieces):
        own = triangles[(nearest == k) & (least > _WELD)].reshape(-1, 3)
        around = np.concatenate([piece.vertices, own])
        grown.append(hull_around(around, piece.name) if len(own) else piece)
    return tuple(grown)


def _longest(
    triangles: Float[np.ndarray, "t 3 3"],
) -> tuple[Int[np.ndarray, " t"], Float[np.ndarray, " t"]]:
    """Return the first corner of each triangle's longest edge, and its length [m]."""
    length = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
    return length.argmax(1), length.max(1)


def convex_pieces(
    triangles: Float[np.ndarray, "t 3 3"], config: CutConfig = FINE
) -> list[Float[np.ndarray, "n 3"]]:
    """Divide a surface into pieces whose hulls contain little free space.

    Args:
        triangles: The surface, in any order and orientation [m].
        config: How finely.

    Returns:
        Points of each piece; one piece if the surface is nearly convex or has too many triangles.
    """
    points = triangles.reshape(-1, 3)
    if not 0 < len(triangles) <= config.max_triangles or not is_concave(triangles):
        return [points]
    rotation = fit_box(points)[1]
    surface = close_rims(triangles) @ rotation
    queue = [_piece(surface, _free_cells(surface, surface, config))]
    done: list[_Piece] = []
    while queue:
        piece = queue.pop()
        free = _free_cells(piece.triangles, surface, config).inside(piece.hull, MIN_DEPTH)
        parts = _cut(_piece(piece.triangles, free), free, config)
        if not parts or len(queue) + len(done) + len(parts) > config.max_pieces:
            done.append(piece)
        else:
            queue = sorted([*queue, *parts], key=lambda p: p.void)
    if len(done) == 1:
        return [points]
    return [piece.triangles.reshape(-1, 3) @ rotation.T for piece in done]


def _hull_planes(triangles: Float[np.ndarray, "t 3 3"]) -> _HullPlanes:
    from scipy.spatial import ConvexHull, QhullError

    look()
    corners = triangles.reshape(-1, 3)
    low, high = corners.min(0), corners.max(0)
    try:
        hull = ConvexHull(corners)
    except QhullError:  # flat: no point is inside
        return _HullPlanes(low, high, np.array([[0.0, 0.0, 0.0, 1.0]]), 0.0)
    return _HullPlanes(low, high, unique_rows(np.round(hull.equations, 5)), float(hull.volume))


def is_concave(triangles: Float[np.ndarray, "t 3 3"]) -> bool:
    """Return whether corners or midpoints of a surface are deep inside its hull."""
    middles = (triangles + triangles[:, [1, 2, 0]]).reshape(-1, 3) / 2
    points = np.concatenate([triangles.reshape(-1, 3), middles, triangles.mean(1)])
    planes = _hull_planes(triangles).planes
    size = max(1, MAX_DISTANCES // len(planes))
    blocks = (points[first : first + size] for first in range(0, len(points), size))
    return any(
        (block @ planes[:, :3].T + planes[:, 3]).max(1).min() < -MIN_DEPTH for block in blocks
    )


def _piece(triangles: Float[np.ndarray, "t 3 3"], free: _FreeCells) -> _Piece:
    hull = _hull_planes(triangles)
    return _Piece(triangles, hull, float(free.inside(hull, CUT_OFFSET).volume.sum()))


def _merge(a: _Piece, b: _Piece, free: _FreeCells) -> _Piece:
    return _piece(np.concatenate([a.triangles, b.triangles]), free)


def _cut(piece: _Piece, free: _FreeCells, config: CutConfig) -> list[_Piece]:
    """Cut a piece across the axis that leaves the least free space; [] if no cut helps."""
    if not piece.is_hollow(config):
        return []

    def left(parts: list[_Piece]) -> tuple[float, float, float]:
        hollow = sum(p.hull.volume for p in parts if p.is_hollow(config))
        # Among equally good cuts, prefer the one that keeps the body whole and its handle apart.
        body = max(p.hull.volume for p in parts)
        shares = round(hollow / piece.hull.volume, 2), -body / piece.hull.volume
        return round(sum(p.void for p in parts) / piece.void, 1), *shares

    best = min((_cut_across(piece, axis, free, config) for axis in range(3)), key=left)
    return best if len(best) > 1 and min(left(best)[:2]) <= MAX_REMAINING else []


def _cut_across(piece: _Piece, axis: int, free: _FreeCells, config: CutConfig) -> list[_Piece]:
    """Cut a piece into slabs across an axis, and merge pieces where that adds no free space."""
    edges, thin = _slab_edges(piece, axis, config)
    slabs, rest = [], piece.triangles
    for edge in edges:
        below, rest = split_at(rest, rest[..., axis] - edge)
        slabs.append(_slab_pieces(below, free))
    slabs.append(_slab_pieces(rest, free))
    # A flat face belongs to the side on which it closes a body.
    for k in np.flatnonzero(thin):
        for face in slabs[k]:
            _merge_thin(face, [slabs[k - 1], slabs[k + 1]], axis, free, config)
        slabs[k] = []
    return _merge_slabs([slab for slab in slabs if slab], axis, free, config)


def _slab_pieces(triangles: Float[np.ndarray, "t 3 3"], free: _FreeCells) -> list[_Piece]:
    """Return the connected parts of a slab, merged where there is no free space in between."""
    pieces: list[_Piece] = []
    for part in connected_parts(triangles):
        piece = _piece(part, free)
        for k, other in enumerate(pieces[-MAX_COMPARED:]):
            both = _merge(other, piece, free)
            if both.void <= piece.void + other.void:
                piece = both
                del pieces[len(pieces) - len(pieces[-MAX_COMPARED:]) + k]
                break
        pieces.append(piece)
    return pieces


def _merge_thin(
    face: _Piece, sides: list[list[_Piece]], axis: int, free: _FreeCells, config: CutConfig
) -> None:
    """Merge a flat face with the neighbor that gains the least free space, preferably solid."""
    found: list[tuple[float, float, list[_Piece], int, _Piece]] = []
    for side in sides:
        for k, other in enumerate(side):
            if _are_adjacent(face, other, axis):
                both = _merge(other, face, free)
                more = round((both.void - other.void) / (0.1 * config.max_void))
                found.append((more, other.void, side, k, both))
    if found:
        _, _, side, k, both = min(found, key=lambda way: way[:2])
        side[k] = both
    else:
        sides[0].append(face)


def _merge_slabs(
    slabs: list[list[_Piece]], axis: int, free: _FreeCells, config: CutConfig
) -> list[_Piece]:
    """Merge solid pieces of neighboring slabs, and hollow ones, if that adds no free space."""
    done: list[_Piece] = []
    last: list[_Piece] = []
    for slab in slabs:
        now: list[_Piece] = []
        for piece in slab:
            for k, other in enumerate(last):
                hollow = piece.is_hollow(config)
                if hollow != other.is_hollow(config) or not _are_adjacent(piece, other, axis):
                    continue
                both = _merge(other, piece, free)
                limit = 1.02 * (piece.void + other.void) if hollow else config.max_void / 4
                if both.void <= limit:
                    piece = both
                    del last[k]
                    break
            now.append(piece)
        done += last
        last = now
    return done + last


def _are_adjacent(a: _Piece, b: _Piece, axis: int) -> bool:
    gap = np.maximum(a.hull.low - b.hull.high, b.hull.low - a.hull.high)
    gap[axis] = 0.0
    return bool((gap <= TOUCH).all())


def _flat_levels(
    triangles: Float[np.ndarray, "t 3 3"], axis: int, config: CutConfig
) -> list[float]:
    """Return the positions of the largest flat faces across an axis, except at the ends."""
    z = triangles[..., axis]
    low, high = float(z.min()), float(z.max())
    flat = np.ptp(z, axis=1) < CUT_OFFSET
    level, number = np.unique(np.round(z[flat].mean(1) / CUT_OFFSET), return_inverse=True)
    level, area = level * CUT_OFFSET, np.bincount(number, double_areas(triangles[flat]))
    inside = (level > low + config.min_slab) & (level < high - config.min_slab)
    kept: list[float] = []
    for x in level[inside][np.argsort(-area[inside])]:
        if len(kept) < MAX_FLAT_FACES and all(abs(x - y) > config.min_slab for y in kept):
            kept.append(float(x))
    return kept


def _even_levels(low: float, high: float, flats: list[float], config: CutConfig) -> list[float]:
    """Return the ends of slabs of equal thickness, except near flat faces."""
    count = min(config.max_slabs, int((high - low) / config.min_even_slab))
    levels = np.linspace(low, high, max(count, 1) + 1)[1:-1]
    return [float(x) for x in levels.tolist() if all(abs(x - y) > config.min_slab for y in flats)]


def _slab_edges(
    piece: _Piece, axis: int, config: CutConfig
) -> tuple[Float[np.ndarray, " e"], Bool[np.ndarray, " e_1"]]:
    """Return the ends of slabs, and which of the slabs contain only a flat face."""
    flats = _flat_levels(piece.triangles, axis, config)
    low, high = float(piece.hull.low[axis]), float(piece.hull.high[axis])
    even = _even_levels(low, high, flats, config)
    ends = np.array([*even, *(x - CUT_OFFSET for x in flats), *(x + CUT_OFFSET for x in flats)])
    closes_flat = np.repeat([False, True], [len(even) + len(flats), len(flats)])
    order = np.argsort(ends)
    return ends[order], np.append(closes_flat[order], False)


def _free_cells(
    piece: Float[np.ndarray, "k 3 3"], surface: Float[np.ndarray, "t 3 3"], config: CutConfig
) -> _FreeCells:
    """Return the cells of a piece that the surface does not hide.

    Flat faces and equal steps divide the piece's box into cells.
    """
    low, high = piece.min((0, 1)), piece.max((0, 1))
    edges = []
    for axis in range(3):
        flats = _flat_levels(piece, axis, config)
        even = _even_levels(float(low[axis]), float(high[axis]), flats, config)
        edges.append(np.array(sorted([low[axis], *flats, *even, high[axis]])))
    middle = [(e[1:] + e[:-1]) / 2 for e in edges]
    free = np.zeros([len(m) for m in middle], bool)
    for axis in range(3):
        u, v = [k for k in range(3) if k != axis]
        first, last = hits_along(surface, axis, middle[u], middle[v])
        z = middle[axis]
        seen = (z < first[..., None]) | (z > last[..., None])
        free |= np.moveaxis(seen, -1, axis)
    cells = np.stack(np.meshgrid(*middle, indexing="ij"), -1)
    size = np.prod(np.stack(np.meshgrid(*map(np.diff, edges), indexing="ij"), -1), axis=-1)
    return _FreeCells(cells[free], size[free])


def free_share(triangles: Float[np.ndarray, "t 3 3"]) -> tuple[float, float]:
    """Measure the free space in the hull of a surface.

    Returns:
        Volume of the hull, and of the space in it that the surface does not hide [m^3]; closed
        cavities are hidden.
    """
    if not is_concave(triangles):
        return _hull_planes(triangles).volume, 0.0
    surface = close_rims(triangles) @ fit_box(triangles.reshape(-1, 3))[1]
    piece = _piece(surface, _free_cells(surface, surface, FINE))
    return piece.hull.volume, min(piece.void, piece.hull.volume)
