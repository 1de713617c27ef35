"""How far the robot's outlines are from the room's, and whether it can move without touching.

The gap of two convex outlines is their largest separation along the normals of their edges: it is
positive just where they do not overlap, and never more than their distance. So a motion that moves
no point of the robot by more than the gap cannot touch, and long motions are checked in steps as
large as the room allows (conservative advancement), without a resolution that a corner could slip
through.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from momapos.navigation.outlines import Body, Outlines

if TYPE_CHECKING:
    from jaxtyping import Float

DEEP = -0.1
"""Where the robot overlaps something by this much, no more is looked at [m]."""


@njit(cache=True, nogil=True)
def gap(x, y, yaw, body, things, near, count, cap, work):
    """Smallest gap to the first `count` outlines listed in `near` [m], at most `cap`."""
    point, normal, level, start, radius = body
    corner, side, at, first, layer, box = things
    c, s = np.cos(yaw), np.sin(yaw)
    for i in range(len(point)):
        work[i, 0] = x + c * point[i, 0] - s * point[i, 1]
        work[i, 1] = y + s * point[i, 0] + c * point[i, 1]
        work[i, 2] = c * normal[i, 0] - s * normal[i, 1]
        work[i, 3] = s * normal[i, 0] + c * normal[i, 1]
        work[i, 4] = level[i] + work[i, 2] * x + work[i, 3] * y
    best = cap
    for k in range(count):
        o = near[k]
        dx = max(box[o, 0] - x, x - box[o, 2], 0.0)
        dy = max(box[o, 1] - y, y - box[o, 3], 0.0)
        reach = max(best + radius, 0.0)
        if dx * dx + dy * dy >= reach * reach:
            continue
        low, high = start[layer[o]], start[layer[o] + 1]
        widest = -np.inf
        for e in range(first[o], first[o + 1]):
            nearest = np.inf
            for i in range(low, high):
                nearest = min(nearest, side[e, 0] * work[i, 0] + side[e, 1] * work[i, 1])
            widest = max(widest, nearest - at[e])
            if widest >= best:
                break
        if widest >= best:
            continue
        for i in range(low, high):
            nearest = np.inf
            for e in range(first[o], first[o + 1]):
                nearest = min(nearest, work[i, 2] * corner[e, 0] + work[i, 3] * corner[e, 1])
            widest = max(widest, nearest - work[i, 4])
            if widest >= best:
                break
        best = min(best, widest)
        if best < DEEP:
            break
    return best


@njit(cache=True, nogil=True)
def select(x, y, reach, box, near):
    """List the outlines whose bounds come within `reach` of a point; returns how many."""
    count = 0
    for o in range(len(box)):
        dx = max(box[o, 0] - x, x - box[o, 2], 0.0)
        dy = max(box[o, 1] - y, y - box[o, 3], 0.0)
        if dx * dx + dy * dy < reach * reach:
            near[count] = o
            count += 1
    return count


@njit(cache=True, nogil=True)
def _gaps(poses, body, things, cap):
    near = np.empty(len(things[4]), np.int64)
    work = np.empty((len(body[0]), 5))
    out = np.empty(len(poses))
    for n in range(len(poses)):
        x, y = poses[n, 0], poses[n, 1]
        count = select(x, y, body[4] + cap, things[5], near)
        out[n] = gap(x, y, poses[n, 2], body, things, near, count, cap, work)
    return out


def gaps(
    poses: Float[np.ndarray, "n 3"], body: Body, things: Outlines, *, cap: float = 1.0
) -> Float[np.ndarray, " n"]:
    """Gap between the robot and the room at base poses [m], at most `cap`; negative: overlap."""
    return _gaps(np.ascontiguousarray(poses, float), body.arrays, things.arrays, cap)


@njit(cache=True, nogil=True)
def wrapped(angle):
    """An angle in (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2 * np.pi)


@njit(cache=True, nogil=True)
def leg(a, b, turn, body, things, taste, near, work):
    """Cost of a straight leg between poses with an even turn [m], infinite where it touches.

    Args:
        a, b: Poses; the heading of `b` is not looked at.
        turn: How far the leg turns [rad].
        body, things: What moves, and in what.
        taste: Gap that is needed [m], gap that is liked [m], cost of coming nearer [-], cost of
            turning [m/rad], cost of reversing [-].
        near, work: Scratch.
    """
    need, liked, weight, turning, _ = taste
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = np.hypot(dx, dy)
    moved = length + body[4] * abs(turn)
    cap = max(liked, 0.2)
    count = select(a[0] + dx / 2, a[1] + dy / 2, length / 2 + body[4] + cap, things[5], near)
    rate = (length + turning * abs(turn)) / max(moved, 1e-12)
    cost, done = 0.0, 0.0
    while True:
        t = done / moved if moved > 0 else 0.0
        g = gap(a[0] + t * dx, a[1] + t * dy, a[2] + t * turn, body, things, near, count, cap, work)
        if g < need:
            return np.inf
        if done >= moved:
            return cost
        step = min(g - need / 2, moved - done)
        cost += step * rate * (1 + weight * max(0.0, 1 - g / liked) ** 2)
        done += step


@njit(cache=True, nogil=True)
def connect(a, b, omni, body, things, taste, limit, near, work):
    """Cheapest simple way between two poses: turn, straight, turn; omni bases turn on the way.

    Args:
        a, b: Poses.
        omni: Whether the base can move sideways.
        body, things, taste: See `leg`.
        limit: Costs above this are of no interest [m].
        near, work: Scratch.

    Returns:
        The cost [m], infinite where there is none, and whether it is driven backwards.
    """
    if omni:
        turn = wrapped(b[2] - a[2])
        if np.hypot(b[0] - a[0], b[1] - a[1]) + taste[3] * abs(turn) > limit:
            return np.inf, False
        return leg(a, b, turn, body, things, taste, near, work), False
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = np.hypot(dx, dy)
    if length < 1e-6:
        return leg(a, b, wrapped(b[2] - a[2]), body, things, taste, near, work), False
    best, backwards = np.inf, False
    p, q = np.array([a[0], a[1], 0.0]), np.array([b[0], b[1], 0.0])
    for reverse in (False, True):
        heading = np.arctan2(-dy, -dx) if reverse else np.arctan2(dy, dx)
        before, after = wrapped(heading - a[2]), wrapped(b[2] - heading)
        factor = taste[4] if reverse else 1.0
        if factor * length + taste[3] * (abs(before) + abs(after)) > min(best, limit):
            continue
        p[2] = q[2] = heading
        cost = factor * leg(p, q, 0.0, body, things, taste, near, work)
        if cost < best:
            cost += leg(a, a, before, body, things, taste, near, work)
        if cost < best:
            cost += leg(q, q, after, body, things, taste, near, work)
        if cost < best:
            best, backwards = cost, reverse
    return best, backwards
