"""Collision kernels of an arm: robot spheres against oriented boxes, and against each other.

Bounding spheres cull whole links first. If the spheres of two links almost touch, or are too coarse
for this pair, the links' hulls decide. A check returns a code: FREE, SELF, FLOOR or a box index.
"""

from __future__ import annotations

import numpy as np

from momapos.core.compiled import F1, F2, F3, entry, kernel
from momapos.model.kinematics import ArmScratch, ChainArrays, ObstacleArrays, SphereArrays, forward

from .hull_overlap import hulls_overlap, moved
from .sphere_cover import MARGIN

FREE = -1
SELF = -2
FLOOR = -3
APART, NEAR, MEET = 0, 1, 2
"""Relations of two sets of spheres; NEAR is within `MARGIN`, which spheres may leave uncovered."""
OTHER, PALM, FINGER, KNOWN = 0, 1, 2, 3
"""Role of a link in a grasp; the caller guarantees that KNOWN links hit no box."""


@kernel
def box_gap(c, r, center, rotation, half, b):
    """Return the squared distance of a sphere's center from box b minus r squared; > 0 if free."""
    x, y, z = c[0] - center[b, 0], c[1] - center[b, 1], c[2] - center[b, 2]
    s = 0.0
    for k in range(3):
        local = x * rotation[b, 0, k] + y * rotation[b, 1, k] + z * rotation[b, 2, k]
        excess = abs(local) - half[b, k]
        if excess > 0.0:
            s += excess * excess
    return s - r * r


@kernel
def cylinder_gap(c, r, center, rotation, half, b):
    """Return the same as `box_gap` for the cylinder in box b, about the box's third axis."""
    x, y, z = c[0] - center[b, 0], c[1] - center[b, 1], c[2] - center[b, 2]
    along = x * rotation[b, 0, 2] + y * rotation[b, 1, 2] + z * rotation[b, 2, 2]
    across = np.sqrt(max(x * x + y * y + z * z - along * along, 0.0))
    side, end = max(across - half[b, 0], 0.0), max(abs(along) - half[b, 2], 0.0)
    return side * side + end * end - r * r


@kernel
def place_bounds(R, p, spheres, bounds):
    """Write the centers of the links' bounding spheres to bounds (groups, 3)."""
    segment, bound_center = spheres.segment, spheres.bound_center
    for g in range(len(segment)):
        bounds[g, 0], bounds[g, 1], bounds[g, 2] = moved(R, p, segment[g], bound_center[g])


@kernel
def hit_boxes(R, p, bounds, spheres, boxes, skip_gripper, margin):
    """Return the first box that a configuration hits, or FREE.

    Args:
        R, p: Segment poses (n + 1, 3, 3), (n + 1, 3) from `forward`.
        bounds: From `place_bounds` (groups, 3).
        spheres: `Spheres.arrays`.
        boxes: `ObstacleArrays`.
        skip_gripper: Whether the gripper holds something. Then its fingers may touch all these
            boxes (they close around the handle), its palm only those marked as grasped.
        margin: Required clearance [m].
    """
    center, radius, start = spheres.center, spheres.radius, spheres.start
    segment, bound_radius, gripper = spheres.segment, spheres.bound_radius, spheres.gripper
    box_center, box_rotation, box_half, grasped = boxes
    for g in range(len(segment)):
        if gripper[g] == KNOWN:
            continue
        c = (bounds[g, 0], bounds[g, 1], bounds[g, 2])
        far = bound_radius[g] + margin
        for b in range(len(box_center)):
            if skip_gripper and (gripper[g] == FINGER or (gripper[g] == PALM and grasped[b])):
                continue
            if box_gap(c, far, box_center, box_rotation, box_half, b) > 0.0:
                continue
            for s in range(start[g], start[g + 1]):
                m = moved(R, p, segment[g], center[s])
                if box_gap(m, radius[s] + margin, box_center, box_rotation, box_half, b) < 0.0:
                    return b
    return FREE


@kernel
def hit_self(R, p, bounds, spheres):
    """Return SELF if the arm touches itself or the base, otherwise FREE.

    R, p and bounds are relative to any base pose, which is entry 0 of R, p.
    """
    if _links_touch(R, p, bounds, spheres) or _base_touched(R, p, bounds, spheres):
        return SELF
    return FREE


@kernel
def _links_touch(R, p, bounds, spheres):
    pairs, exact, hulls = spheres.pairs, spheres.exact, spheres.hulls
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        found = meeting(R, p, bounds, spheres, i, j)
        if found == MEET and not exact[k]:
            return True
        if found != APART and hulls_overlap(
            R, p, hulls, i, hulls.of_group[j], hulls.of_group[j + 1]
        ):
            return True
    return False


@kernel
def meeting(R, p, bounds, spheres, i, j):
    """Return whether spheres of two groups MEET, are NEAR each other, or APART."""
    center, radius, start = spheres.center, spheres.radius, spheres.start
    segment, bound_radius = spheres.segment, spheres.bound_radius
    b = (bounds[j, 0], bounds[j, 1], bounds[j, 2])
    far, found = bound_radius[j] + MARGIN, APART
    if _apart((bounds[i, 0], bounds[i, 1], bounds[i, 2]), b, bound_radius[i] + far):
        return found
    for s in range(start[i], start[i + 1]):
        a = moved(R, p, segment[i], center[s])
        if _apart(a, b, radius[s] + far):
            continue
        for t in range(start[j], start[j + 1]):
            c = moved(R, p, segment[j], center[t])
            if _apart(a, c, radius[s] + radius[t] + MARGIN):
                continue
            if not _apart(a, c, radius[s] + radius[t]):
                return MEET
            found = NEAR
    return found


@kernel
def _apart(a, b, distance):
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return x * x + y * y + z * z >= distance * distance


@kernel
def _base_touched(R, p, bounds, spheres):
    bound_radius = spheres.bound_radius
    base_pairs, base_bounds, exact = spheres.base_pairs, spheres.base_bounds, spheres.base_exact
    for g in spheres.against_base:
        c = _into_base(R, p, (bounds[g, 0], bounds[g, 1], bounds[g, 2]))
        r, far = bound_radius[g] + MARGIN, False
        for k in range(3):
            far |= c[k] + r < base_bounds[0, k] or c[k] - r > base_bounds[1, k]
        if far:
            continue
        for b in range(base_pairs.shape[1]):
            if not base_pairs[g, b]:
                continue
            found = meeting_base(R, p, bounds, spheres, g, b)
            if found == MEET and not exact[g, b]:
                return True
            h = spheres.hulls.of_base[b]
            if found != APART and hulls_overlap(R, p, spheres.hulls, g, h, h + 1):
                return True
    return False


@kernel
def meeting_base(R, p, bounds, spheres, g, b):
    """Return whether spheres of a group MEET box b of the base, are NEAR it, or APART."""
    center, radius, start = spheres.center, spheres.radius, spheres.start
    base_center, base_rotation, base_half = (
        spheres.base_center,
        spheres.base_rotation,
        spheres.base_half,
    )
    c = _into_base(R, p, (bounds[g, 0], bounds[g, 1], bounds[g, 2]))
    r, found = spheres.bound_radius[g] + MARGIN, APART
    if _apart(c, base_center[b], r + spheres.base_radius[b]):
        return found
    if box_gap(c, r, base_center, base_rotation, base_half, b) > 0.0:
        return found
    for s in range(start[g], start[g + 1]):
        m = _into_base(R, p, moved(R, p, spheres.segment[g], center[s]))
        if box_gap(m, radius[s] + MARGIN, base_center, base_rotation, base_half, b) < 0.0:
            if box_gap(m, radius[s], base_center, base_rotation, base_half, b) < 0.0:
                return MEET
            found = NEAR
    return found


@kernel
def _into_base(R, p, c):
    """Map a point to the frame of segment 0."""
    x, y, z = c[0] - p[0, 0], c[1] - p[0, 1], c[2] - p[0, 2]
    return (
        R[0, 0, 0] * x + R[0, 1, 0] * y + R[0, 2, 0] * z,
        R[0, 0, 1] * x + R[0, 1, 1] * y + R[0, 2, 1] * z,
        R[0, 0, 2] * x + R[0, 1, 2] * y + R[0, 2, 2] * z,
    )


@kernel
def hit_floor(R, p, bounds, spheres):
    """Return FLOOR if a sphere of the arm extends below z = 0, otherwise FREE."""
    center, radius, start = spheres.center, spheres.radius, spheres.start
    segment, bound_radius = spheres.segment, spheres.bound_radius
    for g in range(len(segment)):
        if bounds[g, 2] > bound_radius[g] or spheres.gripper[g] == KNOWN:
            continue
        for s in range(start[g], start[g + 1]):
            if moved(R, p, segment[g], center[s])[2] < radius[s]:
                return FLOOR
    return FREE


@entry
def place_segments(q: F1, base: F1, chain: ChainArrays, R: F3, p: F2) -> None:
    """Write the segment poses of a configuration for a base at (x, y, yaw)."""
    c, s = np.cos(base[2]), np.sin(base[2])
    R[0, 0, 0], R[0, 0, 1], R[0, 0, 2] = c, -s, 0.0
    R[0, 1, 0], R[0, 1, 1], R[0, 1, 2] = s, c, 0.0
    R[0, 2, 0], R[0, 2, 1], R[0, 2, 2] = 0.0, 0.0, 1.0
    p[0, 0], p[0, 1], p[0, 2] = base[0], base[1], 0.0
    forward(q, chain, R, p)


@kernel
def scratch_of(joints, spheres):
    """Allocate the scratch memory of the checks."""
    return ArmScratch(
        np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3)), np.empty((len(spheres.segment), 3))
    )


@kernel
def place_arm(q, base, chain, spheres, scratch):
    """Write a configuration for a base at (x, y, yaw) to `scratch_of(...)`."""
    R, p, bounds = scratch
    place_segments(q, base, chain, R, p)
    place_bounds(R, p, spheres, bounds)


@entry
def check_states(
    q: F2,
    base: F1,
    chain: ChainArrays,
    spheres: SphereArrays,
    boxes: ObstacleArrays,
    skip_gripper: bool,
    margin: float,
) -> np.ndarray:
    """Return the code of the first collision of each configuration (m, n), or FREE."""
    scratch = scratch_of(len(chain.slides), spheres)
    R, p, bounds = scratch
    out = np.empty(len(q), np.int64)
    for i in range(len(q)):
        place_arm(q[i], base, chain, spheres, scratch)
        out[i] = hit_floor(R, p, bounds, spheres)
        if out[i] == FREE:
            out[i] = hit_boxes(R, p, bounds, spheres, boxes, skip_gripper, margin)
        if out[i] == FREE:
            out[i] = hit_self(R, p, bounds, spheres)
    return out
