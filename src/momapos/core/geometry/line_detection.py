"""Dark lines in an image: the seams between doors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from jaxtyping import Float32, UInt8

SEAM_SIDE = 3
"""Distance from a dark line to what it is compared with on either side [px]."""
SEAM_RUN = 1 / 12
"""Length over which a line is averaged, as a share of the image's side [-]."""
SEAM_GAIN, SEAM_MOST = 10.0, 2.0
"""Factor from a line's contrast to a plane's value, and the largest value [-]."""
DARKEST = 16.0
"""Added to a brightness, so that noise in the dark is no contrast [0 to 255]."""


def dark_lines(color: UInt8[np.ndarray, "h w 3"], across: int) -> Float32[np.ndarray, "h w"]:
    """How much darker each pixel is than both of its sides, averaged along the line it may lie on.

    The seam of two doors is a pixel wide and hardly darker than the grain of their wood, but it
    runs straight from one end to the other; once the image is shrunk it is lost.

    Args:
        color: The image, at its full resolution.
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
    contrast = (side - gray) / (side + DARKEST)
    run = max(3, round(SEAM_RUN * gray.shape[1 - across]))
    mean = ndimage.uniform_filter1d(contrast, run, axis=1 - across, mode="nearest")
    return np.clip(SEAM_GAIN * mean, 0.0, SEAM_MOST)
