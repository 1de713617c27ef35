"""Curves of a car-like base: straight pieces and arcs, forwards and backwards, free of collision.

Source: Reeds, Shepp, "Optimal paths for a car that goes both forwards and backwards", 1990, section
8, with the formulas' numbers in the code. Their 44 words contain the shortest curve between any
two poses. One curve is added that lets a lattice turn: a straight piece and an arc of a larger
radius. All curves are kernels because a path search tries thousands of them.
"""

from __future__ import annotations

import numpy as np

from momapos.core.compiled import F2, entry, kernel

from .outline_gaps import gap, nearness, select

MAX_CURVES, MAX_PIECES = 45, 5
"""Number of curves between two poses, and of pieces of each [-]."""
_SMALL = 1e-9
"""Angles and lengths, in turning radii, below which a formula is degenerate [-]."""


@kernel
def _turned(angle):
    """Wrap an angle to (-pi, pi], and rounding errors just above -pi to pi."""
    angle = np.pi - (np.pi - angle) % (2 * np.pi)
    return angle if angle > -np.pi + _SMALL else np.pi


@kernel
def curves_between(a, b, radius, out):
    """Compute the curves from pose a to pose b.

    Args:
        a, b: Poses: x [m], y [m], yaw [rad].
        radius: Turning radius [m].
        out: Receives the pieces of each curve: signed length [m] and curvature [1/m]
            (`MAX_CURVES`, `MAX_PIECES`, 2).

    Returns:
        The number of curves; the straight line and the bend, if they exist, are among them.
    """
    x, y, phi = _relative(a, b, radius)
    count = _bend(x, y, phi, out)
    # The same curve backwards in time, mirrored, and from its end.
    for flip in (1.0, -1.0):
        for mirror in (1.0, -1.0):
            u, v, turn = flip * x, mirror * y, flip * mirror * phi
            count = _words(u, v, turn, flip, mirror, out, count)
            cosine, sine = np.cos(turn), np.sin(turn)
            u, v = u * cosine + v * sine, u * sine - v * cosine
            count = _reversible_words(u, v, turn, flip, mirror, True, out, count)
    _scale(out, count, radius)
    return count


@kernel
def bend_between(a, b, radius, out):
    """Compute the bend from a to b, see `curves_between`; return 1, or 0 if there is none."""
    x, y, phi = _relative(a, b, radius)
    count = _bend(x, y, phi, out)
    _scale(out, count, radius)
    return count


@kernel
def _relative(a, b, radius):
    """Return pose b in the frame of pose a, with lengths in radii."""
    c, s = np.cos(a[2]), np.sin(a[2])
    dx, dy = (b[0] - a[0]) / radius, (b[1] - a[1]) / radius
    return c * dx + s * dy, c * dy - s * dx, _turned(b[2] - a[2])


@kernel
def _scale(curves, count, radius):
    """Change the lengths and curvatures of curves from radii to meters."""
    for k in range(count):
        for piece in range(MAX_PIECES):
            curves[k, piece, 0] *= radius
            curves[k, piece, 1] /= radius


@kernel
def _put(out, count, lengths, bends, flip, mirror, reverse):
    """Add a curve of pieces with lengths and bends: 1 to the left, -1 to the right, 0 straight."""
    for k in range(MAX_PIECES):
        at = MAX_PIECES - 1 - k if reverse else k
        out[count, at, 0] = flip * lengths[k]
        out[count, at, 1] = mirror * bends[k]
    return count + 1


@kernel
def _bend(x, y, phi, out):
    """Add a straight piece and an arc, or an arc and a straight piece, of the largest radius."""
    sine = np.sin(phi)
    if abs(sine) < 1e-6:
        return 0
    # Both tangents meet at the first one's length before a, and the second one's after b.
    before, after = x - y * np.cos(phi) / sine, y / sine
    if before * after <= 0:
        return 0
    tangent = min(abs(before), abs(after))
    wide = tangent / np.tan(abs(phi) / 2)
    if wide < 1.0 - _SMALL:
        return 0
    way = np.sign(before)
    for k in range(MAX_PIECES):
        out[0, k, 0] = out[0, k, 1] = 0.0
    out[0, 0, 0] = before - way * tangent
    out[0, 1, 0], out[0, 1, 1] = way * wide * abs(phi), way * np.sign(phi) / wide
    out[0, 2, 0] = after - way * tangent
    return 1


@kernel
def _words(x, y, phi, flip, mirror, out, count):
    """Add the words that begin with a left turn forwards, see `curves_between`."""
    sine, cosine = np.sin(phi), np.cos(phi)
    # 8.1: left, straight, left.
    e, n = x - sine, y - 1 + cosine
    u, t = np.hypot(e, n), np.arctan2(n, e)
    v = _turned(phi - t)
    if t >= -_SMALL and v >= -_SMALL:
        count = _put(out, count, (t, u, v, 0.0, 0.0), (1, 0, 1, 0, 0), flip, mirror, False)
    # 8.2: left, straight, right.
    e, n = x + sine, y - 1 - cosine
    square, angle = e * e + n * n, np.arctan2(n, e)
    if square >= 4:
        u = np.sqrt(square - 4)
        t = _turned(angle + np.arctan2(2.0, u))
        v = _turned(t - phi)
        if t >= -_SMALL and v >= -_SMALL:
            count = _put(out, count, (t, u, v, 0.0, 0.0), (1, 0, -1, 0, 0), flip, mirror, False)
    # 8.7: left, right | left, right, with equal middle arcs.
    rho = (2 + np.sqrt(square)) / 4
    if rho <= 1:
        u = np.arccos(rho)
        t, v = _outer_arcs(u, -u, e, n, phi)
        if t >= -_SMALL and v <= _SMALL:
            count = _put(out, count, (t, u, -u, v, 0.0), (1, -1, 1, -1, 0), flip, mirror, False)
    # 8.8: left | right, left | right.
    rho = (20 - square) / 16
    if 0 <= rho <= 1:
        u = -np.arccos(rho)
        if u >= -np.pi / 2:
            t, v = _outer_arcs(u, u, e, n, phi)
            if t >= -_SMALL and v >= -_SMALL:
                count = _put(out, count, (t, u, u, v, 0.0), (1, -1, 1, -1, 0), flip, mirror, False)
    # 8.11: left | right, straight, left | right.
    if square >= 4:
        u = 4 - np.sqrt(square - 4)
        if u <= _SMALL:
            t = _turned(np.arctan2((4 - u) * e - 2 * n, -2 * e + (u - 4) * n))
            v = _turned(t - phi)
            if t >= -_SMALL and v >= -_SMALL:
                quarter = -np.pi / 2
                lengths = (t, quarter, u, quarter, v)
                count = _put(out, count, lengths, (1, -1, 0, 1, -1), flip, mirror, False)
    return _reversible_words(x, y, phi, flip, mirror, False, out, count)


@kernel
def _reversible_words(x, y, phi, flip, mirror, reverse, out, count):
    """Add the words that are others when they are driven from their end."""
    sine, cosine = np.sin(phi), np.cos(phi)
    e, n = x - sine, y - 1 + cosine
    rho, angle = np.hypot(e, n), np.arctan2(n, e)
    # 8.3, 8.4: left | right, left.
    if rho <= 4:
        u = -2 * np.arcsin(rho / 4)
        t = _turned(angle + u / 2 + np.pi)
        v = _turned(phi - t + u)
        if t >= -_SMALL and u <= _SMALL:
            count = _put(out, count, (t, u, v, 0.0, 0.0), (1, -1, 1, 0, 0), flip, mirror, reverse)
    quarter = -np.pi / 2
    # 8.9: left | right, straight, left.
    if rho >= 2:
        r = np.sqrt(rho * rho - 4)
        u = 2 - r
        t = _turned(angle + np.arctan2(r, -2.0))
        v = _turned(phi + quarter - t)
        if t >= -_SMALL and u <= _SMALL and v <= _SMALL:
            lengths = (t, quarter, u, v, 0.0)
            count = _put(out, count, lengths, (1, -1, 0, 1, 0), flip, mirror, reverse)
    # 8.10: left | right, straight, right.
    e, n = x + sine, y - 1 - cosine
    rho, t = np.hypot(e, n), np.arctan2(e, -n)
    if rho >= 2:
        u = 2 - rho
        v = _turned(t - quarter - phi)
        if t >= -_SMALL and u <= _SMALL and v <= _SMALL:
            lengths = (t, quarter, u, v, 0.0)
            count = _put(out, count, lengths, (1, -1, 0, -1, 0), flip, mirror, reverse)
    return count


@kernel
def _outer_arcs(u, v, e, n, phi):
    """Return the first and last arc around two known ones (8.7, 8.8)."""
    delta = _turned(u - v)
    p, q = np.sin(u) - np.sin(delta), np.cos(u) - np.cos(delta) - 1
    t = np.arctan2(n * p - e * q, e * p + n * q)
    if 2 * (np.cos(delta) - np.cos(v) - np.cos(u)) + 3 < 0:
        t += np.pi
    t = _turned(t)
    return t, _turned(t - u + v - phi)


@kernel
def along(pose, length, curvature, out):
    """Compute the pose after a signed length on an arc; `out` may be `pose`."""
    turn = curvature * length
    yaw = pose[2]
    # The chord has the heading of the arc's middle.
    half = turn / 2
    chord = length if abs(half) < _SMALL else length * np.sin(half) / half
    out[0] = pose[0] + chord * np.cos(yaw + half)
    out[1] = pose[1] + chord * np.sin(yaw + half)
    out[2] = yaw + turn


@kernel
def length_of(curve):
    """Return the length of a curve [m]."""
    total = 0.0
    for k in range(MAX_PIECES):
        total += abs(curve[k, 0])
    return total


MAX_TRIES = 12
"""Number of curves between two poses that are checked, the cheapest first [-]."""


@kernel
def arc(a, length, curvature, surroundings, weights, scratch):
    """Return the cost of an arc from pose a [m], infinite on collision; see `leg`."""
    need, preferred = weights.needed_clearance, weights.preferred_clearance
    radius, bounds = surroundings.prisms.radius, surroundings.obstacles.bounds
    turn, size = abs(curvature * length), abs(length)
    moved = size + radius * turn
    cap = max(preferred, 0.2)
    at = np.empty(3)
    along(a, length / 2, curvature, at)
    count = select(at[0], at[1], size / 2 + radius + cap, bounds, scratch.near)
    rate = (size + weights.turning * turn) / max(moved, 1e-12)
    cost, done = 0.0, 0.0
    while True:
        along(a, length * (done / moved if moved > 0 else 0.0), curvature, at)
        g = gap(at[0], at[1], at[2], surroundings, count, cap, scratch)
        if g < need:
            return np.inf
        if done >= moved:
            return cost
        step = min(g - need / 2, moved - done)
        cost += step * rate * nearness(g, preferred, weights)
        done += step


@kernel
def _least_cost(curve, weights):
    """Return the cost of a curve far from obstacles [m]."""
    cost, before = 0.0, 0.0
    for k in range(MAX_PIECES):
        size = abs(curve[k, 0])
        if size < 1e-9:
            continue
        factor = weights.reversing if curve[k, 0] < 0 else 1.0
        cost += factor * (size + weights.turning * size * abs(curve[k, 1]))
        if curve[k, 0] * before < 0:
            cost += weights.cusp
        before = curve[k, 0]
    return cost


@kernel
def _cost(a, curve, least, limit, surroundings, weights, scratch):
    """Return the cost of a curve from pose a [m], infinite on collision or above the limit."""
    cost, at = least, a.copy()
    for k in range(MAX_PIECES):
        size = abs(curve[k, 0])
        if size < 1e-9:
            continue
        factor = weights.reversing if curve[k, 0] < 0 else 1.0
        free = size + weights.turning * size * abs(curve[k, 1])
        close = arc(at, curve[k, 0], curve[k, 1], surroundings, weights, scratch)
        cost += factor * (close - free)
        if cost > limit:
            return np.inf
        along(at, curve[k, 0], curve[k, 1], at)
    return cost


@kernel
def connect_car(a, b, radius, surroundings, weights, limit, scratch):
    """Find the cheapest free curve between two poses that costs at most the limit.

    Args:
        a, b: Poses: x [m], y [m], yaw [rad].
        radius: Turning radius [m].
        surroundings, weights, scratch: See `connect`.
        limit: Largest cost [m].

    Returns:
        The cost [m], infinite without a curve, and the curve (`MAX_PIECES`, 2): signed length [m]
        and curvature [1/m] of its pieces.
    """
    curves = np.empty((MAX_CURVES, MAX_PIECES, 2))
    count = curves_between(a, b, radius, curves)
    least = np.empty(count)
    for k in range(count):
        least[k] = _least_cost(curves[k], weights)
    best, chosen = np.inf, np.argmin(least)
    for _ in range(min(count, MAX_TRIES)):
        next_ = np.argmin(least)
        bound = min(best, limit)
        if least[next_] > bound:
            break
        cost = _cost(a, curves[next_], least[next_], bound, surroundings, weights, scratch)
        if cost < best:
            best, chosen = cost, next_
        least[next_] = np.inf
    return best, curves[chosen]


@kernel
def bend_cost(a, b, radius, surroundings, weights, scratch):
    """Return the cost of the bend between two states of the lattice [m], infinite on collision."""
    curve = np.empty((1, MAX_PIECES, 2))
    if bend_between(a, b, radius, curve) == 0:
        return np.inf
    least = _least_cost(curve[0], weights)
    return _cost(a, curve[0], least, np.inf, surroundings, weights, scratch)


@entry
def shortest_lengths(a: F2, b: F2, radius: float) -> np.ndarray:
    """Return the length of the shortest curve between pairs of poses (n, 3) [m]."""
    curves = np.empty((MAX_CURVES, MAX_PIECES, 2))
    out = np.empty(len(a))
    for n in range(len(a)):
        out[n] = np.inf
        for k in range(curves_between(a[n], b[n], radius, curves)):
            out[n] = min(out[n], length_of(curves[k]))
    return out
