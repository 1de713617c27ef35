"""Check whether convex hulls of links overlap, for pairs that spheres are too coarse for.

GJK: a simplex of points of the difference of two hulls moves toward the origin. It ends if a
direction separates the hulls, or if the simplex contains the origin. If rounding prevents that, the
hulls count as overlapping, which is the safe side.

Source: van den Bergen, Collision Detection in Interactive 3D Environments (2003), chapter 4.
"""

from __future__ import annotations

import math

from momapos.core.compiled import kernel
from momapos.model.kinematics import cross, dot, sub

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
def _overlap(R, p, hulls, h, k):
    """Return whether no direction is found that separates two hulls."""
    m, n = hulls.segment[h], hulls.segment[k]
    toward = sub(moved(R, p, n, hulls.center[k]), moved(R, p, m, hulls.center[h]))
    a = b = c = d = toward
    size = 0
    for _ in range(MAX_DIRECTIONS):
        b, c, d = a, b, c
        a = sub(
            moved(R, p, m, hulls.vertices[farthest_vertex(R, m, hulls, h, toward, 1.0)]),
            moved(R, p, n, hulls.vertices[farthest_vertex(R, n, hulls, k, toward, -1.0)]),
        )
        if hulls.margin > 0.0:  # Minkowski sum with a ball of that radius
            out = hulls.margin / max(math.sqrt(dot(toward, toward)), 1e-12)
            a = (a[0] + out * toward[0], a[1] + out * toward[1], a[2] + out * toward[2])
        if dot(a, toward) < 0.0:
            return False
        size += 1
        ab, ac, ad = sub(b, a), sub(c, a), sub(d, a)
        # Reduce the simplex to the face, edge or point beyond which the origin is.
        if size == 4:
            if dot(cross(ab, ac), a) < 0.0:
                size = 3
            elif dot(cross(ac, ad), a) < 0.0:
                size, b, c, ab, ac = 3, c, d, ac, ad
            elif dot(cross(ad, ab), a) < 0.0:
                size, b, c, ab, ac = 3, d, b, ad, ab
            else:
                return True
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
    return True


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
