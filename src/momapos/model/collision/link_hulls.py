"""The links of a robot as convex hulls, and whether two hulls overlap.

GJK: a simplex of points of the difference of two bodies moves toward the origin. It ends if a
direction separates the hulls, or if the simplex contains the origin. If rounding prevents that, the
hulls count as overlapping, which is the safe side.

Source: van den Bergen, Collision Detection in Interactive 3D Environments (2003), chapter 4.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import kernel
from momapos.core.geometry import apply
from momapos.model.kinematics import HullArrays, Segments, cross, dot, sub
from momapos.model.urdf import Articulated

if TYPE_CHECKING:
    from jaxtyping import Float, Int


MAX_DIRECTIONS = 40
"""Largest number of directions; usually 3 are enough [-]."""
MAX_SCANNED_VERTICES = 200
"""Hulls with more vertices (meshes may have thousands) are searched from neighbor to neighbor for
the vertex farthest along a direction [-]."""
DIRECTION_CELLS = 8
"""Cells along each edge of a cube, whose faces divide directions into bins [-]."""
DIRECTION_BINS = 6 * DIRECTION_CELLS * DIRECTION_CELLS
"""Number of bins of directions, each with its own start vertex [-]."""


@kernel
def hulls_overlap(R, p, hulls, i, first, last):
    """Return whether a hull of a link overlaps a hull of first:last, or is within the margin.

    Args:
        R, p: Segment poses (n + 1, 3, 3), (n + 1, 3).
        hulls: `HullArrays`.
        i: The link's group of spheres.
        first, last: Indices of hulls.
    """
    for a in range(hulls.of_group[i], hulls.of_group[i + 1]):
        for b in range(first, last):
            if _overlap(R, p, hulls, a, b):
                return True
    return False


@kernel
def surfaces_overlap(R, p, hulls, at, near):
    """Return whether hulls of group 0 overlap those after it, which are many small ones.

    Only those within the bounds of the others are compared.

    Args:
        R, p: Segment poses (n + 1, 3, 3), (n + 1, 3).
        hulls: `HullArrays`.
        at: Scratch memory for centers (hulls, 3).
        near: Scratch memory for indices (hulls,).
    """
    count, end = hulls.of_group[1], len(hulls.segment)
    for h in range(end):
        at[h, 0], at[h, 1], at[h, 2] = moved(R, p, hulls.segment[h], hulls.center[h])
    for h in range(end):
        near[h] = h
    low, high = _bounds_of(at, hulls.radius, near, count, end)
    first = _within(at, hulls.radius, near, 0, count, low, high)
    low, high = _bounds_of(at, hulls.radius, near, 0, first)
    last = _within(at, hulls.radius, near, count, end, low, high)
    for a in near[:first]:
        for b in near[count:last]:
            if _overlap(R, p, hulls, a, b):
                return True
    return False


@kernel
def _bounds_of(at, radius, near, begin, end):
    """Return the corners of the bounds of the balls around some hulls."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for h in near[begin:end]:
        for k in range(3):
            low[k] = min(low[k], at[h, k] - radius[h])
            high[k] = max(high[k], at[h, k] + radius[h])
    return low, high


@kernel
def _within(at, radius, near, begin, end, low, high):
    """Move indices of hulls that reach into bounds to the front; return where they end."""
    last = begin
    for h in near[begin:end]:
        inside = True
        for k in range(3):
            inside &= at[h, k] - radius[h] <= high[k] and at[h, k] + radius[h] >= low[k]
        if inside:
            near[last] = h
            last += 1
    return last


@kernel
def _overlap(R, p, hulls, h, k):
    """Return whether no direction is found that separates two hulls."""
    m, n = hulls.segment[h], hulls.segment[k]
    toward = sub(moved(R, p, n, hulls.center[k]), moved(R, p, m, hulls.center[h]))
    reach = hulls.radius[h] + hulls.radius[k] + hulls.margin
    if dot(toward, toward) > reach * reach:
        return False
    a = b = c = d = toward
    size = 0
    for _ in range(MAX_DIRECTIONS):
        b, c, d = a, b, c
        a = sub(
            moved(R, p, m, hulls.vertices[farthest_vertex(R, m, hulls, h, toward, 1.0)]),
            moved(R, p, n, hulls.vertices[farthest_vertex(R, n, hulls, k, toward, -1.0)]),
        )
        a = _grown(a, toward, hulls.margin)
        if dot(a, toward) < 0.0:
            return False
        size, b, c, toward = _next_simplex(a, b, c, d, size + 1)
        if size == 4:
            return True
    return True


@kernel
def hull_meets_box(R, p, hulls, h, boxes, b, cylinder, gap):
    """Return whether no direction is found that separates a hull from a box by a gap.

    Args:
        R, p: Segment poses (n + 1, 3, 3), (n + 1, 3).
        hulls: `HullArrays`.
        h: The hull.
        boxes: Centers, rotations and half edges of boxes.
        b: The box.
        cylinder: Whether it stands for the cylinder in it, about its third axis.
        gap: Required distance [m].
    """
    center, rotation, half = boxes
    m = hulls.segment[h]
    middle = moved(R, p, m, hulls.center[h])
    toward = (center[b, 0] - middle[0], center[b, 1] - middle[1], center[b, 2] - middle[2])
    a = i = j = k = toward
    size = 0
    for _ in range(MAX_DIRECTIONS):
        i, j, k = a, i, j
        a = sub(
            moved(R, p, m, hulls.vertices[farthest_vertex(R, m, hulls, h, toward, 1.0)]),
            _farthest_against(center, rotation, half, b, cylinder, toward),
        )
        a = _grown(a, toward, gap)
        if dot(a, toward) < 0.0:
            return False
        size, i, j, toward = _next_simplex(a, i, j, k, size + 1)
        if size == 4:
            return True
    return True


@kernel
def _farthest_against(center, rotation, half, b, cylinder, toward):
    """Return the point of box b, or of the cylinder in it, that is farthest against a direction."""
    x, y, z = toward
    u = x * rotation[b, 0, 0] + y * rotation[b, 1, 0] + z * rotation[b, 2, 0]
    v = x * rotation[b, 0, 1] + y * rotation[b, 1, 1] + z * rotation[b, 2, 1]
    w = x * rotation[b, 0, 2] + y * rotation[b, 1, 2] + z * rotation[b, 2, 2]
    if cylinder:
        share = half[b, 0] / max(math.sqrt(u * u + v * v), 1e-12)
        u, v = -share * u, -share * v
    else:
        u, v = -math.copysign(half[b, 0], u), -math.copysign(half[b, 1], v)
    w = -math.copysign(half[b, 2], w)
    return (
        center[b, 0] + rotation[b, 0, 0] * u + rotation[b, 0, 1] * v + rotation[b, 0, 2] * w,
        center[b, 1] + rotation[b, 1, 0] * u + rotation[b, 1, 1] * v + rotation[b, 1, 2] * w,
        center[b, 2] + rotation[b, 2, 0] * u + rotation[b, 2, 1] * v + rotation[b, 2, 2] * w,
    )


@kernel
def _grown(a, toward, margin):
    """Return a point of a difference of bodies, after a Minkowski sum with a ball."""
    if margin > 0.0:
        out = margin / max(math.sqrt(dot(toward, toward)), 1e-12)
        return a[0] + out * toward[0], a[1] + out * toward[1], a[2] + out * toward[2]
    return a


@kernel
def _next_simplex(a, b, c, d, size):
    """Reduce a simplex to the face, edge or point beyond which the origin is.

    Returns:
        The size of the simplex, 4 if it contains the origin; its points besides a; and the
        direction in which the origin is.
    """
    ab, ac, ad = sub(b, a), sub(c, a), sub(d, a)
    toward = a
    if size == 4:
        if dot(cross(ab, ac), a) < 0.0:
            size = 3
        elif dot(cross(ac, ad), a) < 0.0:
            size, b, c, ab, ac = 3, c, d, ac, ad
        elif dot(cross(ad, ab), a) < 0.0:
            size, b, c, ab, ac = 3, d, b, ad, ab
        else:
            return 4, b, c, toward
    if size == 3:
        toward = cross(ab, ac)
        if dot(cross(toward, ac), a) < 0.0:
            size = 2
            if dot(ac, a) < 0.0:
                b, ab = c, ac
        elif dot(cross(ab, toward), a) < 0.0:
            size = 2
        elif dot(toward, a) > 0.0:
            b, c, toward = c, b, cross(ac, ab)
    if size == 2:
        toward = cross(cross(a, ab), ab)
        if dot(ab, a) >= 0.0:
            size = 1
    if size == 1:
        toward = (-a[0], -a[1], -a[2])
    return size, b, c, toward


@kernel
def farthest_vertex(R, segment, hulls, h, toward, sign):
    """Return the vertex of a hull that is farthest along sign times a direction."""
    T = R[segment]
    x, y, z = sign * toward[0], sign * toward[1], sign * toward[2]
    direction = (
        T[0, 0] * x + T[1, 0] * y + T[2, 0] * z,
        T[0, 1] * x + T[1, 1] * y + T[2, 1] * z,
        T[0, 2] * x + T[1, 2] * y + T[2, 2] * z,
    )
    if hulls.first[h + 1] - hulls.first[h] > MAX_SCANNED_VERTICES:
        return climb(hulls, hulls.begin[h, direction_bin(direction)], direction)
    best, farthest = hulls.first[h], -math.inf
    for v in range(hulls.first[h], hulls.first[h + 1]):
        along = _along(hulls.vertices, v, direction)
        if along > farthest:
            best, farthest = v, along
    return best


@kernel
def climb(hulls, v, direction):
    """Return the farthest vertex, from neighbor to neighbor, each farther than the last."""
    best, farthest = v, _along(hulls.vertices, v, direction)
    while True:
        for e in range(hulls.neighbors_from[v], hulls.neighbors_from[v + 1]):
            along = _along(hulls.vertices, hulls.neighbors[e], direction)
            if along > farthest:
                best, farthest = hulls.neighbors[e], along
        if best == v:
            return v
        v = best


@kernel
def _along(vertices, v, direction):
    return (
        vertices[v, 0] * direction[0]
        + vertices[v, 1] * direction[1]
        + vertices[v, 2] * direction[2]
    )


@kernel
def direction_bin(direction):
    """Return the bin of a direction: a cell of a cube's faces."""
    x, y, z = direction
    along, u, v, face = x, y, z, 0
    if abs(y) > abs(along):
        along, u, v, face = y, z, x, 2
    if abs(z) > abs(along):
        along, u, v, face = z, x, y, 4
    if along < 0.0:
        face += 1
    half = 0.5 * DIRECTION_CELLS / max(abs(along), 1e-300)
    i = min(max(int((u * half) + 0.5 * DIRECTION_CELLS), 0), DIRECTION_CELLS - 1)
    j = min(max(int((v * half) + 0.5 * DIRECTION_CELLS), 0), DIRECTION_CELLS - 1)
    return (face * DIRECTION_CELLS + i) * DIRECTION_CELLS + j


@kernel
def moved(R, p, segment, local):
    """Map a point of a segment to the frame of the chain's base pose."""
    return (
        p[segment, 0]
        + R[segment, 0, 0] * local[0]
        + R[segment, 0, 1] * local[1]
        + R[segment, 0, 2] * local[2],
        p[segment, 1]
        + R[segment, 1, 0] * local[0]
        + R[segment, 1, 1] * local[1]
        + R[segment, 1, 2] * local[2],
        p[segment, 2]
        + R[segment, 2, 0] * local[0]
        + R[segment, 2, 1] * local[1]
        + R[segment, 2, 2] * local[2],
    )


_CELL = (np.arange(DIRECTION_CELLS) + 0.5) * 2.0 / DIRECTION_CELLS - 1.0
BIN_CENTERS = np.array(
    [
        np.roll((along, u, v), k)
        for k, along, u, v in itertools.product(range(3), (1.0, -1.0), _CELL, _CELL)
    ]
)
"""Central direction of each bin, see `direction_bin`."""


@dataclass(frozen=True, eq=False)
class LinkHulls:
    """Convex hulls of the links' shapes, relative to the joint origins of their segments."""

    vertices: Float[np.ndarray, "v 3"]
    """Vertices of all hulls, concatenated [m]."""
    first: Int[np.ndarray, " hulls_plus_1"]
    """Vertices of hull h are first[h]:first[h + 1]."""
    center: Float[np.ndarray, "hulls 3"]
    """An interior point of each hull [m]."""
    radius: Float[np.ndarray, " hulls"]
    """Largest distance of a vertex from it [m]."""
    segment: Int[np.ndarray, " hulls"]
    of_group: Int[np.ndarray, " groups_plus_1"]
    """Hulls of group g are of_group[g]:of_group[g + 1]."""
    of_base: Int[np.ndarray, " b"]
    """The hull that each box of the base covers."""
    neighbors: Int[np.ndarray, " e"]
    """Neighbors of each vertex along edges; none for hulls with few vertices."""
    neighbors_from: Int[np.ndarray, " v_plus_1"]
    """Neighbors of vertex v are neighbors[neighbors_from[v]:neighbors_from[v + 1]]."""
    begin: Int[np.ndarray, "hulls parts"]
    """The vertex farthest along the central direction of each bin."""
    margin: float = 0.0
    """Hulls that are nearer to each other count as overlapping [m]."""

    @cached_property
    def arrays(self) -> HullArrays:
        """Return the hulls as an argument of kernels."""
        return HullArrays(
            self.vertices, self.first, self.center, self.radius, self.segment, self.of_group,
            self.of_base, self.neighbors, self.neighbors_from, self.begin, self.margin,
        )  # fmt: skip


def link_hulls(
    model: Articulated, segments: Segments, moving: Sequence[str], standing: Sequence[str]
) -> LinkHulls:
    """Return the hulls of the moving links, then those of the base.

    Args:
        model: The robot.
        segments: The segment of the arm with which each link moves.
        moving: The links that the arm moves, one group each.
        standing: The links of the base.
    """
    links = [(link, hull) for link in (*moving, *standing) for hull in model.hulls[link]]
    vertices = [apply(segments.T_segment_link[link], hull.vertices) for link, hull in links]
    first, center = np.cumsum([0, *map(len, vertices)]), [points.mean(0) for points in vertices]
    counts = [len(model.hulls[link]) for link in moving]
    boxes = [len(boxes) for link in standing for boxes in model.boxes[link]]
    many = [k for k, points in enumerate(vertices) if len(points) > MAX_SCANNED_VERTICES]
    begin = np.zeros((len(links), DIRECTION_BINS), np.int64)
    for k in many:
        used = np.unique(links[k][1].faces)
        begin[k] = first[k] + used[(vertices[k][used] @ BIN_CENTERS.T).argmax(0)]
    faces = [first[k] + links[k][1].faces for k in many]
    neighbors, neighbors_from = _neighbors(faces, int(first[-1]))
    return LinkHulls(
        vertices=np.concatenate([np.zeros((0, 3)), *vertices]),
        first=first,
        center=np.array(center).reshape(-1, 3),
        radius=np.array(
            [np.linalg.norm(v - c, axis=1).max() for v, c in zip(vertices, center, strict=True)]
        ),
        segment=np.array([segments.of_link[link] for link, _ in links], np.int64),
        of_group=np.cumsum([0, *counts]),
        of_base=np.repeat(sum(counts) + np.arange(len(boxes)), boxes),
        neighbors=neighbors,
        neighbors_from=neighbors_from,
        begin=begin,
    )


def surface_hulls(
    surfaces: Sequence[Float[np.ndarray, "_ 3 3"]], segment: Sequence[int]
) -> LinkHulls:
    """Return triangles as hulls: one group for the first surface, the others follow.

    Args:
        surfaces: Triangles relative to the joint origins of their segments [m].
        segment: The segment of each surface.
    """
    points = np.concatenate(surfaces)
    counts, center = [len(surface) for surface in surfaces], points.mean(1)
    return LinkHulls(
        vertices=points.reshape(-1, 3),
        first=3 * np.arange(len(points) + 1),
        center=center,
        radius=np.linalg.norm(points - center[:, None], axis=2).max(1),
        segment=np.repeat(np.array(segment, np.int64), counts),
        of_group=np.array([0, counts[0]]),
        of_base=np.zeros(0, np.int64),
        neighbors=np.zeros(0, np.int64),
        neighbors_from=np.zeros(len(points) * 3 + 1, np.int64),
        begin=np.zeros((1, 1), np.int64),
    )


def _neighbors(
    faces: Sequence[Int[np.ndarray, "_ 3"]], count: int
) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, " v_plus_1"]]:
    """Return the neighbors of all vertices, concatenated, and where those of each vertex begin."""
    corners = np.concatenate([np.zeros((0, 3), np.int64), *faces])
    start, end = corners.T.reshape(-1), np.roll(corners, -1, 1).T.reshape(-1)
    # Both directions: flat hulls may lack the face on the other side of an edge.
    start, end = np.divmod(
        np.unique(np.r_[start * count + end, end * count + start]), max(1, count)
    )
    return end, np.searchsorted(start, np.arange(count + 1))
