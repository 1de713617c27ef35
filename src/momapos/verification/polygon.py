"""Distance of points from a polygon."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import contains, edge_distances

from .exact_shapes import Shapes

if TYPE_CHECKING:
    from jaxtyping import Float


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
