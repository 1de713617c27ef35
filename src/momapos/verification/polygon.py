"""Distance of points from a polygon."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import contains, edge_distances

if TYPE_CHECKING:
    from jaxtyping import Float


def outside(
    polygon: Float[np.ndarray, "k 2"], points: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Return the signed distance of points from a polygon [m], negative inside."""
    distance = edge_distances(points, polygon)
    return np.asarray(np.where(contains(polygon, points), -distance, distance))
