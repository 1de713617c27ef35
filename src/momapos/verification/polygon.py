"""Distance of points from a polygon, and overlap of outlines with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import contains, convex_hull, edge_distances, edge_normals

from .exact_shapes import Shapes

if TYPE_CHECKING:
    from jaxtyping import Float

_BLOCK = 64
"""Number of outlines that are compared with an area together [-]."""
_BALL = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
"""Directions in which a ball extends a shape [rad]."""


def outside(
    polygon: Float[np.ndarray, "k 2"], points: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Return the signed distance of points from a polygon [m], negative inside."""
    distance = edge_distances(points, polygon)
    return np.asarray(np.where(contains(polygon, points), -distance, distance))


def farthest_outside(
    polygon: Float[np.ndarray, "k 2"], shapes: Shapes, Ts: Float[np.ndarray, "s b 4 4"]
) -> tuple[float, int]:
    """Return how far any shape extends outside a polygon [m], and at which of its poses.

    Args:
        polygon: The polygon.
        shapes: The shapes.
        Ts: Their world poses.

    Returns:
        The distance, 0 if all are inside, and the index of the poses.
    """
    middle = outside(polygon, Ts[..., :2, 3].reshape(-1, 2)).reshape(Ts.shape[:2])
    near = middle + np.linalg.norm(shapes.half, axis=1) > 0.0
    worst, where = 0.0, 0
    for index in np.flatnonzero(near.any(0)).tolist():
        states = np.flatnonzero(near[:, index])
        T, outline = Ts[states, index], shapes.outline(index)
        points = outline @ T[:, :2, :3].transpose(0, 2, 1) + T[:, None, :2, 3]
        gaps = outside(polygon, points.reshape(-1, 2)).reshape(points.shape[:2]).max(1)
        state = int(gaps.argmax())
        if gaps[state] + shapes.ball[index] > worst:
            worst, where = float(gaps[state] + shapes.ball[index]), int(states[state])
    return worst, where


def outline_of(shapes: Shapes, Ts: Float[np.ndarray, "b 4 4"]) -> Float[np.ndarray, "k 2"]:
    """Return the convex outline of shapes on the floor, counterclockwise, at their poses [m]."""
    rim = np.column_stack([np.cos(_BALL), np.sin(_BALL)])
    points = [
        ((outline @ T[:3, :3].T + T[:3, 3])[:, None, :2] + ball * rim).reshape(-1, 2)
        for outline, ball, T in zip(shapes.outlines, shapes.ball, Ts, strict=True)
    ]
    return convex_hull(np.concatenate(points))


def depths_in(
    area: Float[np.ndarray, "k 2"], outlines: Float[np.ndarray, "n m 2"]
) -> Float[np.ndarray, " n"]:
    """Return how deep convex outlines and an area are in each other [m]; 0 where they are apart.

    The depth is that of a corner of the outline in the area, or of the middle of the part of an
    edge of the area that is in the outline. So a small area in a large outline counts, and a strip
    across it.
    """
    blocks = [outlines[k : k + _BLOCK] for k in range(0, len(outlines), _BLOCK)]
    return np.concatenate([np.zeros(0), *(_depths_in(area, block) for block in blocks)])


def _depths_in(
    area: Float[np.ndarray, "k 2"], outlines: Float[np.ndarray, "n m 2"]
) -> Float[np.ndarray, " n"]:
    corners = outlines.reshape(-1, 2)
    within = np.where(contains(area, corners), edge_distances(corners, area), 0.0)
    normal = edge_normals(outlines)
    level = (normal * outlines).sum(-1)
    # Where an edge of the area, from 0 to 1, is on the inner side of every edge of an outline.
    beyond = np.einsum("nmi,ki->nmk", normal, area) - level[..., None]
    rise = np.einsum("nmi,ki->nmk", normal, np.roll(area, -1, axis=0) - area)
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = -beyond / rise
    first = np.where(rise < 0.0, cut, np.where((rise > 0.0) | (beyond <= 0.0), 0.0, np.inf))
    last = np.where(rise > 0.0, cut, 1.0)
    first, last = np.maximum(first.max(1), 0.0), np.minimum(last.min(1), 1.0)
    middle = np.where(first <= last, (first + last) / 2, 0.0)
    depth = -(beyond + middle[:, None] * rise).max(1)
    crossed = np.where(first <= last, depth, 0.0).max(1)
    return np.maximum(np.maximum(within.reshape(len(outlines), -1).max(1), crossed), 0.0)
