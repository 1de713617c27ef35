"""Places of a room that images see through."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.geometry.transforms import apply, invert
from momapos.types import Frame

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


def seen_through(
    frame: Frame, points: Float[np.ndarray, "n 3"], through: float
) -> Bool[np.ndarray, " n"]:
    """Whether an image with depth measures something this far [m] behind places."""
    assert frame.depth is not None
    h, w = frame.depth.shape
    local = apply(invert(frame.T_world_camera), points)
    z = np.maximum(local[:, 2], 1e-3)
    pixels = local @ frame.intrinsics.T
    u, v = (np.round(pixels[:, k] / z).astype(int) for k in (0, 1))
    there = (local[:, 2] > 0.1) & (u >= 0) & (v >= 0) & (u < w) & (v < h)
    depth = frame.depth[np.clip(v, 0, h - 1), np.clip(u, 0, w - 1)]
    return there & (depth > z + through)


def seen_empty(
    frames: Sequence[Frame], points: Float[np.ndarray, "n 3"], through: float
) -> Bool[np.ndarray, " n"]:
    """Whether any image sees through places.

    Args:
        frames: Images; those without depth tell nothing.
        points: Places in their world [m].
        through: What is measured is so far behind, at least [m].
    """
    out = np.zeros(len(points), bool)
    for frame in frames:
        if frame.depth is not None:
            out[~out] = seen_through(frame, points[~out], through)
    return out
