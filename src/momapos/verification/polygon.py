"""How far points lie outside a polygon."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.geometry.polygons import contains

if TYPE_CHECKING:
    from jaxtyping import Float


def outside(
    polygon: Float[np.ndarray, "k 2"], points: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Distance of points from a polygon [m]; minus that from its edge where they lie in it."""
    edge, toward = np.roll(polygon, -1, axis=0) - polygon, points[:, None] - polygon
    length = np.maximum((edge**2).sum(1), 1e-12)
    share = np.clip((toward * edge).sum(2) / length, 0.0, 1.0)
    distance = np.linalg.norm(toward - share[..., None] * edge, axis=2).min(1)
    return np.asarray(np.where(contains(polygon, points), -distance, distance))
