"""Measure how far the points of a cloud are apart."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float

NEIGHBORS = 8
SAMPLED = 4_000
"""Number of points whose neighbors are measured [-]."""


def point_spacing(points: Float[np.ndarray, "n 3"], percent: float = 50.0) -> float:
    """Return the distance that a share of a cloud's points keep to their eight nearest neighbors.

    Args:
        points: The cloud [m].
        percent: The share [%].

    Returns:
        A percentile of the mean distance to the neighbors [m], about 1.2 times the step of a grid;
        0 for a cloud of fewer than nine points.
    """
    if len(points) <= NEIGHBORS:
        return 0.0
    from scipy.spatial import cKDTree

    sample = points[:: -(-len(points) // SAMPLED)]
    distances, _ = cKDTree(points).query(sample, k=NEIGHBORS + 1)
    return float(np.percentile(distances[:, 1:].mean(axis=1), percent))
