"""Build a reachability map: exact IK at grid points, and where the answer changes between them.

For one line of the last axis (see `grid`) the first joint is set free and the arm solved once:
turning the first joint turns the line about the vertical axis, so that every solution serves a
whole arc of bearings. What is left per bearing is the first joint's limits and contact with the
parts that do not turn (base, torso). A line's answer is a bit mask over `BEARINGS` bearings.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from momapos.kinematics.chain import forward
from momapos.kinematics.collision import FREE, box_gap, hit_floor, hit_self
from momapos.kinematics.ik import ik_scratch, solve_sample
from momapos.reachability.grid import oct_decode

BEARINGS = 64
"""Bearings of a mask."""
EVERY = np.uint64(0xFFFFFFFFFFFFFFFF)


@njit(cache=True, nogil=True)
def line_pose(r, z, u, v, roll, tool, R, p):
    """Tool pose whose last axis is the given line at bearing 0, relative to the first axis.

    Args:
        r, z, u, v: Coordinates of the line, see `grid`.
        roll: Turn of the tool about the line [rad].
        tool: (4, 3): axis, two vectors that complete it to a right-handed frame, and the line's
            point, all in the tool frame.
        R, p: Tool pose to be filled; p is relative to the foot of the first axis.
    """
    x, y, w = oct_decode(u, v)
    # A vector across the line: horizontal where the line is not vertical.
    n = math.hypot(x, y)
    if n > 1e-6:
        ex, ey, ez = -y / n, x / n, 0.0
    else:
        ex, ey, ez = 0.0, 1.0, 0.0
    fx, fy, fz = y * ez - w * ey, w * ex - x * ez, x * ey - y * ex
    c, s = math.cos(roll), math.sin(roll)
    ax, ay, az = c * ex + s * fx, c * ey + s * fy, c * ez + s * fz
    bx, by, bz = c * fx - s * ex, c * fy - s * ey, c * fz - s * ez
    for k in range(3):
        R[0, k] = x * tool[0, k] + ax * tool[1, k] + bx * tool[2, k]
        R[1, k] = y * tool[0, k] + ay * tool[1, k] + by * tool[2, k]
        R[2, k] = w * tool[0, k] + az * tool[1, k] + bz * tool[2, k]
    for i in range(3):
        p[i] = -(R[i, 0] * tool[3, 0] + R[i, 1] * tool[3, 1] + R[i, 2] * tool[3, 2])
    p[0] += r
    p[2] += z


@njit(cache=True, nogil=True)
def arc_mask(q, turn, lower, upper):
    """Mask of the bearings that the first joint can serve, from its value at bearing 0."""
    if upper - lower >= 2.0 * math.pi - 1e-6:
        return EVERY
    mask = np.uint64(0)
    for b in range(BEARINGS):
        v = q + turn * (2.0 * math.pi / BEARINGS) * b
        v -= 2.0 * math.pi * math.floor((v - lower + 1e-9) / (2.0 * math.pi))
        if v <= upper + 1e-9:
            mask |= np.uint64(1) << np.uint64(b)
    return mask


@njit(cache=True, nogil=True)
def _near_base(R, p, spheres, first, axis, rings):
    """Whether the arm can touch a part that does not turn with the first joint, at any bearing."""
    (
        center, radius, start, segment, bound_center, bound_radius, gripper, pairs,
        base_center, base_rotation, base_half, base_pairs,
    ) = spheres
    if len(pairs) > 0:
        for k in range(len(pairs)):
            i, j = pairs[k, 0], pairs[k, 1]
            ri, zi = _polar(R, p, segment[i], bound_center[i], axis)
            rj, zj = _polar(R, p, segment[j], bound_center[j], axis)
            far = bound_radius[i] + bound_radius[j]
            if (ri - rj) ** 2 + (zi - zj) ** 2 < far * far:
                return True
    for g in range(len(segment)):
        if segment[g] <= first:
            continue
        r, z = _polar(R, p, segment[g], bound_center[g], axis)
        for b in range(len(base_center)):
            if base_pairs[g, b]:
                dr = max(0.0, rings[b, 0] - r, r - rings[b, 1])
                dz = max(0.0, rings[b, 2] - z, z - rings[b, 3])
                if dr * dr + dz * dz < bound_radius[g] ** 2:
                    return True
    return False


@njit(cache=True, nogil=True)
def _polar(R, p, s, local, axis):
    """Distance from the first axis and height of a point of segment s."""
    x = p[s, 0] + R[s, 0, 0] * local[0] + R[s, 0, 1] * local[1] + R[s, 0, 2] * local[2] - axis[0]
    y = p[s, 1] + R[s, 1, 0] * local[0] + R[s, 1, 1] * local[1] + R[s, 1, 2] * local[2] - axis[1]
    z = p[s, 2] + R[s, 2, 0] * local[0] + R[s, 2, 1] * local[1] + R[s, 2, 2] * local[2]
    return math.sqrt(x * x + y * y), z


@njit(cache=True, nogil=True)
def _base_clear(b, R, p, heights, first, axis, fixed):
    """Whether the arm clears the parts that do not turn, when the line is at bearing b.

    The base is turned backwards about the first axis, which is the same and cheaper.
    """
    angle = -(2.0 * math.pi / BEARINGS) * b
    c, s = math.cos(angle), math.sin(angle)
    for i in range(first + 1):
        R[i, 0, 0], R[i, 0, 1], R[i, 0, 2] = c, -s, 0.0
        R[i, 1, 0], R[i, 1, 1], R[i, 1, 2] = s, c, 0.0
        R[i, 2, 0], R[i, 2, 1], R[i, 2, 2] = 0.0, 0.0, 1.0
        x, y = heights[i, 0] - axis[0], heights[i, 1] - axis[1]
        p[i, 0], p[i, 1], p[i, 2] = axis[0] + c * x - s * y, axis[1] + s * x + c * y, heights[i, 2]
    return hit_self(R, p, fixed) == FREE


@njit(cache=True, nogil=True)
def _clear_bearings(wanted, R, p, heights, first, axis, fixed):
    """The wanted bearings at which the arm clears the parts that do not turn.

    Every second bearing is checked, and those between where their neighbours disagree.
    """
    heights[: first + 1] = p[: first + 1]
    one = np.uint64(1)
    mask = np.uint64(0)
    for b in range(0, BEARINGS, 2):
        near = (wanted >> np.uint64(b)) & one
        near |= (wanted >> np.uint64((b + 1) % BEARINGS)) & one
        near |= (wanted >> np.uint64((b + BEARINGS - 1) % BEARINGS)) & one
        if near and _base_clear(b, R, p, heights, first, axis, fixed):
            mask |= one << np.uint64(b)
    for b in range(1, BEARINGS, 2):
        if not (wanted >> np.uint64(b)) & one:
            continue
        left = (mask >> np.uint64(b - 1)) & one
        right = (mask >> np.uint64((b + 1) % BEARINGS)) & one
        if left == right:
            mask |= left << np.uint64(b)
        elif _base_clear(b, R, p, heights, first, axis, fixed):
            mask |= one << np.uint64(b)
    return mask & wanted


@njit(cache=True, nogil=True)
def _line_mask(R_tool, p_tool, mask, arm, chain, limits, ik, arcs, work):
    """Add the bearings at which a tool pose is reachable to a mask."""
    first, turn, lower, upper, axis, turning, fixed, rings = arm
    out, scratch, R, p, heights = work
    samples = ik[2]
    for s in range(len(samples)):
        if arcs[s] & ~mask == np.uint64(0):
            continue
        count = solve_sample(s, R_tool, p_tool, chain, limits, ik, out, scratch)
        for k in range(count):
            gain = arc_mask(out[k, first], turn, lower, upper) & ~mask
            if gain == np.uint64(0):
                continue
            R[0], p[0] = np.eye(3), 0.0
            forward(out[k], chain[0], chain[1], chain[2], R, p)
            if hit_floor(R, p, turning) != FREE or hit_self(R, p, turning) != FREE:
                continue
            if _near_base(R, p, fixed, first, axis, rings):
                gain = _clear_bearings(gain, R, p, heights, first, axis, fixed)
            mask |= gain
            if mask == EVERY:
                return mask
    return mask


@njit(cache=True, nogil=True)
def line_masks(lines, rolls, tool, arm, chain, limits, ik, arcs, masks):
    """Bearings at which lines (m, 4: z, r, u, v) can be reached, into masks (m,).

    A line counts where every roll of the tool can be reached.
    """
    n = ik[2].shape[1]
    axis = arm[4]
    work = (
        np.empty((8, n)), ik_scratch(n), np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)),
        np.empty((n + 1, 3)),
    )
    R, p = np.empty((3, 3)), np.empty(3)
    for i in range(len(lines)):
        mask = EVERY
        for k in range(len(rolls)):
            z, r = lines[i, 0], lines[i, 1]
            line_pose(r, z, lines[i, 2], lines[i, 3], rolls[k], tool, R, p)
            p[0] += axis[0]
            p[1] += axis[1]
            mask &= _line_mask(R, p, ~mask, arm, chain, limits, ik, arcs, work)
            if mask == np.uint64(0):
                break
        masks[i] = mask
