"""Collision kernels of an arm: spheres against boxes and each other, one or eight states at once.

Bounding spheres cull whole links first. If the spheres of two links almost touch, or are too coarse
for this pair, the links' hulls decide. A check returns a code: FREE, SELF, FLOOR or a box index.

The kernels of eight states check a motion several times as fast, in single precision. Their spheres
grow by `ROUNDING`, so that no collision is missed. Where only hulls decide, the caller uses the
kernels of single states.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from momapos.core.compiled import (
    F1,
    F2,
    F3,
    I1,
    LANES,
    S2,
    entry,
    highest,
    kernel,
    larger,
    less,
    load_lanes,
    magnitude,
    root,
    spread,
    store_lanes,
)
from momapos.model.kinematics import ArmScratch, ChainArrays, ObstacleArrays, SphereArrays, forward

from .link_hulls import hulls_overlap, moved
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


@kernel
def within(a, b, distance):
    """Return in which lanes two points are nearer than a distance."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return less(x * x + y * y + z * z, spread(distance * distance))


@kernel
def near_box(c, r, center, rotation, half, b):
    """Return in which lanes a sphere overlaps box b, see `box_gap`."""
    x = c[0] - spread(center[b, 0])
    y = c[1] - spread(center[b, 1])
    z = c[2] - spread(center[b, 2])
    zero = spread(0.0)
    square = zero
    for k in range(3):
        local = (
            x * spread(rotation[b, 0, k])
            + y * spread(rotation[b, 1, k])
            + z * spread(rotation[b, 2, k])
        )
        excess = larger(magnitude(local) - spread(half[b, k]), zero)
        square = square + excess * excess
    return less(square, spread(r * r))


@kernel
def _near_cylinder(c, r, center, rotation, half, b):
    """Return in which lanes a sphere overlaps the cylinder in box b, see `cylinder_gap`."""
    x = c[0] - spread(center[b, 0])
    y = c[1] - spread(center[b, 1])
    z = c[2] - spread(center[b, 2])
    zero = spread(0.0)
    along = (
        x * spread(rotation[b, 0, 2])
        + y * spread(rotation[b, 1, 2])
        + z * spread(rotation[b, 2, 2])
    )
    across = root(larger(x * x + y * y + z * z - along * along, zero))
    side = larger(across - spread(half[b, 0]), zero)
    end = larger(magnitude(along) - spread(half[b, 2]), zero)
    return less(side * side + end * end, spread(r * r))


@kernel
def near_shape(c, r, shapes, b, cylinder):
    """Return in which lanes a sphere overlaps box b, or the cylinder in it."""
    center, rotation, half = shapes
    if cylinder:
        return _near_cylinder(c, r, center, rotation, half, b)
    return near_box(c, r, center, rotation, half, b)


ROUNDING = 4e-6
"""Largest error of a position in single precision per meter of distance from the origin: 60
roundings [-]."""
_POSE = 12
"""Rows of a segment's pose: rotation by rows, then position."""
HIT = -1
"""Result of `collisions` if one of the states collides."""


class EightStates(NamedTuple):
    """Eight states of an arm, a lane each."""

    turns: S2
    """Rows 2i and 2i + 1: cosine and sine of joint i; its value and 0 for prismatic joints."""
    poses: S2
    """Rows 12s to 12s + 11: the pose of segment s."""
    bounds: S2
    """Rows 3g to 3g + 2: the center of the bounding sphere of group g."""
    blocks: I1
    """Scratch: blocks of static boxes near the arm."""


@kernel
def eight_states(joints, groups, blocks):
    """Allocate the memory of eight states."""
    return EightStates(
        np.zeros((2 * joints, LANES), np.float32),
        np.zeros((_POSE * (joints + 1), LANES), np.float32),
        np.zeros((3 * groups, LANES), np.float32),
        np.empty(blocks, np.int64),
    )


@kernel
def set_states(first, step, chain, states):
    """Set eight configurations at equal steps: first, first + step ...; both (n,)."""
    for i in range(len(chain.slides)):
        value, more = chain.ratio[i] * first[chain.dof[i]], chain.ratio[i] * step[chain.dof[i]]
        if chain.slides[i]:
            for lane in range(LANES):
                states.turns[2 * i, lane] = value + lane * more
            continue
        c, s, a, b = np.cos(value), np.sin(value), np.cos(more), np.sin(more)
        for lane in range(LANES):
            states.turns[2 * i, lane], states.turns[2 * i + 1, lane] = c, s
            c, s = c * a - s * b, s * a + c * b


@kernel
def place_eight(base, chain, spheres, states):
    """Place all segments and bounding spheres for a base at (x, y, yaw)."""
    poses, turns = states.poses, states.turns
    c, s = np.cos(base[2]), np.sin(base[2])
    for k, value in enumerate((c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0, base[0], base[1], 0.0)):
        store_lanes(poses, k, spread(value))
    for i in range(len(chain.slides)):
        _place_segment(i, chain, turns, poses)
    for g in range(len(spheres.segment)):
        center = _moved(poses, spheres.segment[g], spheres.bound_center, g)
        _keep(states.bounds, 3 * g, center)


@kernel
def _place_segment(i, chain, turns, poses):
    """Place the segment after joint i, see `forward` and `rotate_by`."""
    before, after = _POSE * i, _POSE * (i + 1)
    x, y, z = spread(chain.h[i, 0]), spread(chain.h[i, 1]), spread(chain.h[i, 2])
    a, b = load_lanes(turns, 2 * i), load_lanes(turns, 2 * i + 1)
    origin = _moved(poses, i, chain.d, i)
    if chain.slides[i]:
        for k in range(9):
            store_lanes(poses, after + k, load_lanes(poses, before + k))
        for k in range(3):
            along = _dot(poses, before + 3 * k, x, y, z)
            store_lanes(poses, after + 9 + k, origin[k] + a * along)
        return
    _keep(poses, after + 9, origin)
    v = spread(1.0) - a
    m00, m01, m02 = a + x * x * v, x * y * v - z * b, x * z * v + y * b
    m10, m11, m12 = x * y * v + z * b, a + y * y * v, y * z * v - x * b
    m20, m21, m22 = x * z * v - y * b, y * z * v + x * b, a + z * z * v
    for k in range(3):
        row, out = before + 3 * k, after + 3 * k
        r, s, t = _kept(poses, row)
        store_lanes(poses, out, r * m00 + s * m10 + t * m20)
        store_lanes(poses, out + 1, r * m01 + s * m11 + t * m21)
        store_lanes(poses, out + 2, r * m02 + s * m12 + t * m22)


@kernel
def _moved(poses, segment, points, s):
    """Map point s of a segment to the frame of the base pose."""
    row = _POSE * segment
    x, y, z = spread(points[s, 0]), spread(points[s, 1]), spread(points[s, 2])
    return (
        load_lanes(poses, row + 9) + _dot(poses, row, x, y, z),
        load_lanes(poses, row + 10) + _dot(poses, row + 3, x, y, z),
        load_lanes(poses, row + 11) + _dot(poses, row + 6, x, y, z),
    )


@kernel
def _dot(rows, first, x, y, z):
    """Return the dot product of three rows with a vector."""
    a, b, c = _kept(rows, first)
    return a * x + b * y + c * z


@kernel
def _keep(rows, first, point):
    store_lanes(rows, first, point[0])
    store_lanes(rows, first + 1, point[1])
    store_lanes(rows, first + 2, point[2])


@kernel
def _kept(rows, first):
    return load_lanes(rows, first), load_lanes(rows, first + 1), load_lanes(rows, first + 2)


@kernel
def collisions(base, state, chain, room, fine, states):
    """Find collisions of eight states.

    Args:
        base: Base pose (x, y, yaw).
        state: `TaskState`.
        chain, room: The arm and what it must not hit.
        fine: Whether hulls decide where spheres hit a box.
        states: The states, see `set_states`.

    Returns:
        HIT if one of them collides, or else the lanes in which hulls must decide whether the robot
        touches itself; and those in which they must decide whether it hits a box.
    """
    spheres, world, margin = room
    rounding = ROUNDING * (3.0 + abs(base[0]) + abs(base[1]))
    place_eight(base, chain, spheres, states)
    if _on_floor(spheres, states, rounding):
        return HIT, 0
    near = _moving_hits(state, spheres, world, margin + rounding, fine, states)
    if near != 0 and not fine:
        return HIT, 0
    near |= _static_hits(spheres, world, margin + rounding, fine, states)
    if near != 0 and not fine:
        return HIT, 0
    doubt = _links_near(spheres, states, rounding)
    if doubt == HIT:
        return HIT, 0
    more = _base_near(base, spheres, states, rounding)
    if more == HIT:
        return HIT, 0
    return doubt | more, near


@kernel
def _on_floor(spheres, states, rounding):
    """Return whether a sphere extends below z = 0."""
    for g in range(len(spheres.segment)):
        if spheres.gripper[g] == KNOWN:
            continue
        reach = spread(spheres.bound_radius[g] + rounding)
        if less(load_lanes(states.bounds, 3 * g + 2), reach) == 0:
            continue
        for s in range(spheres.start[g], spheres.start[g + 1]):
            c = _moved(states.poses, spheres.segment[g], spheres.center, s)
            if less(c[2], spread(spheres.radius[s] + rounding)) != 0:
                return True
    return False


@kernel
def _moving_hits(state, spheres, world, margin, fine, states):
    """Return in which lanes a box that the task moves is hit; some of them unless `fine`."""
    center, rotation = world.moving_center[state.value], world.moving_rotation[state.value]
    half, hit = world.moving_half[state.value], 0
    for g in range(len(spheres.segment)):
        role = spheres.gripper[g]
        if role == KNOWN or (state.holding and role == FINGER):
            continue
        bound, far = _kept(states.bounds, 3 * g), spheres.bound_radius[g] + margin
        for b in range(len(center)):
            if state.holding and role == PALM and world.grasped[b]:
                continue
            boxes = center, rotation, half
            hit |= _group_hits(g, bound, far, b, boxes, False, spheres, margin, fine, states)
            if hit != 0 and not fine:
                return hit
    return hit


@kernel
def _static_hits(spheres, world, margin, fine, states):
    """Return in which lanes a static box is hit; some of them unless `fine`."""
    count, hit = _near_blocks(spheres, world, margin, states), 0
    boxes = world.center, world.rotation, world.half
    # The hand, which is hit most, comes last.
    for g in range(len(spheres.segment) - 1, -1, -1):
        if count == 0 or spheres.gripper[g] == KNOWN:
            continue
        bound, far = _kept(states.bounds, 3 * g), spheres.bound_radius[g] + margin
        low, high = _extent(bound, far)
        for at in range(count):
            block = states.blocks[at]
            bits = _overlapping(world.blocks, block, low, high)
            b = block * LANES
            while bits != 0:
                if bits & 1:
                    hit |= _group_hits(
                        g, bound, far, b, boxes, world.cylinder[b], spheres, margin, fine, states
                    )
                    if hit != 0 and not fine:
                        return hit
                bits, b = bits >> 1, b + 1
    return hit


@kernel
def _near_blocks(spheres, world, margin, states):
    """List the blocks of boxes near any link in `states.blocks`; return their number."""
    farthest = spread(-1e30)
    x = y = z = u = v = w = farthest
    for g in range(len(spheres.segment)):
        a, b, c = _kept(states.bounds, 3 * g)
        r = spread(spheres.bound_radius[g] + margin)
        x, y, z = larger(x, a + r), larger(y, b + r), larger(z, c + r)
        u, v, w = larger(u, r - a), larger(v, r - b), larger(w, r - c)
    low, high = (-highest(u), -highest(v), -highest(w)), (highest(x), highest(y), highest(z))
    count = 0
    for block in range(len(world.blocks) // 6):
        if _overlapping(world.blocks, block, low, high) != 0:
            states.blocks[count] = block
            count += 1
    return count


@kernel
def _extent(c, r):
    """Return the lower and upper corner of the bounds of a sphere in all lanes."""
    zero = spread(0.0)
    low = (r + highest(zero - c[0]), r + highest(zero - c[1]), r + highest(zero - c[2]))
    high = (r + highest(c[0]), r + highest(c[1]), r + highest(c[2]))
    return (-low[0], -low[1], -low[2]), high


@kernel
def _overlapping(blocks, block, low, high):
    """Return which boxes of a block overlap bounds, by their own bounds."""
    bits = 2**LANES - 1
    for k in range(3):
        bits &= less(load_lanes(blocks, 6 * block + k), spread(high[k]))
        bits &= less(load_lanes(blocks, 6 * block + 3 + k), spread(-low[k]))
    return bits


@kernel
def _group_hits(g, bound, far, b, boxes, cylinder, spheres, margin, fine, states):
    """Return in which lanes a group of spheres hits box b, or the cylinder in it.

    Unless `fine`, only some of these lanes.
    """
    hit = 0
    if near_shape(bound, far, boxes, b, cylinder) == 0:
        return hit
    for s in range(spheres.start[g], spheres.start[g + 1]):
        c = _moved(states.poses, spheres.segment[g], spheres.center, s)
        hit |= near_shape(c, spheres.radius[s] + margin, boxes, b, cylinder)
        if hit != 0 and not fine:
            return hit
    return hit


@kernel
def _links_near(spheres, states, rounding):
    """Return HIT if spheres of two links meet, or else the lanes in which hulls must decide."""
    doubt = 0
    for k in range(len(spheres.pairs)):
        i, j = spheres.pairs[k, 0], spheres.pairs[k, 1]
        bound, far = _kept(states.bounds, 3 * j), spheres.bound_radius[j] + MARGIN + rounding
        own = _kept(states.bounds, 3 * i)
        if within(own, bound, spheres.bound_radius[i] + far) == 0:
            continue
        for s in range(spheres.start[i], spheres.start[i + 1]):
            a = _moved(states.poses, spheres.segment[i], spheres.center, s)
            if within(a, bound, spheres.radius[s] + far) == 0:
                continue
            for t in range(spheres.start[j], spheres.start[j + 1]):
                c = _moved(states.poses, spheres.segment[j], spheres.center, t)
                reach = spheres.radius[s] + spheres.radius[t] + rounding
                near = within(a, c, reach + MARGIN)
                if near == 0:
                    continue
                if not spheres.exact[k] and within(a, c, reach) != 0:
                    return HIT
                doubt |= near
    return doubt


@kernel
def _base_near(base, spheres, states, rounding):
    """Return HIT if spheres meet the base, or else the lanes in which hulls must decide."""
    doubt = 0
    low, high = spheres.base_bounds[0], spheres.base_bounds[1]
    center, rotation, half = spheres.base_center, spheres.base_rotation, spheres.base_half
    c, s = spread(np.cos(base[2])), spread(np.sin(base[2]))
    x, y = spread(base[0]), spread(base[1])
    for g in spheres.against_base:
        bound = _lanes_into_base(_kept(states.bounds, 3 * g), x, y, c, s)
        far = spheres.bound_radius[g] + MARGIN + rounding
        inside = 2**LANES - 1
        for k in range(3):
            inside &= less(spread(low[k] - far), bound[k]) & less(bound[k], spread(high[k] + far))
        if inside == 0:
            continue
        for b in range(spheres.base_pairs.shape[1]):
            if not spheres.base_pairs[g, b]:
                continue
            if near_box(bound, far, center, rotation, half, b) == 0:
                continue
            for i in range(spheres.start[g], spheres.start[g + 1]):
                m = _moved(states.poses, spheres.segment[g], spheres.center, i)
                m = _lanes_into_base(m, x, y, c, s)
                r = spheres.radius[i] + rounding
                near = near_box(m, r + MARGIN, center, rotation, half, b)
                if near == 0:
                    continue
                met = near_box(m, r, center, rotation, half, b)
                if met != 0 and not spheres.base_exact[g, b]:
                    return HIT
                doubt |= near
    return doubt


@kernel
def _lanes_into_base(point, x, y, c, s):
    """Map a point to the frame of the base."""
    u, v = point[0] - x, point[1] - y
    return c * u + s * v, c * v - s * u, point[2]
