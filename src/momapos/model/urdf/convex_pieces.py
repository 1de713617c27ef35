"""Divide a nonconvex mesh into convex pieces that cover its whole surface.

A handle and its panel are often one mesh, whose hull fills the space behind the handle. Free space
is what lines along the axes of the mesh's box reach from outside before they meet the surface. The
mesh is cut into slabs across one axis, and the connected parts of a slab are pieces. Neighbors are
merged again if their common hull contains no more free space. Pieces whose hull contains free space
are cut across another axis. The mesh may be open, duplicated, or inside out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import look
from momapos.core.geometry import apply

from .hulls import Hull, fit_box, hull_around, unique_rows
from .meshes import mesh_triangles
from .reader import Geometry
from .triangles import TOUCH, close_rims, connected_parts, double_areas, hits_along, split_at

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MIN_DEPTH = 0.005
"""A free cell counts if its center is at least this deep in the hull [m]."""
MAX_TRIANGLES = 20_000
"""Larger meshes stay one hull, since cutting them takes seconds [-]."""
MAX_FLAT_FACES = 8
"""Number of flat faces that bound slabs, largest first [-]."""
CUT_OFFSET = 2e-4
"""Distance of the two cuts on both sides of a flat face [m]."""
MAX_REMAINING = 0.98
"""A cut is kept if at most this share of the free space, or of the hollow volume, remains [-]."""
MAX_COMPARED = 8
"""Number of pieces of a slab that a new piece is compared with [-]."""


@dataclass(frozen=True)
class CutConfig:
    """How finely a mesh is cut; the defaults leave space for fingers behind a handle."""

    max_void: float = 3e-6
    """A hull that contains more free space is cut; about the volume of a fingertip [m^3]."""
    max_pieces: int = 24
    """Largest number of pieces of a mesh [-]."""
    max_slabs: int = 10
    """Largest number of slabs of equal thickness per axis, in addition to those at flat faces."""
    min_slab: float = 0.003
    """Smallest distance of flat faces that bound different slabs [m]."""
    min_even_slab: float = 0.012
    """Smallest thickness of slabs of equal thickness [m]."""


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
    if not 0 < len(triangles) <= MAX_TRIANGLES or not is_concave(triangles):
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
    return bool((points @ planes[:, :3].T + planes[:, 3]).max(1).min() < -MIN_DEPTH)


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
