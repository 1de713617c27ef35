"""Decide by hulls where spheres of an arm hit a box: spheres protrude by up to two centimeters.

A link and a box are apart if a plane along a face of the box separates their hulls, or a plane
along the axis of a cylinder. Links next to an edge may be apart without such a plane; for them the
spheres' answer stands.
"""

from __future__ import annotations

import numpy as np

from momapos.core.compiled import kernel
from momapos.model.kinematics import dot, sub

from .arm_collision import FINGER, KNOWN, PALM, box_gap
from .collision_world import bucket_at, static_gap
from .hull_overlap import farthest_vertex, moved

MAX_PLANES = 8
"""Largest number of planes tried along a cylinder; usually 3 are enough [-]."""


@kernel
def hulls_hit(R, p, bounds, state, room):
    """Return whether a link hits a box, at a configuration whose spheres may hit one.

    Args:
        R, p, bounds: From `place_arm`.
        state: `TaskState`.
        room: `CollisionArrays`.
    """
    spheres, world, margin = room
    for g in range(len(spheres.segment)):
        if spheres.gripper[g] != KNOWN and (
            _hits_moving(R, p, bounds, g, state, spheres, world, margin)
            or _hits_static(R, p, g, spheres, world, margin)
        ):
            return True
    return False


@kernel
def _hits_moving(R, p, bounds, g, state, spheres, world, margin):
    role = spheres.gripper[g]
    if state.holding and role == FINGER:
        return False
    center, rotation = world.moving_center[state.value], world.moving_rotation[state.value]
    half = world.moving_half[state.value]
    bound = (bounds[g, 0], bounds[g, 1], bounds[g, 2])
    for b in range(len(center)):
        if state.holding and role == PALM and world.grasped[b]:
            continue
        if box_gap(bound, spheres.bound_radius[g] + margin, center, rotation, half, b) > 0.0:
            continue
        for s in range(spheres.start[g], spheres.start[g + 1]):
            m = moved(R, p, spheres.segment[g], spheres.center[s])
            if box_gap(m, spheres.radius[s] + margin, center, rotation, half, b) < 0.0:
                boxes = center, rotation, half
                if not _apart(R, p, spheres.hulls, g, boxes, b, False, margin):
                    return True
                break
    return False


@kernel
def _hits_static(R, p, g, spheres, world, margin):
    known = -1
    for s in range(spheres.start[g], spheres.start[g + 1]):
        m = moved(R, p, spheres.segment[g], spheres.center[s])
        cell, r = bucket_at(m, world), spheres.radius[s] + margin
        if cell < 0:
            continue
        for at in range(world.grid_start[cell], world.grid_start[cell + 1]):
            b = world.grid_index[at]
            if b == known or static_gap(m, r, world, b) >= 0.0:
                continue
            boxes = world.center, world.rotation, world.half
            if not _apart(R, p, spheres.hulls, g, boxes, b, world.cylinder[b], margin):
                return True
            known = b
    return False


@kernel
def _apart(R, p, hulls, g, boxes, b, cylinder, margin):
    """Return whether planes along the faces of box b separate it from all hulls of a group."""
    center, rotation, half = boxes
    first, last = hulls.of_group[g], hulls.of_group[g + 1]
    if first == last:
        return False
    gap = margin + hulls.margin
    for h in range(first, last):
        segment, separated = hulls.segment[h], False
        c = moved(R, p, segment, hulls.center[h])
        if cylinder and _beside(R, p, hulls, h, c, boxes, b, gap):
            continue
        for k in range(2 if cylinder else 0, 3):
            n = (rotation[b, 0, k], rotation[b, 1, k], rotation[b, 2, k])
            side = _along(c, center, n, b)
            sign = -1.0 if side > 0.0 else 1.0
            if abs(side) <= half[b, k] + gap:
                continue
            v = farthest_vertex(R, segment, hulls, h, n, sign)
            nearest = moved(R, p, segment, hulls.vertices[v])
            if -sign * _along(nearest, center, n, b) >= half[b, k] + gap:
                separated = True
                break
        if not separated:
            return False
    return True


@kernel
def _beside(R, p, hulls, h, c, boxes, b, gap):
    """Return whether a plane along the axis of cylinder b separates it from hull h.

    Gilbert's method in the plane across the axis: x is a point of the hull's projection, which
    moves toward the axis.

    Args:
        c: The center of the hull.
        gap: Required distance [m].
    """
    center, rotation, half = boxes
    n = (rotation[b, 0, 2], rotation[b, 1, 2], rotation[b, 2, 2])
    x, needed = _across(c, center, n, b), half[b, 0] + gap
    for _ in range(MAX_PLANES):
        distance = np.sqrt(dot(x, x))
        if distance <= needed:
            return False
        v = farthest_vertex(R, hulls.segment[h], hulls, h, x, -1.0)
        y = _across(moved(R, p, hulls.segment[h], hulls.vertices[v]), center, n, b)
        if dot(x, y) >= needed * distance:
            return True
        step = sub(y, x)
        share = min(max(-dot(x, step) / max(dot(step, step), 1e-300), 0.0), 1.0)
        x = (x[0] + share * step[0], x[1] + share * step[1], x[2] + share * step[2])
    return False


@kernel
def _across(point, center, n, b):
    """Return the vector from the axis of cylinder b, whose direction is n, to a point."""
    along = _along(point, center, n, b)
    return (
        point[0] - center[b, 0] - along * n[0],
        point[1] - center[b, 1] - along * n[1],
        point[2] - center[b, 2] - along * n[2],
    )


@kernel
def _along(point, center, n, b):
    """Return how far a point is from the center of box b along a direction."""
    return (
        (point[0] - center[b, 0]) * n[0]
        + (point[1] - center[b, 1]) * n[1]
        + (point[2] - center[b, 2]) * n[2]
    )
