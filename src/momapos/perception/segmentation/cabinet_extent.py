"""Measure the furniture body below a top: its extent, and whether it is closed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .room_shell import area, ends, peaks
from .supports import Rectangle

if TYPE_CHECKING:
    from jaxtyping import Float

MIN_Z, MIN_DROP = 0.12, 0.1
"""Sides are measured this far above the floor, and this far below the top [m]."""
EAVES = (0.05, 0.4)
"""Smaller overhangs are flush, larger ones are not overhangs [m]."""
MAX_EDGE_DISTANCE = 0.11
"""Surfaces this close to an edge of the top may be the side below it [m]."""
MIN_COVERED = 0.25
"""Minimum share of a side that a surface covers [-]."""
PLANE_TOLERANCE = 0.015
"""Points of one surface are within this of its plane [m]."""


@dataclass(frozen=True)
class _Side:
    """An upright surface below an edge of a top."""

    depth: float
    """Distance from the edge, inward [m]."""
    low: float
    high: float
    """Start and end along the edge [m]."""


def cabinet_extent(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    rectangle: Rectangle,
    height: float,
) -> Rectangle:
    """Return the outline of the furniture below a top that may overhang.

    Each side is the outermost broad surface that faces out, but no farther in than its neighbors
    end, because furniture may be open at a side. Unseen sides and small overhangs are flush with
    the top.

    Args:
        points: Points below the top.
        normals: Normals of the points.
        rectangle: The top seen from above.
        height: Height of the top [m].
    """
    if height - MIN_Z - MIN_DROP < 0.1:
        return rectangle
    sides = [_side(points, normals, rectangle, height, side) for side in range(4)]
    body = list(rectangle)
    for side, found in enumerate(sides):
        if found is None:
            continue
        axis, sign = side % 2, 1.0 if side < 2 else -1.0
        beside = [s for s in (sides[1 - axis], sides[3 - axis]) if s is not None]
        reached = [sign * ((s.low if side < 2 else s.high) - rectangle[side]) for s in beside]
        depth = min([found.depth, *reached])
        if EAVES[0] < depth < EAVES[1]:
            body[side] += sign * depth
    return (body[0], body[1], body[2], body[3])


def _side(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    rectangle: Rectangle,
    height: float,
    side: int,
) -> _Side | None:
    axis, sign = side % 2, -1.0 if side < 2 else 1.0
    start, stop = rectangle[1 - axis], rectangle[3 - axis]
    inward, along = sign * (rectangle[side] - points[:, axis]), points[:, 1 - axis]
    on = (sign * normals[:, axis] > 0.8) & (along > start) & (along < stop)
    on &= (points[:, 2] > MIN_Z) & (points[:, 2] < height - MIN_DROP)
    on &= (inward > -MAX_EDGE_DISTANCE) & (inward < EAVES[1])
    for depth in sorted(peaks(inward[on], PLANE_TOLERANCE, 10, 2 * PLANE_TOLERANCE)):
        flat = on & (np.abs(inward - depth) < PLANE_TOLERANCE)
        covered = area(along[flat], points[flat, 2])
        share = covered / ((stop - start) * (height - MIN_DROP - MIN_Z))
        if share > MIN_COVERED:
            return _Side(depth, *ends(along[flat], 2 * PLANE_TOLERANCE))
    return None


def closed_share(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    rectangle: Rectangle,
    height: float,
    near: float,
) -> float:
    """Return the share of the fullest side below a surface that upright surfaces cover [-].

    Args:
        points: Points below and around it.
        normals: Normals of the points.
        rectangle: The surface seen from above.
        height: Height of the surface [m].
        near: Points this close to a side belong to it [m].
    """
    low_z, high_z = MIN_Z, height - MIN_DROP
    if high_z - low_z < 0.1:
        return 0.0
    shares = []
    for side in range(4):
        axis = side % 2
        at = (np.abs(normals[:, axis]) > 0.8) & (np.abs(points[:, axis] - rectangle[side]) < near)
        on = points[at & (points[:, 2] > low_z) & (points[:, 2] < high_z)]
        whole = (rectangle[3 - axis] - rectangle[1 - axis]) * (high_z - low_z)
        shares.append(area(on[:, 1 - axis], on[:, 2]) / whole)
    return max(shares)
