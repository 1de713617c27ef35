"""A mesh that is not convex as convex pieces, none of which leaves any of its surface out.

A handle and its panel are often one mesh, and its hull fills the room behind the handle. What lines
along the axes of a box around the mesh reach from outside, before they meet its surface, is room.
The mesh is cut into slabs across one axis, what hangs together in a slab is a piece, and neighbors
whose common hull holds no more room are joined again. Pieces whose hull holds room are cut across
another axis. Nothing is asked of the mesh: it may be open, doubled, or turned inside out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply

from .hulls import Hull, fit_box, hull_around
from .meshes import mesh_triangles
from .reader import Geometry
from .triangles import TOUCH, closed_up, connected_parts, double_areas, hits_along, split_at

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

HOLLOW = 3e-6
"""A hull that holds more room than this is cut: a fingertip takes as much [m^3]."""
DEEP = 0.005
"""Room counts where its middle is so deep in the hull [m]."""
MAX_TRIANGLES = 20_000
"""Meshes with more stay one hull: cutting them would take seconds [-]."""
MAX_PIECES = 24
"""No mesh becomes more pieces [-]."""
SLABS = 10
"""Slabs of the same thickness that an axis is cut into, beside those that flat faces end [-]."""
FLATS = 8
"""Flat faces that end slabs, the largest ones [-]."""
BESIDE = 2e-4
"""A cut is this far beside a flat face, on both sides of it [m]."""
LEAST_SLAB = 0.003
"""Flat faces that are nearer to each other end one slab [m]."""
LEAST_EVEN = 0.012
"""No slab of those of the same thickness is thinner [m]."""
GAIN = 0.98
"""A cut is worth it where at most this share of the room, or of the volume that holds any, is left
[-]."""
NEAR = 8
"""Pieces of one slab that another is compared with [-]."""


@dataclass(frozen=True)
class _Room:
    """Cells around a mesh that lines along the axes reach from outside."""

    center: Float[np.ndarray, "n 3"]
    volume: Float[np.ndarray, " n"]

    def inside(self, hull: _Hull, depth: float) -> _Room:
        """The cells whose middle lies inside a hull, by a depth at least [m]."""
        near = ((self.center > hull.low) & (self.center < hull.high)).all(1)
        away = (self.center[near] @ hull.planes[:, :3].T + hull.planes[:, 3]).max(1)
        rows = np.flatnonzero(near)[away < -depth]
        return _Room(self.center[rows], self.volume[rows])


@dataclass(frozen=True)
class _Hull:
    """Of some of the surface."""

    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]
    planes: Float[np.ndarray, "k 4"]
    """Outward unit normals, and offsets that are negative inside."""
    volume: float


@dataclass(frozen=True)
class _Piece:
    """Some of the surface."""

    triangles: Float[np.ndarray, "t 3 3"]
    hull: _Hull
    room: float
    """That its hull holds [m^3]."""

    @property
    def hollow(self) -> bool:
        return self.room > HOLLOW


def pieces_of(geometry: Geometry, hull: Hull) -> tuple[Hull, ...]:
    """The convex pieces of a shape, in the link frame: its hull, or those of a hollow mesh.

    Raises:
        UrdfError: As for `mesh_triangles`.
    """
    if geometry.kind != "mesh":
        return (hull,)
    assert geometry.mesh is not None
    corners = (mesh_triangles(geometry.mesh) * np.array(geometry.size)).reshape(-1, 3)
    pieces = convex_pieces(apply(geometry.T_link_geometry, corners).reshape(-1, 3, 3))
    if len(pieces) == 1:
        return (hull,)
    return tuple(hull_around(points, hull.name) for points in pieces)


def convex_pieces(triangles: Float[np.ndarray, "t 3 3"]) -> list[Float[np.ndarray, "n 3"]]:
    """Corners of pieces whose hulls hold all of a surface, and little of the room around it.

    Args:
        triangles: The surface, in any order and direction [m].

    Returns:
        Points of each piece; of a surface that is nearly convex, or of too many triangles, all.
    """
    points = triangles.reshape(-1, 3)
    if not 0 < len(triangles) <= MAX_TRIANGLES or not _folds_in(triangles):
        return [points]
    rotation = fit_box(points)[1]
    surface = closed_up(triangles) @ rotation
    queue = [_piece(surface, _room_in(surface, surface))]
    done: list[_Piece] = []
    while queue:
        piece = queue.pop()
        room = _room_in(piece.triangles, surface).inside(piece.hull, DEEP)
        parts = _cut(_piece(piece.triangles, room), room)
        if not parts or len(queue) + len(done) + len(parts) > MAX_PIECES:
            done.append(piece)
        else:
            queue = sorted([*queue, *parts], key=lambda p: p.room)
    if len(done) == 1:
        return [points]
    return [piece.triangles.reshape(-1, 3) @ rotation.T for piece in done]


def _hull(triangles: Float[np.ndarray, "t 3 3"]) -> _Hull:
    from scipy.spatial import ConvexHull, QhullError

    corners = triangles.reshape(-1, 3)
    low, high = corners.min(0), corners.max(0)
    try:
        hull = ConvexHull(corners)
    except QhullError:  # flat: nothing lies inside
        return _Hull(low, high, np.array([[0.0, 0.0, 0.0, 1.0]]), 0.0)
    return _Hull(low, high, np.unique(np.round(hull.equations, 5), axis=0), float(hull.volume))


def _folds_in(triangles: Float[np.ndarray, "t 3 3"]) -> bool:
    """Whether corners and middles of a surface lie deep in its hull, and not on it alone."""
    middles = (triangles + triangles[:, [1, 2, 0]]).reshape(-1, 3) / 2
    points = np.concatenate([triangles.reshape(-1, 3), middles, triangles.mean(1)])
    planes = _hull(triangles).planes
    return bool((points @ planes[:, :3].T + planes[:, 3]).max(1).min() < -DEEP)


def _piece(triangles: Float[np.ndarray, "t 3 3"], room: _Room) -> _Piece:
    hull = _hull(triangles)
    return _Piece(triangles, hull, float(room.inside(hull, BESIDE).volume.sum()))


def _both(a: _Piece, b: _Piece, room: _Room) -> _Piece:
    return _piece(np.concatenate([a.triangles, b.triangles]), room)


def _cut(piece: _Piece, room: _Room) -> list[_Piece]:
    """The pieces across the axis that leaves the least room in them; none where it is no use."""
    if not piece.hollow:
        return []

    def left(parts: list[_Piece]) -> tuple[float, float, float]:
        hollow = sum(p.hull.volume for p in parts if p.hollow)
        # Of cuts as good as each other the one that leaves the body whole, and its handle apart.
        body = max(p.hull.volume for p in parts)
        shares = round(hollow / piece.hull.volume, 2), -body / piece.hull.volume
        return round(sum(p.room for p in parts) / piece.room, 1), *shares

    best = min((_across(piece, axis, room) for axis in range(3)), key=left)
    return best if len(best) > 1 and min(left(best)[:2]) <= GAIN else []


def _across(piece: _Piece, axis: int, room: _Room) -> list[_Piece]:
    """The pieces of slabs across an axis, joined where their common hull holds no more room."""
    edges, thin = _slab_edges(piece, axis)
    slabs, rest = [], piece.triangles
    for edge in edges:
        below, rest = split_at(rest, rest[..., axis] - edge)
        slabs.append(_bodies(below, room))
    slabs.append(_bodies(rest, room))
    # What lies in the plane of a flat face belongs to the side on which it closes a body.
    for k in np.flatnonzero(thin):
        for face in slabs[k]:
            _give_away(face, [slabs[k - 1], slabs[k + 1]], axis, room)
        slabs[k] = []
    return _joined([slab for slab in slabs if slab], axis, room)


def _bodies(triangles: Float[np.ndarray, "t 3 3"], room: _Room) -> list[_Piece]:
    """The pieces of a slab: what hangs together, and both sides of what has no room between."""
    kept: list[_Piece] = []
    for triangles_of_one in connected_parts(triangles):
        piece = _piece(triangles_of_one, room)
        for k, other in enumerate(kept[-NEAR:]):
            both = _both(other, piece, room)
            if both.room <= piece.room + other.room:
                piece = both
                del kept[len(kept) - len(kept[-NEAR:]) + k]
                break
        kept.append(piece)
    return kept


def _give_away(face: _Piece, sides: list[list[_Piece]], axis: int, room: _Room) -> None:
    """Join what is thin to the neighbor that takes in the least room by it, a solid one rather."""
    found: list[tuple[float, float, list[_Piece], int, _Piece]] = []
    for side in sides:
        for k, other in enumerate(side):
            if _touch(face, other, axis):
                both = _both(other, face, room)
                more = round((both.room - other.room) / (0.1 * HOLLOW))
                found.append((more, other.room, side, k, both))
    if found:
        _, _, side, k, both = min(found, key=lambda way: way[:2])
        side[k] = both
    else:
        sides[0].append(face)


def _joined(slabs: list[list[_Piece]], axis: int, room: _Room) -> list[_Piece]:
    """Join pieces of neighboring slabs, solid ones and hollow ones, while that adds no room."""
    done: list[_Piece] = []
    last: list[_Piece] = []
    for slab in slabs:
        now: list[_Piece] = []
        for piece in slab:
            for k, other in enumerate(last):
                if piece.hollow != other.hollow or not _touch(piece, other, axis):
                    continue
                both = _both(other, piece, room)
                limit = 1.02 * (piece.room + other.room) if piece.hollow else HOLLOW / 4
                if both.room <= limit:
                    piece = both
                    del last[k]
                    break
            now.append(piece)
        done += last
        last = now
    return done + last


def _touch(a: _Piece, b: _Piece, axis: int) -> bool:
    """Whether pieces of neighboring slabs lie on each other."""
    gap = np.maximum(a.hull.low - b.hull.high, b.hull.low - a.hull.high)
    gap[axis] = 0.0
    return bool((gap <= TOUCH).all())


def _flat_levels(triangles: Float[np.ndarray, "t 3 3"], axis: int) -> list[float]:
    """Where the largest flat faces across an axis are, but those at its ends."""
    z = triangles[..., axis]
    low, high = float(z.min()), float(z.max())
    flat = np.ptp(z, axis=1) < BESIDE
    level, number = np.unique(np.round(z[flat].mean(1) / BESIDE), return_inverse=True)
    level, area = level * BESIDE, np.bincount(number, double_areas(triangles[flat]))
    inside = (level > low + LEAST_SLAB) & (level < high - LEAST_SLAB)
    kept: list[float] = []
    for x in level[inside][np.argsort(-area[inside])]:
        if len(kept) < FLATS and all(abs(x - y) > LEAST_SLAB for y in kept):
            kept.append(float(x))
    return kept


def _even_levels(low: float, high: float, flats: list[float]) -> list[float]:
    """Ends of slabs of the same thickness, but those beside flat faces."""
    count = min(SLABS, int((high - low) / LEAST_EVEN))
    levels = np.linspace(low, high, max(count, 1) + 1)[1:-1]
    return [float(x) for x in levels.tolist() if all(abs(x - y) > LEAST_SLAB for y in flats)]


def _slab_edges(
    piece: _Piece, axis: int
) -> tuple[Float[np.ndarray, " e"], Bool[np.ndarray, " e_1"]]:
    """Where slabs end, and which of the slabs hold nothing but a flat face."""
    flats = _flat_levels(piece.triangles, axis)
    even = _even_levels(float(piece.hull.low[axis]), float(piece.hull.high[axis]), flats)
    ends = np.array([*even, *(x - BESIDE for x in flats), *(x + BESIDE for x in flats)])
    closes_flat = np.repeat([False, True], [len(even) + len(flats), len(flats)])
    order = np.argsort(ends)
    return ends[order], np.append(closes_flat[order], False)


def _room_in(piece: Float[np.ndarray, "k 3 3"], surface: Float[np.ndarray, "t 3 3"]) -> _Room:
    """Cells between flat faces and even steps of a piece that the surface does not hide."""
    low, high = piece.min((0, 1)), piece.max((0, 1))
    edges = []
    for axis in range(3):
        flats = _flat_levels(piece, axis)
        even = _even_levels(float(low[axis]), float(high[axis]), flats)
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
    return _Room(cells[free], size[free])
