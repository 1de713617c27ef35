"""Signed distance of two convex bodies, with errors on the safe side only.

A body is the hull of points, extended by a disc in its own xy plane and by a ball: a box or a mesh
is points alone, a cylinder two points and a disc, a sphere one point and a ball. GJK computes
distances, an expanding polytope (EPA) depths. The result is the extent along the best direction
evaluated on the bodies themselves, not the last simplex. So if the iteration stops early, a depth
is too large and a distance too small, never the reverse.

Libraries are no alternative: python-fcl is wrong for 0.5 % of axis-aligned boxes (by up to 0.58 m),
does not return for concentric spheres, and a C++ exception in its wrapper ends the process; coal
is 380 MB. `docs/results/verification.md` has the measurements.

Sources: van den Bergen, Collision Detection in Interactive 3D Environments (2003), chapter 4.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from momapos.core.compiled import F1, F2, I2, entry, kernel

TOLERANCE = 1e-6
"""Gap between the bounds at which a distance counts as exact [m]."""
_MAX_STEPS = 80
_MAX_POINTS = 160
_MAX_FACES = 2 * _MAX_POINTS
_FLAT = 1e-10
"""Lengths below this are zero [m]."""

# Numbers passed to another kernel are not literals: numba compiles that kernel for each literal.


class Body(NamedTuple):
    """The hull of points (n, 3), extended by a disc in its xy plane and by a ball [m]."""

    points: F2
    disc: float
    ball: float


@kernel
def _extreme(points, disc, x, y, z, out):
    """Write the point of a core (without ball) that lies farthest along (x, y, z)."""
    best, value = 0, -np.inf
    for i in range(len(points)):
        dot = points[i, 0] * x + points[i, 1] * y + points[i, 2] * z
        if dot > value:
            best, value = i, dot
    out[0], out[1], out[2] = points[best, 0], points[best, 1], points[best, 2]
    length = np.sqrt(x * x + y * y)
    if disc > 0.0 and length > 1e-12:
        out[0] += disc * x / length
        out[1] += disc * y / length


@kernel
def _support(a, b, T, n, w, work):
    """Write the point of the difference A - B farthest along `n`; all in the frame of B."""
    pa, pb = work[0], work[1]
    x = T[0, 0] * n[0] + T[1, 0] * n[1] + T[2, 0] * n[2]
    y = T[0, 1] * n[0] + T[1, 1] * n[1] + T[2, 1] * n[2]
    z = T[0, 2] * n[0] + T[1, 2] * n[1] + T[2, 2] * n[2]
    _extreme(a.points, a.disc, x, y, z, pa)
    _extreme(b.points, b.disc, -n[0], -n[1], -n[2], pb)
    for k in range(3):
        w[k] = T[k, 0] * pa[0] + T[k, 1] * pa[1] + T[k, 2] * pa[2] + T[k, 3] - pb[k]
    return w[0] * n[0] + w[1] * n[1] + w[2] * n[2]


@kernel
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def _set(a, x, y, z):
    a[0], a[1], a[2] = x, y, z


@kernel
def _normal(p, q, r, n):
    """Write the cross product of two edges of a triangle; return its length."""
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    n[0], n[1], n[2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return np.sqrt(_dot(n, n))


# --------------------------------------------------------------------------------------------- GJK


@kernel
def _try_segment(y, i, j, weights, best):
    """Take the point of a segment nearest to the origin if it beats `best` (squared)."""
    along = square = 0.0
    for k in range(3):
        e = y[j, k] - y[i, k]
        along -= y[i, k] * e
        square += e * e
    t = min(1.0, max(0.0, along / square)) if square > 0.0 else 0.0
    distance = 0.0
    for k in range(3):
        c = (1.0 - t) * y[i, k] + t * y[j, k]
        distance += c * c
    if distance < best:
        weights[:] = 0.0
        weights[i], weights[j] = 1.0 - t, t
        return distance
    return best


@kernel
def _try_triangle(y, i, j, k, weights, best, n):
    """Take the point of a triangle nearest to the origin if it beats `best` (squared)."""
    area = _normal(y[i], y[j], y[k], n)
    if area > 0.0:
        height = _dot(n, y[i]) / (area * area)
        # Barycentric weights of the origin's projection, from the signed areas.
        px, py, pz = height * n[0], height * n[1], height * n[2]
        wi = _corner(n, y[j], y[k], px, py, pz) / (area * area)
        wj = _corner(n, y[k], y[i], px, py, pz) / (area * area)
        wk = 1.0 - wi - wj
        if wi > 0.0 and wj > 0.0 and wk > 0.0:
            distance = px * px + py * py + pz * pz
            if distance < best:
                weights[:] = 0.0
                weights[i], weights[j], weights[k] = wi, wj, wk
                return distance
            return best
    best = _try_segment(y, i, j, weights, best)
    best = _try_segment(y, j, k, weights, best)
    return _try_segment(y, k, i, weights, best)


@kernel
def _corner(n, q, r, px, py, pz):
    """Return the triple product n . ((q - p) x (r - p))."""
    ux, uy, uz = q[0] - px, q[1] - py, q[2] - pz
    vx, vy, vz = r[0] - px, r[1] - py, r[2] - pz
    return n[0] * (uy * vz - uz * vy) + n[1] * (uz * vx - ux * vz) + n[2] * (ux * vy - uy * vx)


@kernel
def _nearest(y, count, weights, n):
    """Write weights of the simplex point nearest to the origin; False if the origin is inside."""
    weights[:] = 0.0
    if count == 1:
        weights[0] = 1.0
        return True
    if count == 2:
        _try_segment(y, count - 2, count - 1, weights, np.inf)
        return True
    if count == 3:
        _try_triangle(y, count - 3, count - 2, count - 1, weights, np.inf, n)
        return True
    best, outside = np.inf, False
    for apex in range(4):
        i, j, k = (apex + 1) % 4, (apex + 2) % 4, (apex + 3) % 4
        _normal(y[i], y[j], y[k], n)
        plane = _dot(n, y[i])
        if -plane * (_dot(n, y[apex]) - plane) <= 0.0:
            outside = True
            best = _try_triangle(y, i, j, k, weights, best, n)
    return outside


@kernel
def _gjk(a, b, T, work):
    """Bound the distance of two cores from below [m], to TOLERANCE; <= 0 if they may meet."""
    y, v, n, w = work[2:6], work[6], work[7], work[8]
    weights = np.zeros(4)
    count, best, length = 0, -np.inf, np.inf
    _set(v, T[0, 3], T[1, 3], T[2, 3])
    for _ in range(_MAX_STEPS):
        size = np.sqrt(_dot(v, v))
        if size < _FLAT:
            if count:
                return 0.0
            v[0], size = 1.0, 1.0
        for k in range(3):
            n[k] = -v[k] / size
        best = max(best, -_support(a, b, T, n, w, work))
        if length - best <= TOLERANCE:
            return best
        _set(y[count], w[0], w[1], w[2])
        count += 1
        if not _nearest(y, count, weights, n):
            return 0.0
        kept = 0
        _set(v, 0.0, 0.0, 0.0)
        for i in range(count):
            if weights[i] > 0.0:
                for k in range(3):
                    y[kept, k] = y[i, k]
                    v[k] += weights[i] * y[i, k]
                kept += 1
        count = kept
        shorter = np.sqrt(_dot(v, v))
        if shorter >= length:  # no progress, due to rounding
            return best
        length = shorter
    return best


# --------------------------------------------------------------------------- expanding polytope


@kernel
def _first_points(a, b, T, p, work):
    """Span a tetrahedron inside A - B; return the smallest extent found, or -1 if A - B is flat."""
    n, w, u = work[7], work[8], work[2]
    best, widest = np.inf, _FLAT
    for axis in range(3):
        _set(n, 1.0 * (axis == 0), 1.0 * (axis == 1), 1.0 * (axis == 2))
        best = min(best, _support(a, b, T, n, u, work))
        n[axis] = -1.0
        best = min(best, _support(a, b, T, n, w, work))
        if u[axis] - w[axis] > widest:
            widest = u[axis] - w[axis]
            _set(p[0], u[0], u[1], u[2])
            _set(p[1], w[0], w[1], w[2])
    if widest == _FLAT:
        return -1.0
    # A direction perpendicular to the line, then those perpendicular to the triangle.
    x, y, z = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
    if abs(x) < abs(z):
        _set(u, 0.0, -z, y)
    else:
        _set(u, -y, x, 0.0)
    for corner in range(2, 4):
        far = _FLAT
        for turn in range(4):
            if turn == 2 and corner == 2:  # A - B may be flat along the first direction
                _set(u, y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0])
            size = np.sqrt(_dot(u, u)) * (1.0 if turn % 2 == 0 else -1.0)
            _set(n, u[0] / size, u[1] / size, u[2] / size)
            best = min(best, _support(a, b, T, n, w, work))
            away = abs(n[0] * (w[0] - p[0, 0]) + n[1] * (w[1] - p[0, 1]) + n[2] * (w[2] - p[0, 2]))
            if away > far:
                far = away
                _set(p[corner], w[0], w[1], w[2])
        if far == _FLAT:
            return -1.0
        _normal(p[0], p[1], p[2], u)
    return best


class Polytope(NamedTuple):
    """The growing hull of the known points of A - B."""

    p: F2
    corners: I2
    normals: F2
    offsets: F1
    edges: I2
    """Edges of the removed faces."""
    inside: F1
    """An interior point."""


@kernel
def _set_face(f, polytope):
    """Compute the plane of face `f`, its normal away from `inside`; slivers are never nearest."""
    p, corners, inside = polytope.p, polytope.corners, polytope.inside
    normals, offsets = polytope.normals, polytope.offsets
    i, j, k = corners[f]
    n = normals[f]
    area = _normal(p[i], p[j], p[k], n)
    if area < 1e-18:
        _set(n, 0.0, 0.0, 0.0)
        offsets[f] = np.inf
        return
    for c in range(3):
        n[c] /= area
    offsets[f] = _dot(n, p[i])
    if offsets[f] < _dot(n, inside):
        for c in range(3):
            n[c] = -n[c]
        offsets[f] = -offsets[f]


@kernel
def _depth(a, b, T, work):
    """Bound the depth of two cores from above [m], to TOLERANCE; < 0 if they are apart.

    The polytope need not contain the origin at first: the faces that separate it from the origin
    have the smallest offsets and are expanded first.
    """
    p = np.empty((_MAX_POINTS, 3))
    best = _first_points(a, b, T, p, work)
    if best == -1.0:
        return 0.0
    corners = np.empty((_MAX_FACES, 3), np.int64)
    normals, offsets = np.empty((_MAX_FACES, 3)), np.empty(_MAX_FACES)
    edges = np.empty((_MAX_FACES, 2), np.int64)
    inside = np.empty(3)
    polytope = Polytope(p, corners, normals, offsets, edges, inside)
    for k in range(3):
        inside[k] = (p[0, k] + p[1, k] + p[2, k] + p[3, k]) / 4.0
    for f in range(4):
        _set(corners[f], f, (f + 1) % 4, (f + 2) % 4)
        _set_face(f, polytope)
    faces, w = np.int64(4), work[8]
    for count in range(4, _MAX_POINTS):
        nearest = 0
        for f in range(1, faces):
            if offsets[f] < offsets[nearest]:
                nearest = f
        best = min(best, _support(a, b, T, normals[nearest], w, work))
        if best - offsets[nearest] <= TOLERANCE:
            return best
        _set(p[count], w[0], w[1], w[2])
        faces = _expand(count, polytope, faces)
        if faces < 0:
            return best
    return best


@kernel
def _expand(new, polytope, faces):
    """Replace the faces that see a new point by a fan around it.

    Returns the number of faces, or -1 if there are too many.
    """
    p, corners, edges = polytope.p, polytope.corners, polytope.edges
    normals, offsets = polytope.normals, polytope.offsets
    open_edges, kept = np.int64(0), np.int64(0)
    for f in range(faces):
        if _dot(normals[f], p[new]) - offsets[f] > _FLAT:
            for side in range(3):
                i, j = corners[f, side], corners[f, (side + 1) % 3]
                open_edges = _toggle(edges, open_edges, min(i, j), max(i, j))
                if open_edges < 0:
                    return -1
        else:
            _set(corners[kept], corners[f, 0], corners[f, 1], corners[f, 2])
            _set(normals[kept], normals[f, 0], normals[f, 1], normals[f, 2])
            offsets[kept] = offsets[f]
            kept += 1
    if kept + open_edges > _MAX_FACES:
        return -1
    for e in range(open_edges):
        _set(corners[kept], edges[e, 0], edges[e, 1], new)
        _set_face(kept, polytope)
        kept += 1
    return kept


@kernel
def _toggle(edges, count, i, j):
    """Add an edge, or remove it if present; the remaining edges are the rim of the hole."""
    for e in range(count):
        if edges[e, 0] == i and edges[e, 1] == j:
            edges[e, 0], edges[e, 1] = edges[count - 1, 0], edges[count - 1, 1]
            return count - 1
    if count == len(edges):
        return -1
    edges[count, 0], edges[count, 1] = i, j
    return count + 1


@entry
def overlap(a: Body, b: Body, T: F2) -> float:
    """Return the overlap depth of two bodies [m], or minus their distance if they are apart.

    Args:
        a, b: The bodies, each in its own frame.
        T: Pose of A in the frame of B (4, 4).
    """
    work = np.empty((9, 3))
    distance = _gjk(a, b, T, work)
    core = -distance if distance > 0.0 else _depth(a, b, T, work)
    return core + a.ball + b.ball
