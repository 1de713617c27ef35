"""Gaps between the outlines of robot and scene, and collision checks of motions.

The gap of two convex outlines is their largest separation along the normals of their edges. It is
positive exactly if they do not overlap, and at most their distance. So a motion that moves no point
of the robot by more than the gap is free of collision. Long motions are checked in steps as large
as the gap (conservative advancement), so no corner can slip through a fixed resolution.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core.compiled import F2, entry, kernel

from .convex_polygons import ConvexPolygons, PolygonArrays, PrismArrays, RobotPrisms

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

DEEP_GAP = -0.1
"""The search for the smallest gap stops below this [m]."""


class OutlineArrays(NamedTuple):
    """The robot and the obstacles for the kernels."""

    prisms: PrismArrays
    obstacles: PolygonArrays


class Scratch(NamedTuple):
    """Memory of the kernels."""

    near: Int[np.ndarray, " o"]
    """Indices of the obstacles that `select` lists."""
    edges: Float[np.ndarray, "b 5"]
    """Edges of the prisms at the present pose: corner x, y, normal x, y, level."""
    placed: Bool[np.ndarray, " k"]
    """Prisms whose `edges` are up to date."""


class CostWeights(NamedTuple):
    """Weights of the cost of a path."""

    needed_clearance: float
    """Smallest gap [m]."""
    preferred_clearance: float
    """Gap above which proximity costs nothing [m]."""
    proximity: float
    """Additional cost of a meter in contact with obstacles [-]."""
    turning: float
    """Cost of turning [m/rad]."""
    reversing: float
    """Cost of a meter driven backwards [-]."""
    cusp: float
    """Cost of a reversal of a car-like base [m]."""


@kernel
def scratch_for(surroundings):
    """Allocate memory for the kernels."""
    near = np.empty(len(surroundings.obstacles.layer), np.int64)
    edges = np.empty((len(surroundings.prisms.corner), 5))
    return Scratch(near, edges, np.empty(len(surroundings.prisms.first) - 1, np.bool_))


@kernel
def gap(x, y, yaw, surroundings, count, cap, scratch):
    """Return the smallest gap to the first `count` obstacles in the scratch [m], at most `cap`."""
    prisms, obstacles = surroundings.prisms, surroundings.obstacles
    corner, first, box = obstacles.corner, obstacles.first, obstacles.bounds
    side, edges = obstacles.normal, scratch.edges
    c, s = np.cos(yaw), np.sin(yaw)
    closest = 0
    scratch.placed[:] = False
    best = cap
    for k in range(count):
        o = scratch.near[k]
        dx = max(box[o, 0] - x, x - box[o, 2], 0.0)
        dy = max(box[o, 1] - y, y - box[o, 3], 0.0)
        reach = max(best + prisms.radius, 0.0)
        if dx * dx + dy * dy >= reach * reach:
            continue
        layer = obstacles.layer[o]
        low, high = prisms.first[layer], prisms.first[layer + 1]
        if not scratch.placed[layer]:
            scratch.placed[layer] = True
            for i in range(low, high):
                px, py = prisms.corner[i, 0], prisms.corner[i, 1]
                nx, ny = prisms.normal[i, 0], prisms.normal[i, 1]
                edges[i, 0] = x + c * px - s * py
                edges[i, 1] = y + s * px + c * py
                edges[i, 2] = c * nx - s * ny
                edges[i, 3] = s * nx + c * ny
                edges[i, 4] = prisms.level[i] + edges[i, 2] * x + edges[i, 3] * y
        widest = -np.inf
        for e in range(first[o], first[o + 1]):
            nearest = np.inf
            for i in range(low, high):
                nearest = min(nearest, side[e, 0] * edges[i, 0] + side[e, 1] * edges[i, 1])
            widest = max(widest, nearest - obstacles.level[e])
            if widest >= best:
                break
        if widest >= best:
            continue
        for i in range(low, high):
            nearest = np.inf
            for e in range(first[o], first[o + 1]):
                nearest = min(nearest, edges[i, 2] * corner[e, 0] + edges[i, 3] * corner[e, 1])
            widest = max(widest, nearest - edges[i, 4])
            if widest >= best:
                break
        if widest < best:
            best, closest = widest, k
        if best < DEEP_GAP:
            break
    # Move the closest obstacle to the front: it is probably the closest at the next pose, too.
    if count:
        scratch.near[0], scratch.near[closest] = scratch.near[closest], scratch.near[0]
    return best


@kernel
def select(x, y, reach, box, near):
    """List the outlines whose bounds are within `reach` of a point; return their number."""
    count = 0
    for o in range(len(box)):
        dx = max(box[o, 0] - x, x - box[o, 2], 0.0)
        dy = max(box[o, 1] - y, y - box[o, 3], 0.0)
        if dx * dx + dy * dy < reach * reach:
            near[count] = o
            count += 1
    return count


@entry
def _gaps(poses: F2, surroundings: OutlineArrays, cap: float) -> np.ndarray:
    scratch = scratch_for(surroundings)
    reach, bounds = surroundings.prisms.radius + cap, surroundings.obstacles.bounds
    out = np.empty(len(poses))
    for n in range(len(poses)):
        x, y = poses[n, 0], poses[n, 1]
        count = select(x, y, reach, bounds, scratch.near)
        out[n] = gap(x, y, poses[n, 2], surroundings, count, cap, scratch)
    return out


def gaps(
    poses: Float[np.ndarray, "n 3"],
    prisms: RobotPrisms,
    obstacles: ConvexPolygons,
    *,
    cap: float = 1.0,
) -> Float[np.ndarray, " n"]:
    """Compute the gaps at base poses [m], at most `cap`, negative on overlap."""
    surroundings = OutlineArrays(prisms.arrays, obstacles.arrays)
    return _gaps(np.ascontiguousarray(poses, float), surroundings, cap)


@kernel
def wrapped(angle):
    """Wrap an angle to (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2 * np.pi)


@kernel
def leg(a, b, turn, surroundings, weights, scratch):
    """Return the cost of a straight leg from a to b with an even turn [m], infinite on collision.

    The heading of b is ignored.
    """
    need, preferred = weights.needed_clearance, weights.preferred_clearance
    radius, bounds = surroundings.prisms.radius, surroundings.obstacles.bounds
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = np.hypot(dx, dy)
    moved = length + radius * abs(turn)
    cap = max(preferred, 0.2)
    reach = length / 2 + radius + cap
    count = select(a[0] + dx / 2, a[1] + dy / 2, reach, bounds, scratch.near)
    rate = (length + weights.turning * abs(turn)) / max(moved, 1e-12)
    cost, done = 0.0, 0.0
    while True:
        t = done / moved if moved > 0 else 0.0
        x, y, yaw = a[0] + t * dx, a[1] + t * dy, a[2] + t * turn
        g = gap(x, y, yaw, surroundings, count, cap, scratch)
        if g < need:
            return np.inf
        if done >= moved:
            return cost
        step = min(g - need / 2, moved - done)
        cost += step * rate * nearness(g, preferred, weights)
        done += step


@kernel
def nearness(gap_there, preferred, weights):
    """Return the factor of the cost of a motion at a distance from obstacles [-]."""
    return 1 + weights.proximity * max(0.0, 1 - gap_there / preferred) ** 2


@kernel
def connect(a, b, omni, surroundings, weights, limit, scratch):
    """Find the cheapest simple path between two poses: turn, straight, turn; an omni base turns
    while driving. Paths that cost more than the limit are ignored.

    Returns:
        The cost [m], infinite without a path, and whether it is driven backwards.
    """
    if omni:
        turn = wrapped(b[2] - a[2])
        if np.hypot(b[0] - a[0], b[1] - a[1]) + weights.turning * abs(turn) > limit:
            return np.inf, False
        return leg(a, b, turn, surroundings, weights, scratch), False
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = np.hypot(dx, dy)
    if length < 1e-6:
        return leg(a, b, wrapped(b[2] - a[2]), surroundings, weights, scratch), False
    best, backwards = np.inf, False
    p, q = np.array([a[0], a[1], 0.0]), np.array([b[0], b[1], 0.0])
    for reverse in (False, True):
        heading = np.arctan2(-dy, -dx) if reverse else np.arctan2(dy, dx)
        before, after = wrapped(heading - a[2]), wrapped(b[2] - heading)
        factor = weights.reversing if reverse else 1.0
        turning = weights.turning * (abs(before) + abs(after))
        if factor * length + turning > min(best, limit):
            continue
        p[2] = q[2] = heading
        cost = factor * leg(p, q, 0.0, surroundings, weights, scratch)
        if cost < best:
            cost += leg(a, a, before, surroundings, weights, scratch)
        if cost < best:
            cost += leg(q, q, after, surroundings, weights, scratch)
        if cost < best:
            best, backwards = cost, reverse
    return best, backwards
