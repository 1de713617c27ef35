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

from momapos.geometry.transforms import apply
from momapos.kinematics.hulls import Hull, fit_box, hull_around
from momapos.kinematics.meshes import mesh_triangles
from momapos.kinematics.urdf import Geometry

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

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
_WELD = 1e-5
"""Corners that are nearer to each other are one [m]."""
_TOUCH = 5e-4
"""Surfaces whose upright boxes come this near hang together [m]."""
_SLIVER = 1e-13
"""A triangle of half this area is none [m^2]."""


@dataclass(frozen=True)
class _Room:
    """Cells around a mesh that lines along the axes reach from outside."""

    center: Float[np.ndarray, "n 3"]
    volume: Float[np.ndarray, " n"]

    def inside(self, hull: _Hull, depth: float) -> _Room:
        """The cells whose middle lies inside a hull, by a depth at least [m]."""
        near = ((self.center > hull.low) & (self.center < hull.high)).all(1)
        away = (self.center[near] @ hull.planes[:, :3].T + hull.planes[:, 3]).max(1)
        near[near] = away < -depth
        return _Room(self.center[near], self.volume[near])


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
    triangles = mesh_triangles(geometry.mesh) * np.array(geometry.size)
    pieces = convex_pieces(apply(geometry.T_link_geometry, triangles))
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
    surface = _closed(triangles) @ rotation
    queue, done = [_piece(surface, _room_in(surface, surface))], []
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
        below, rest = _split(rest, rest[..., axis] - edge)
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
    for triangles_of_one in _connected(triangles):
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
    return bool((gap <= _TOUCH).all())


def _flat_levels(triangles: Float[np.ndarray, "t 3 3"], axis: int) -> list[float]:
    """Where the largest flat faces across an axis are, but those at its ends."""
    z = triangles[..., axis]
    low, high = float(z.min()), float(z.max())
    flat = np.ptp(z, axis=1) < BESIDE
    level, number = np.unique(np.round(z[flat].mean(1) / BESIDE), return_inverse=True)
    level, area = level * BESIDE, np.bincount(number, _areas(triangles[flat]))
    inside = (level > low + LEAST_SLAB) & (level < high - LEAST_SLAB)
    kept: list[float] = []
    for x in level[inside][np.argsort(-area[inside])]:
        if all(abs(x - y) > LEAST_SLAB for y in kept):
            kept.append(float(x))
    return kept[:FLATS]


def _even_levels(low: float, high: float, flats: list[float]) -> list[float]:
    """Ends of slabs of the same thickness, but those beside flat faces."""
    count = min(SLABS, int((high - low) / LEAST_EVEN))
    levels = np.linspace(low, high, count + 1)[1:-1] if count > 1 else []
    return [float(x) for x in levels if all(abs(x - y) > LEAST_SLAB for y in flats)]


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
        first, last = _hits(surface, axis, middle[u], middle[v])
        z = middle[axis]
        seen = (z < first[..., None]) | (z > last[..., None])
        free |= np.moveaxis(seen, -1, axis)
    cells = np.stack(np.meshgrid(*middle, indexing="ij"), -1)
    size = np.prod(np.stack(np.meshgrid(*map(np.diff, edges), indexing="ij"), -1), axis=-1)
    return _Room(cells[free], size[free])


def _hits(
    triangles: Float[np.ndarray, "t 3 3"],
    axis: int,
    u: Float[np.ndarray, " a"],
    v: Float[np.ndarray, " b"],
) -> tuple[Float[np.ndarray, "a b"], Float[np.ndarray, "a b"]]:
    """Where lines along an axis first and last meet the surface; inf and -inf where they do not."""
    first, last = np.full((len(u), len(v)), np.inf), np.full((len(u), len(v)), -np.inf)
    x, y = [triangles[..., k] for k in range(3) if k != axis]
    i, j, which = _lines_of(x, y, u, v)
    a, b, c = (np.stack([x[which, k], y[which, k]], -1) for k in range(3))
    point = np.stack([u[i], v[j]], -1)
    area = _turn(b - a, c - a)
    weight = np.stack([_turn(b - point, c - point), _turn(c - point, a - point)], -1)
    upright = np.abs(area) < _SLIVER  # seen on edge: lines pass beside it
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
    """Lines that pass through the boxes of triangles: their rows, their columns, the triangle."""
    i0, i1 = np.searchsorted(u, x.min(1) - 1e-9), np.searchsorted(u, x.max(1) + 1e-9)
    j0, j1 = np.searchsorted(v, y.min(1) - 1e-9), np.searchsorted(v, y.max(1) + 1e-9)
    width = j1 - j0
    count = (i1 - i0) * width
    which = np.repeat(np.arange(len(x)), count)
    step = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    return i0[which] + step // width[which], j0[which] + step % width[which], which


def _turn(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _areas(triangles: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, " t"]:
    """Twice the areas of triangles [m^2]."""
    a, b, c = triangles.transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _split(
    triangles: Float[np.ndarray, "t 3 3"], height: Float[np.ndarray, "t 3"]
) -> tuple[Float[np.ndarray, "a 3 3"], Float[np.ndarray, "b 3 3"]]:
    """Cut triangles at height zero: what is below, what is above."""
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
    return below[_areas(below) > _SLIVER], over[_areas(over) > _SLIVER]


def _closed(triangles: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, "u 3 3"]:
    """A surface with its rims closed by fans: bars without ends and fronts without backs are solid.

    Triangles that are there twice, mostly once for each side, count once.
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
    middle /= 2 * np.bincount(number)[:, None]
    fans = np.concatenate([ends, middle[number][:, None]], axis=1)
    return np.concatenate([triangles, fans])


def _welded(
    triangles: Float[np.ndarray, "t 3 3"],
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "t 3"]]:
    """Corners, each once, and their numbers in the triangles."""
    points = triangles.reshape(-1, 3)
    rounded = np.round(points / _WELD).astype(np.int64)
    _, first, number = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    return points[first], number.reshape(-1, 3)


def _linked(edges: Int[np.ndarray, "e 2"], size: int) -> Int[np.ndarray, " n"]:
    """Of each of some things, the number of the group that edges link it to."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(edges)), edges.T), shape=(size, size))
    return np.asarray(connected_components(graph, directed=False)[1])


def _connected(triangles: Float[np.ndarray, "t 3 3"]) -> list[Float[np.ndarray, "k 3 3"]]:
    """What hangs together: shares corners, or has upright boxes that touch."""
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
        near = ((low[:, None] <= high + _TOUCH) & (low <= high[:, None] + _TOUCH)).all(2)
        fewer, joined = connected_components(near, directed=False)
        group = joined[group]
    return [triangles[group == k] for k in range(number)]
