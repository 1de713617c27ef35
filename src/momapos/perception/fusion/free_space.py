"""Places of a room that images see through."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert
from momapos.model.records import Frame

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

NEAREST = 0.1
"""What is nearer to a camera than this is not looked for in its image [m]."""
AT_ONCE = 100_000
"""So many places, times images, are projected together, which bounds memory [-]."""


class SeenThrough:
    """Whether any image with depth measures something far enough behind places.

    A few places are projected into all images at once, which takes an eighth of the time that one
    image after the other takes.

    Args:
        frames: Images; those without depth tell nothing.
        through: What is measured is so far behind, at least [m].
    """

    def __init__(self, frames: Sequence[Frame], through: float) -> None:
        self._depths = [frame.depth for frame in frames if frame.depth is not None]
        seeing = [frame for frame in frames if frame.depth is not None]
        self._T_camera_world = np.array([invert(frame.T_world_camera) for frame in seeing]).reshape(
            -1, 4, 4
        )
        self._intrinsics = np.array([frame.intrinsics for frame in seeing]).reshape(-1, 3, 3)
        shapes = np.array([depth.shape for depth in self._depths]).reshape(-1, 2)
        self._height, self._width = shapes.T[..., None]
        self._through = through

    def __call__(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which of some places of the images' world [m] are seen through."""
        step = max(1, AT_ONCE // max(1, len(self._depths)))
        parts = [self._seen(points[at : at + step]) for at in range(0, len(points), step)]
        return np.concatenate(parts) if parts else np.zeros(0, bool)

    def _seen(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        local = apply(self._T_camera_world, points)
        z = np.maximum(local[..., 2], 1e-3)
        pixels = local @ np.swapaxes(self._intrinsics, -1, -2)
        u, v = (np.round(pixels[..., k] / z).astype(int) for k in (0, 1))
        there = (local[..., 2] > NEAREST) & (u >= 0) & (v >= 0)
        there &= (u < self._width) & (v < self._height)
        out = np.zeros(len(points), bool)
        for k in np.flatnonzero(there.any(axis=1)):
            on = np.flatnonzero(there[k] & ~out)
            out[on] = self._depths[k][v[k, on], u[k, on]] > z[k, on] + self._through
        return out
