"""Find the relations between objects (on, in, inside, near): kernels over stacked bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core.compiled import B1, F2, F3, I1, entry, kernel
from momapos.model.kinematics import BoxArrays
from momapos.model.urdf import Boxes

from .object_bodies import ObjectBodies

if TYPE_CHECKING:
    from jaxtyping import Float, Int

ON, IN, INSIDE, NEAR = range(4)
KINDS = ("on", "in", "inside", "near")
MIN_SUPPORT = 0.05
"""Smallest share of an object's support area that a supporter carries [-]."""
MIN_COVERED = 0.5
"""Smallest share of the support area above the container; for `inside`, also below it [-]."""
MIN_CONTAINED = 0.8
"""Smallest share of an object's box in the container's box; for `in`, of its outline [-]."""
MIN_WALLS_INSIDE, MIN_WALLS_IN = 3, 4
"""Smallest number of the four sides on which the container surrounds the object [-]."""
GAP_STEP = 1e-4
"""Gaps are rounded to this, so that touching cabinets tie regardless of the scene's yaw [m]."""
_CORNERS = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
_POINTS = 4
"""Sample points along each edge of a box that is tested for containment [-]."""


class BodyArrays(NamedTuple):
    """Stacked bodies for the kernels, see `ObjectBodies`."""

    low: F2
    high: F2
    base: F3
    articulated: B1
    hull_start: I1
    hull_low: F2
    hull_high: F2
    planes: F2
    plane_start: I1


@kernel
def _span(point, direction, planes, first, last):
    """Intersect a line with a convex body; return (enters, leaves), with leaves < enters for none.

    Args:
        point, direction: x, y, z of the line.
        planes, first, last: The body has the planes from first to last.
    """
    x, y, z = point
    dx, dy, dz = direction
    enters, leaves = -np.inf, np.inf
    for k in range(first, last):
        rate = planes[k, 0] * dx + planes[k, 1] * dy + planes[k, 2] * dz
        room = planes[k, 3] - (planes[k, 0] * x + planes[k, 1] * y + planes[k, 2] * z)
        if rate > 1e-12:
            leaves = min(leaves, room / rate)
        elif rate < -1e-12:
            enters = max(enters, room / rate)
        elif room < 0.0:
            return 1.0, 0.0
        if enters > leaves:
            return 1.0, 0.0
    return enters, leaves


@kernel
def _columns(i, j, bodies, contact):
    """Return the shares of i's support area where j carries it, is below it, and is above it."""
    low, high, base, articulated = bodies.low, bodies.high, bodies.base, bodies.articulated
    hull_start, hull_low, hull_high = bodies.hull_start, bodies.hull_low, bodies.hull_high
    planes, plane_start = bodies.planes, bodies.plane_start
    bottom, top = low[i, 2], high[i, 2]
    carried, below, roofed = 0, 0, 0
    for s in range(base.shape[1]):
        x, y = base[i, s, 0], base[i, s, 1]
        touches, under, over = False, False, False
        for h in range(hull_start[j], hull_start[j + 1]):
            if x < hull_low[h, 0] or x > hull_high[h, 0]:
                continue
            if y < hull_low[h, 1] or y > hull_high[h, 1]:
                continue
            point, up = (x, y, bottom), (0.0, 0.0, 1.0)
            enters, leaves = _span(point, up, planes, plane_start[h], plane_start[h + 1])
            if leaves < enters:
                continue
            touches |= abs(leaves) <= contact
            under |= enters < -1e-6
            # A body that contains the object stands for a hollow one, closed if it has doors.
            within = articulated[j] and enters < 0.0 and bottom + leaves > top
            over |= enters > contact or within
        carried += touches
        below += under
        roofed += over
    count = base.shape[1]
    return carried / count, below / count, roofed / count


@kernel
def _contained(i, g, upright, groups, low):
    """Return the share of i's box in the box of group g, the same seen from above, and the depth
    of i's underside below the top of that box [m].
    """
    center, rotation, half = upright
    group_center, group_rotation, group_half = groups
    inside, outline = 0, 0
    for a in range(_POINTS**3):
        point = np.empty(3)
        k = a
        for axis in range(3):
            point[axis] = ((k % _POINTS + 0.5) / _POINTS * 2 - 1) * half[i, axis]
            k //= _POINTS
        held = True
        across = True
        for axis in range(3):
            value = 0.0
            for b in range(3):
                world = center[i, b]
                for c in range(3):
                    world += rotation[i, b, c] * point[c]
                value += group_rotation[g, b, axis] * (world - group_center[g, b])
            beyond = abs(value) > group_half[g, axis] + 1e-6
            held &= not beyond
            if abs(group_rotation[g, 2, axis]) < 0.7:
                across &= not beyond
        inside += held
        outline += across
    rim = group_center[g, 2]
    for axis in range(3):
        rim += abs(group_rotation[g, 2, axis]) * group_half[g, axis]
    return inside / _POINTS**3, outline / _POINTS**3, rim - low[i, 2]


@kernel
def _walls(i, j, g, bodies, groups, height):
    """Count the sides, of four along the axes of the group's box, on which j surrounds i."""
    base, hull_start = bodies.base, bodies.hull_start
    planes, plane_start = bodies.planes, bodies.plane_start
    x, y = base[i, :, 0].mean(), base[i, :, 1].mean()
    count = 0
    for axis in range(3):
        dx, dy = groups.rotation[g, 0, axis], groups.rotation[g, 1, axis]
        size = np.hypot(dx, dy)
        if size < 0.7:
            continue
        for side in (-1.0, 1.0):
            hit = False
            for h in range(hull_start[j], hull_start[j + 1]):
                point, ahead = (x, y, height), (side * dx / size, side * dy / size, 0.0)
                enters, leaves = _span(point, ahead, planes, plane_start[h], plane_start[h + 1])
                if enters <= leaves and leaves > 0.0:
                    hit = True
                    break
            count += hit
    return count


@entry
def _hierarchy(
    bodies: BodyArrays, upright: BoxArrays, groups: BoxArrays, group_start: I1, contact: float
) -> np.ndarray:
    """Find the relations on, in and inside: rows of child, parent, kind."""
    low, high, base = bodies.low, bodies.high, bodies.base
    n = len(low)
    found = np.empty((64, 3), np.int64)
    size = 0
    for i in range(n):
        x0, x1 = base[i, :, 0].min(), base[i, :, 0].max()
        y0, y1 = base[i, :, 1].min(), base[i, :, 1].max()
        bottom = low[i, 2]
        for j in range(n):
            # The lower object carries the higher one, so no object is on itself, nor two on
            # each other.
            if low[j, 2] >= bottom - 1e-6 or high[j, 2] < bottom - contact:
                continue
            if low[j, 0] > x1 or high[j, 0] < x0 or low[j, 1] > y1 or high[j, 1] < y0:
                continue
            kind = _kind(i, j, bodies, upright, groups, group_start, contact)
            if kind < 0:
                continue
            if size == len(found):
                found = np.concatenate((found, np.empty_like(found)))
            found[size] = (i, j, kind)
            size += 1
    return found[:size]


@kernel
def _kind(i, j, bodies, upright, groups, group_start, contact):
    low, high = bodies.low, bodies.high
    carried, below, roofed = _columns(i, j, bodies, contact)
    if below >= MIN_COVERED:
        for g in range(group_start[j], group_start[j + 1]):
            inside, outline, sunk = _contained(i, g, upright, groups, low)
            if sunk <= contact or outline < MIN_CONTAINED:
                continue
            if inside >= MIN_CONTAINED and roofed >= MIN_COVERED:
                height = (low[i, 2] + high[i, 2]) / 2
                if _walls(i, j, g, bodies, groups, height) >= MIN_WALLS_INSIDE:
                    return INSIDE
            elif roofed < MIN_COVERED:
                height = low[i, 2] + min(contact, (high[i, 2] - low[i, 2]) / 2)
                if _walls(i, j, g, bodies, groups, height) >= MIN_WALLS_IN:
                    return IN
    return ON if carried >= MIN_SUPPORT else -1


@kernel
def _corner_gap(a, b, center, rotation, half):
    """Return the smallest distance from the corners of outline a to outline b."""
    best = np.inf
    for sx in (-1.0, 1.0):
        for sy in (-1.0, 1.0):
            ux, uy = sx * half[a, 0], sy * half[a, 1]
            x = center[a, 0] + rotation[a, 0, 0] * ux + rotation[a, 0, 1] * uy - center[b, 0]
            y = center[a, 1] + rotation[a, 1, 0] * ux + rotation[a, 1, 1] * uy - center[b, 1]
            u = abs(rotation[b, 0, 0] * x + rotation[b, 1, 0] * y) - half[b, 0]
            v = abs(rotation[b, 0, 1] * x + rotation[b, 1, 1] * y) - half[b, 1]
            best = min(best, np.hypot(max(u, 0.0), max(v, 0.0)))
    return best


@kernel
def _outlines_apart(a, b, center, rotation, half):
    """Check whether an edge direction of outline a separates it from outline b."""
    for axis in range(2):
        ux, uy = rotation[a, 0, axis], rotation[a, 1, axis]
        reach = half[a, axis]
        reach += abs(ux * rotation[b, 0, 0] + uy * rotation[b, 1, 0]) * half[b, 0]
        reach += abs(ux * rotation[b, 0, 1] + uy * rotation[b, 1, 1]) * half[b, 1]
        offset = ux * (center[b, 0] - center[a, 0]) + uy * (center[b, 1] - center[a, 1])
        if abs(offset) > reach:
            return True
    return False


@kernel
def _outline_gap(a, b, center, rotation, half):
    """Return the horizontal distance of two upright boxes [m], 0 if they overlap from above."""
    if not (
        _outlines_apart(a, b, center, rotation, half)
        or _outlines_apart(b, a, center, rotation, half)
    ):
        return 0.0
    return min(_corner_gap(a, b, center, rotation, half), _corner_gap(b, a, center, rotation, half))


@entry
def _nearest(center: F2, rotation: F3, half: F2, count: int, reach: float) -> np.ndarray:
    """Find the nearest boxes of each within reach, by gap: indices, -1 if there are fewer."""
    n = len(center)
    index = np.full((n, count), -1)
    gap = np.full((n, count), np.inf)
    radius = np.hypot(half[:, 0], half[:, 1])
    for i in range(n):
        for j in range(n):
            limit = min(gap[i, count - 1], reach + 1e-12)
            apart = np.hypot(center[i, 0] - center[j, 0], center[i, 1] - center[j, 1])
            rise = max(abs(center[i, 2] - center[j, 2]) - half[i, 2] - half[j, 2], 0.0)
            if i == j or rise >= limit or apart - radius[i] - radius[j] >= limit:
                continue
            d = np.hypot(_outline_gap(i, j, center, rotation, half), rise)
            d = np.floor(d / GAP_STEP + 0.5) * GAP_STEP
            if d >= limit:
                continue
            place = count - 1
            while place > 0 and gap[i, place - 1] > d:
                gap[i, place], index[i, place] = gap[i, place - 1], index[i, place - 1]
                place -= 1
            gap[i, place], index[i, place] = d, j
    return index


def hierarchy(bodies: ObjectBodies, *, contact: float) -> Int[np.ndarray, "e 3"]:
    """Find the relations on, in and inside: rows of child, parent, index into KINDS.

    Args:
        bodies: The objects.
        contact: Largest vertical gap or overlap of two surfaces in contact [m].
    """
    arrays = BodyArrays(
        bodies.low, bodies.high, bodies.base, bodies.articulated, bodies.hull_start,
        bodies.hull_low, bodies.hull_high, bodies.planes, bodies.plane_start,
    )  # fmt: skip
    upright, groups = bodies.upright, bodies.groups
    return _hierarchy(
        arrays,
        BoxArrays(upright.center, upright.rotation, upright.half),
        BoxArrays(groups.center, groups.rotation, groups.half),
        bodies.group_start,
        contact,
    )


def neighbors(box: Boxes, *, count: int, reach: float) -> Int[np.ndarray, "e 2"]:
    """Find pairs (smaller index first) of which one is among the other's nearest.

    Args:
        box: The upright boxes of the objects.
        count: Number of nearest boxes of each object [-].
        reach: Largest gap between two neighbors [m].
    """
    if count == 0 or len(box) < 2:
        return np.zeros((0, 2), np.int64)
    index = _nearest(box.center, box.rotation, box.half, min(count, len(box) - 1), reach)
    own = np.repeat(np.arange(len(index)), index.shape[1])
    pairs = np.sort(np.stack([own, index.ravel()], -1)[index.ravel() >= 0], axis=1)
    return np.unique(pairs, axis=0)


def outline_gaps(box: Boxes, target: int) -> Float[np.ndarray, " n"]:
    """Compute the horizontal distance of every object's upright box to the target's [m]."""
    center, rotation, half = box.center[:, :2], box.rotation[:, :2, :2], box.half[:, :2]
    corners = center[:, None] + np.einsum("nij,nkj->nki", rotation, _CORNERS * half[:, None])
    # Corners of each box in the target's frame, and of the target in the frame of each box.
    inside = (corners - center[target]) @ rotation[target]
    around = np.einsum("nki,nij->nkj", corners[target] - center[:, None], rotation)
    apart = np.zeros(len(center), bool)
    nearest = np.full(len(center), np.inf)
    for local, edge in ((inside, half[target]), (around, half)):
        apart |= ((local.min(1) > edge) | (local.max(1) < -edge)).any(-1)
        beyond = np.maximum(np.abs(local) - edge[..., None, :], 0.0)
        nearest = np.minimum(nearest, np.linalg.norm(beyond, axis=-1).min(1))
    return np.where(apart, nearest, 0.0)
