"""Whether links overlap, by their convex hulls: for pairs that spheres are too coarse for.

GJK: a simplex of points of the difference of two hulls moves toward the origin. It ends when a
direction separates the hulls, or when the simplex holds the origin. Where rounding keeps it from
ending, the hulls count as overlapping: an error is on the safe side.

Source: van den Bergen, Collision Detection in Interactive 3D Environments (2003), chapter 4.
"""

from __future__ import annotations

import math

from momapos.core.compiled import kernel
from momapos.model.kinematics import cross, dot, sub

TRIES = 40
"""Directions that are tried; 3 are enough as a rule [-]."""
FEW = 200
"""Vertices of which all are looked at for the one that lies farthest along a direction; those of a
mesh may be thousands, and are climbed from neighbor to neighbor [-]."""
CELLS = 8
"""Cells along each side of a cube's face, which tell directions apart [-]."""
PARTS = 6 * CELLS * CELLS
"""Parts of space in each of which climbing begins at a vertex of its own [-]."""


@kernel
def hulls_overlap(R, p, hulls, i, first, last):
    """Whether a hull of a link overlaps one of the hulls first:last, or is nearer than `room`.

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
    """Whether no direction is found that separates two hulls."""
    m, n = hulls.segment[h], hulls.segment[k]
    toward = sub(moved(R, p, n, hulls.center[k]), moved(R, p, m, hulls.center[h]))
    a = b = c = d = toward
    size = 0
    for _ in range(TRIES):
        b, c, d = a, b, c
        a = sub(
            moved(R, p, m, hulls.vertices[_outermost(R, m, hulls, h, toward, 1.0)]),
            moved(R, p, n, hulls.vertices[_outermost(R, n, hulls, k, toward, -1.0)]),
        )
        if hulls.room > 0.0:  # the sum with a ball of that radius
            out = hulls.room / max(math.sqrt(dot(toward, toward)), 1e-12)
            a = (a[0] + out * toward[0], a[1] + out * toward[1], a[2] + out * toward[2])
        if dot(a, toward) < 0.0:
            return False
        size += 1
        ab, ac, ad = sub(b, a), sub(c, a), sub(d, a)
        # From a tetrahedron to the face, to the edge, to the point that the origin is beyond.
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
def _outermost(R, segment, hulls, h, toward, sign):
    """Index of the vertex of a hull that lies farthest along a direction, or against it."""
    T = R[segment]
    x, y, z = sign * toward[0], sign * toward[1], sign * toward[2]
    direction = (
        T[0, 0] * x + T[1, 0] * y + T[2, 0] * z,
        T[0, 1] * x + T[1, 1] * y + T[2, 1] * z,
        T[0, 2] * x + T[1, 2] * y + T[2, 2] * z,
    )
    if hulls.first[h + 1] - hulls.first[h] > FEW:
        return climbed(hulls, hulls.begin[h, part_of_space(direction)], direction)
    best, farthest = hulls.first[h], -math.inf
    for v in range(hulls.first[h], hulls.first[h + 1]):
        along = _along(hulls.vertices, v, direction)
        if along > farthest:
            best, farthest = v, along
    return best


@kernel
def climbed(hulls, v, direction):
    """The farthest vertex, over neighbors from another: on a convex body each is nearer to it."""
    best, farthest = v, _along(hulls.vertices, v, direction)
    while True:
        for e in range(hulls.beside_from[v], hulls.beside_from[v + 1]):
            along = _along(hulls.vertices, hulls.beside[e], direction)
            if along > farthest:
                best, farthest = hulls.beside[e], along
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
def part_of_space(direction):
    """Which of `PARTS` parts of space a direction points to: cells of a cube's faces."""
    x, y, z = direction
    along, u, v, face = x, y, z, 0
    if abs(y) > abs(along):
        along, u, v, face = y, z, x, 2
    if abs(z) > abs(along):
        along, u, v, face = z, x, y, 4
    if along < 0.0:
        face += 1
    half = 0.5 * CELLS / max(abs(along), 1e-300)
    i = min(max(int((u * half) + 0.5 * CELLS), 0), CELLS - 1)
    j = min(max(int((v * half) + 0.5 * CELLS), 0), CELLS - 1)
    return (face * CELLS + i) * CELLS + j


@kernel
def moved(R, p, segment, local):
    """A point of a segment in the frame of the chain's base pose."""
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
