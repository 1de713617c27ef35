"""Check base poses: boxes of the base against boxes of the scene (separating axes)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core.compiled import F1, F2, F3, F4, I1, entry, kernel
from momapos.model.kinematics import BoxArrays
from momapos.model.urdf import Boxes, MovingBoxes

from .arm_collision import FREE

if TYPE_CHECKING:
    from jaxtyping import Float, Int


class OrientedBox(NamedTuple):
    """An oriented box."""

    center: F1
    rotation: F2
    half: F1


class BoxBetween(NamedTuple):
    """Scratch memory of `boxes_apart`: a box in the frame of another."""

    offset: F1
    rotation: F2
    absolute: F2


@kernel
def boxes_apart(part, boxes, b, scratch):
    """Return whether an oriented box and box b are disjoint (Gottschalk 1996: 15 axes)."""
    ca, Ra, ha = part
    cb, Rb, hb = boxes.center[b], boxes.rotation[b], boxes.half[b]
    t, C, A = scratch
    for i in range(3):
        t[i] = (cb[0] - ca[0]) * Ra[0, i] + (cb[1] - ca[1]) * Ra[1, i] + (cb[2] - ca[2]) * Ra[2, i]
        for j in range(3):
            C[i, j] = Ra[0, i] * Rb[0, j] + Ra[1, i] * Rb[1, j] + Ra[2, i] * Rb[2, j]
            A[i, j] = abs(C[i, j]) + 1e-9
    for i in range(3):
        if abs(t[i]) > ha[i] + hb[0] * A[i, 0] + hb[1] * A[i, 1] + hb[2] * A[i, 2]:
            return True
    for j in range(3):
        s = abs(t[0] * C[0, j] + t[1] * C[1, j] + t[2] * C[2, j])
        if s > hb[j] + ha[0] * A[0, j] + ha[1] * A[1, j] + ha[2] * A[2, j]:
            return True
    if A[2, 2] >= 1.0:
        # Both are upright: the remaining axes are among those above.
        return False
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            r = ha[i1] * A[i2, j] + ha[i2] * A[i1, j] + hb[j1] * A[i, j2] + hb[j2] * A[i, j1]
            if abs(t[i2] * C[i1, j] - t[i1] * C[i2, j]) > r:
                return True
    return False


@kernel
def _spread(rotation, half):
    """Return half edges of the axis-aligned bounding boxes of oriented boxes (b, 3)."""
    out = np.zeros((len(half), 3))
    for b in range(len(half)):
        for k in range(3):
            for a in range(3):
                out[b, k] += abs(rotation[b, k, a]) * half[b, a]
    return out


@kernel
def _near_any(bases, low, high, boxes, spread, reach, near):
    """Write the boxes that the base can touch at some pose; return how many."""
    least, most = np.full(2, np.inf), np.full(2, -np.inf)
    for n in range(len(bases)):
        for k in range(2):
            least[k] = min(least[k], bases[n, k] - reach)
            most[k] = max(most[k], bases[n, k] + reach)
    count = 0
    for b in range(len(spread)):
        away = False
        for k in range(2):
            away |= boxes.center[b, k] - spread[b, k] > most[k]
            away |= boxes.center[b, k] + spread[b, k] < least[k]
        away |= boxes.center[b, 2] - spread[b, 2] > high
        away |= boxes.center[b, 2] + spread[b, 2] < low
        if not away:
            near[count] = b
            count += 1
    return count


@kernel
def _near_point(x, y, near, count, boxes, spread, reach, here):
    """Write those near boxes that the base can touch at a point; return how many."""
    found = 0
    for i in range(count):
        b = near[i]
        away = abs(boxes.center[b, 0] - x) > spread[b, 0] + reach
        if not away and abs(boxes.center[b, 1] - y) <= spread[b, 1] + reach:
            here[found] = b
            found += 1
    return found


@kernel
def _bounds(center, rotation, half):
    """Return the lowest and the highest corner (2, 3) of boxes around boxes."""
    extent = _spread(rotation, half)
    bounds = np.empty((2, 3))
    bounds[0], bounds[1] = np.inf, -np.inf
    for b in range(len(center)):
        for k in range(3):
            bounds[0, k] = min(bounds[0, k], center[b, k] - extent[b, k])
            bounds[1, k] = max(bounds[1, k], center[b, k] + extent[b, k])
    return bounds


@entry
def _hit(bases: F2, base: BoxArrays, boxes: BoxArrays, clearance: float) -> np.ndarray:
    base_center, base_rotation, base_half = base
    center, rotation, half = boxes
    out = np.full(len(bases), FREE, np.int64)
    spread, tall = _spread(rotation, half), _spread(base_rotation, base_half)
    radius = np.empty(len(base_center))
    reach, low, high = 0.0, np.inf, -np.inf
    for a in range(len(base_center)):
        # Heights and this horizontal radius do not depend on yaw.
        radius[a] = np.hypot(tall[a, 0], tall[a, 1]) + clearance
        reach = max(reach, np.hypot(base_center[a, 0], base_center[a, 1]) + radius[a])
        low = min(low, base_center[a, 2] - tall[a, 2] - clearance)
        high = max(high, base_center[a, 2] + tall[a, 2] + clearance)
    bounds, grown = _bounds(base_center, base_rotation, base_half), np.empty(len(center))
    for b in range(len(center)):
        grown[b] = np.hypot(spread[b, 0], spread[b, 1]) + clearance
    near, here = np.empty(len(center), np.int64), np.empty(len(center), np.int64)
    count, found = _near_any(bases, low, high, boxes, spread, reach, near), 0
    c0, R0, h0 = np.empty(3), np.empty((3, 3)), np.empty(3)
    part = OrientedBox(c0, R0, h0)
    scratch = BoxBetween(np.empty(3), np.empty((3, 3)), np.empty((3, 3)))
    for n in range(len(bases)):
        x, y = bases[n, 0], bases[n, 1]
        if n == 0 or x != bases[n - 1, 0] or y != bases[n - 1, 1]:
            found = _near_point(x, y, near, count, boxes, spread, reach, here)
        cos, sin = np.cos(bases[n, 2]), np.sin(bases[n, 2])
        for i in range(found):
            b = here[i]
            dx, dy = center[b, 0] - x, center[b, 1] - y
            # The box within a ball, seen from the base, away from all parts of the base.
            along, across = cos * dx + sin * dy, cos * dy - sin * dx
            if (
                along - grown[b] > bounds[1, 0]
                or along + grown[b] < bounds[0, 0]
                or across - grown[b] > bounds[1, 1]
                or across + grown[b] < bounds[0, 1]
            ):
                continue
            for a in range(len(base_center)):
                gap = abs(base_center[a, 2] - center[b, 2])
                if gap > tall[a, 2] + spread[b, 2] + clearance:
                    continue
                c0[0] = cos * base_center[a, 0] - sin * base_center[a, 1]
                c0[1] = sin * base_center[a, 0] + cos * base_center[a, 1]
                if (
                    abs(c0[0] - dx) > radius[a] + spread[b, 0]
                    or abs(c0[1] - dy) > radius[a] + spread[b, 1]
                ):
                    continue
                c0[0] += x
                c0[1] += y
                c0[2] = base_center[a, 2]
                for k in range(3):
                    R0[0, k] = cos * base_rotation[a, 0, k] - sin * base_rotation[a, 1, k]
                    R0[1, k] = sin * base_rotation[a, 0, k] + cos * base_rotation[a, 1, k]
                    R0[2, k] = base_rotation[a, 2, k]
                    h0[k] = base_half[a, k] + clearance
                if not boxes_apart(part, boxes, b, scratch):
                    out[n] = b
                    break
            if out[n] != FREE:
                break
    return out


def base_hits(
    bases: Float[np.ndarray, "n 3"], base: Boxes, boxes: Boxes, *, clearance: float
) -> Int[np.ndarray, " n"]:
    """Return the index of the first box that each base pose hits, or FREE.

    Args:
        bases: Base poses (x [m], y [m], yaw [rad]).
        base: The base in its own frame.
        boxes: The scene in the world frame.
        clearance: Required distance [m].
    """
    return _hit(
        np.ascontiguousarray(bases, float),
        BoxArrays(*map(np.ascontiguousarray, (base.center, base.rotation, base.half))),
        BoxArrays(*map(np.ascontiguousarray, (boxes.center, boxes.rotation, boxes.half))),
        clearance,
    )


@entry
def _hit_moving(
    bases: F2, value: I1, base: BoxArrays, center: F3, rotation: F4, half: F3, clearance: float
) -> np.ndarray:
    out = np.empty(len(bases), np.int64)
    for n in range(len(bases)):
        v = value[n]
        boxes = BoxArrays(center[v], rotation[v], half[v])
        out[n] = _hit(bases[n : n + 1], base, boxes, clearance)[0]
    return out


def base_hits_moving(
    bases: Float[np.ndarray, "n 3"],
    value: Int[np.ndarray, " n"],
    base: Boxes,
    moving: MovingBoxes,
    *,
    clearance: float,
) -> Int[np.ndarray, " n"]:
    """Return the index of the first moving box that each base pose hits, or FREE.

    Args:
        bases: Base poses (x [m], y [m], yaw [rad]).
        value: Index of the joint's value at each.
        base: The base in its own frame.
        moving: The moving boxes in the world frame.
        clearance: Required distance [m].
    """
    return _hit_moving(
        np.ascontiguousarray(bases, float),
        np.ascontiguousarray(value),
        BoxArrays(base.center, base.rotation, base.half),
        *map(np.ascontiguousarray, (moving.center, moving.rotation, moving.half)),
        clearance,
    )
