"""Detect dark lines in an image, such as the seams between doors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from jaxtyping import Float32, UInt8

SEAM_SIDE = 3
"""Distance from a line to the pixels on either side that it is compared with [px]."""
SEAM_RUN = 1 / 12
"""Averaging length along a line, as a share of the image's side [-]."""
SEAM_GAIN, SEAM_MOST = 10.0, 2.0
"""Factor from contrast to output value, and the largest output value [-]."""
DARK_OFFSET = 16.0
"""Offset of the brightness, so that noise in dark areas is not contrast [0 to 255]."""


def dark_lines(color: UInt8[np.ndarray, "h w 3"], across: int) -> Float32[np.ndarray, "h w"]:
    """Return how much darker each pixel is than both sides, averaged along a possible line.

    The seam of two doors is one pixel wide and hardly darker than the grain of their wood, but it
    runs straight from one end to the other. It is lost when the image is downscaled.

    Args:
        color: The image at full resolution.
        across: Axis across the line: 1 for upright lines, 0 for level ones.

    Returns:
        Contrast, 0 to `SEAM_MOST`.
    """
    gray = color.mean(axis=-1, dtype=np.float32)
    index = np.arange(gray.shape[across])
    before, after = (
        gray.take(np.clip(index + step, 0, len(index) - 1), axis=across)
        for step in (-SEAM_SIDE, SEAM_SIDE)
    )
    side = np.minimum(before, after)
    contrast = (side - gray) / (side + DARK_OFFSET)
    run = max(3, round(SEAM_RUN * gray.shape[1 - across]))
    mean = ndimage.uniform_filter1d(contrast, run, axis=1 - across, mode="nearest")
    return np.clip(SEAM_GAIN * mean, 0.0, SEAM_MOST)
