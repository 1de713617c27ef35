"""Find places of a room that images see through."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert
from momapos.model.records import Frame

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MIN_DEPTH = 0.1
"""Places closer to a camera are ignored [m]."""
MAX_PROJECTED = 100_000
"""Number of places times images that are projected together, to bound memory [-]."""
SEEN_BEYOND = 0.1
"""An image sees through a place if it measures something this far behind it [m]."""


class SeenThrough:
    """Tells whether any image with depth measures something far enough behind a place.

    Each batch of places is projected into all images at once, which takes an eighth of the time of
    one image after the other.

    Args:
        frames: Images; those without depth are ignored.
    """

    def __init__(self, frames: Sequence[Frame]) -> None:
        self._depths = [frame.depth for frame in frames if frame.depth is not None]
        seeing = [frame for frame in frames if frame.depth is not None]
        self._T_camera_world = np.array([invert(frame.T_world_camera) for frame in seeing]).reshape(
            -1, 4, 4
        )
        self._intrinsics = np.array([frame.intrinsics for frame in seeing]).reshape(-1, 3, 3)
        shapes = np.array([depth.shape for depth in self._depths]).reshape(-1, 2)
        self._height, self._width = shapes.T[..., None]

    def __call__(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Tell which places in the images' world [m] are seen through."""
        step = max(1, MAX_PROJECTED // max(1, len(self._depths)))
        parts = [self._seen(points[at : at + step]) for at in range(0, len(points), step)]
        return np.concatenate(parts) if parts else np.zeros(0, bool)

    def _seen(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        local = apply(self._T_camera_world, points)
        z = np.maximum(local[..., 2], 1e-3)
        pixels = local @ np.swapaxes(self._intrinsics, -1, -2)
        u, v = (np.round(pixels[..., k] / z).astype(int) for k in (0, 1))
        there = (local[..., 2] > MIN_DEPTH) & (u >= 0) & (v >= 0)
        there &= (u < self._width) & (v < self._height)
        out = np.zeros(len(points), bool)
        for k in np.flatnonzero(there.any(axis=1)):
            on = np.flatnonzero(there[k] & ~out)
            out[on] = self._depths[k][v[k, on], u[k, on]] > z[k, on] + SEEN_BEYOND
        return out
