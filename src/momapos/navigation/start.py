"""Where a robot starts when nobody says: in front of things, with room around it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.errors import SceneError
from momapos.navigation.cost_map import CELL, FloorPlan

if TYPE_CHECKING:
    from jaxtyping import Float

ROOM = 0.8
"""Clearance around the start [m]."""


def find_start(plan: FloorPlan, wish: Float[np.ndarray, "2"]) -> Float[np.ndarray, "3"]:
    """The floor position nearest to a wish that has room around it.

    Args:
        plan: Where something stands.
        wish: Where the start would best be [m].

    Raises:
        SceneError: Nowhere is there room.
    """
    from scipy.ndimage import distance_transform_edt

    clear = (
        distance_transform_edt(np.pad(~plan.blocked, 1, constant_values=True))[1:-1, 1:-1] * CELL
    )
    i, j = np.nonzero(clear > min(ROOM, 0.9 * float(clear.max())))
    if not len(i):
        raise SceneError("the room is full: nowhere can a robot start; give --start X,Y,YAW")
    centers = plan.origin + (np.stack([j, i], -1) + 0.5) * CELL
    best = int(np.argmin(np.linalg.norm(centers - wish, axis=1)))
    return np.array([centers[best, 0], centers[best, 1], 0.0])
