"""Collision-free curves of a car-like base between two poses."""

from __future__ import annotations

import numpy as np

from momapos.core.compiled import F2, entry, kernel

from .outline_gaps import gap, nearness, select
from .reeds_shepp import (
    MAX_CURVES,
    MAX_PIECES,
    along,
    bend_between,
    curves_between,
    length_of,
)

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
