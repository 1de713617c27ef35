"""How thick doors are, from the seam behind them that the sides of their object show.

From before, nothing tells how thick a leaf is. From beside, the gap between the leaf and the body
is a dark line along the front, or the body is darker than the leaf.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from momapos.types import FaceImage, Frame, Part
from momapos.views.faces import FLAT, Face, face_image, shown
from momapos.views.front_view import cosines_to

if TYPE_CHECKING:
    from jaxtyping import Float

DEEPEST = 0.16
"""Seams are looked for up to so far behind the front [m]."""
PIXEL = 0.002
"""Size of a pixel of the side, about that of an image taken from 1 m away [m]."""
STEEPEST = 65.0
"""Images taken farther than this from a side's normal do not show it well enough [deg]."""
IMAGES = 4
"""Images of a side that are looked at, the best first [-]."""
LEAST_SHOWN = 0.3
"""Part of the strip behind the front that an image must show [-]."""
MARGIN = 0.05
"""Left out of the parts' height at either end [-]."""
BLOCK = 8
"""Rows whose mean is taken, against noise and the grain of wood [px]."""
BESIDE = 3
"""Pixels on either side that are compared, about as wide as a gap [px]."""
DARKEST = 20.0
"""What is darker than this is one black [gray level]."""
STEP, ALONG = 0.008, 0.7
"""A seam darkens by the first at least, over this share of what is seen of its length [-]."""
MEASURED = 0.4
"""Share of the length that must be seen [-]."""
CLEAR = 0.08
"""Contrasts of a seam in all images add up to this at least [-]."""
FIRST = 0.6
"""The seam is the first line that has this share of the strongest one's contrast: flanges and
shadows lie behind it [-]."""
DRIFT = 3
"""Images differ by so much in where they see a line, by errors of their poses [px]."""


def leaf_rear(
    front: Face, sides: Sequence[Face], parts: Sequence[Part], frames: Sequence[Frame]
) -> float | None:
    """How far behind a front its doors end, where images show the sides of the object.

    Args:
        front: The front of a box.
        sides: Faces of the box beside it.
        parts: What is on the front; at least one.
        frames: Images that show the object.

    Returns:
        Distance from the plane of the front to the rear edge of the leaves [m]; None where no seam
        is seen.
    """
    top, bottom = min(part.box[1] for part in parts), max(part.box[3] for part in parts)
    span = (0.5 - bottom) * front.height, (0.5 - top) * front.height
    lines = [line for side in sides for line in _lines_on(_strip(front, side, span), front, frames)]
    if not lines:
        return None
    contrast = np.array(lines)
    total = ndimage.maximum_filter1d(contrast, 2 * DRIFT + 1, axis=1).sum(axis=0)
    if total.max() < CLEAR:
        return None
    start = int(np.argmax(total >= FIRST * total.max()))
    near = contrast[:, start : start + 2 * DRIFT + 1]
    seen = near.max(axis=1) > 0.0
    return float(np.median(start + near[seen].argmax(axis=1)) * PIXEL)


def _strip(front: Face, side: Face, span: tuple[float, float]) -> Face:
    """The strip of a side that lies behind the doors of a front, as far back as leaves may be."""
    low, high = span
    height = (1.0 - 2 * MARGIN) * (high - low)
    deep = min(DEEPEST, side.width / 2)
    T = side.T_world_face.copy()
    T[:3, 3] += T[:3, 0] * _toward(front, side) * (side.width - deep) / 2
    T[:3, 3] += T[:3, 1] * (low + high) / 2
    return replace(side, T_world_face=T, width=deep, height=height)


def _toward(front: Face, side: Face) -> float:
    """1 where the front is at the right end of a side as seen from outside, else -1."""
    return float(np.sign(side.T_world_face[:3, 0] @ front.outward))


def _lines_on(
    strip: Face, front: Face, frames: Sequence[Frame]
) -> list[Float[np.ndarray, " columns"]]:
    """Contrast of lines along the front in each image that shows a strip well, from the front."""
    cosines = cosines_to(strip, frames)
    fair = np.flatnonzero(cosines > np.cos(np.radians(STEEPEST)))
    near = [frames[int(i)] for i in fair]
    parts = np.array([shown(strip, frame) for frame in near])
    places = np.array([frame.T_world_camera[:3, 3] for frame in near]).reshape(-1, 3)
    away = np.linalg.norm(places - strip.T_world_face[:3, 3], axis=1)
    order = np.argsort(-parts * cosines[fair] / np.maximum(away, 1e-6), kind="stable")
    pixels = round(max(strip.width, strip.height) / PIXEL)
    mirrored = _toward(front, strip) > 0
    return [
        _darkening(face_image(strip, [near[k]], pixels=pixels), mirrored=mirrored)
        for k in order[:IMAGES]
        if parts[k] > LEAST_SHOWN
    ]


def _darkening(image: FaceImage, *, mirrored: bool) -> Float[np.ndarray, " columns"]:
    """How much darker a strip becomes from column to column, where it does so all along.

    Args:
        image: The strip.
        mirrored: Whether its front is at its right end.

    Returns:
        Contrast from the front to the back [-]; 0 where there is no line.
    """
    step = -1 if mirrored else 1
    there = (np.abs(image.height_map) < FLAT)[:, ::step]  # NaN compares as false
    gray = np.where(there, image.color.mean(axis=-1)[:, ::step], np.nan)
    rows, columns = len(gray) // BLOCK, gray.shape[1]
    blocks = gray[: rows * BLOCK].reshape(rows, BLOCK, columns)
    known = np.isfinite(blocks)
    few = known.sum(axis=1) < BLOCK // 2
    mean = np.where(few, np.nan, np.nansum(blocks, axis=1) / np.maximum(known.sum(axis=1), 1))
    contrast = np.full((rows, columns), np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(mean, BESIDE, axis=1).mean(axis=-1)
    before, after = windows[:, :-BESIDE], windows[:, BESIDE:]
    contrast[:, BESIDE : columns - BESIDE + 1] = (before - after) / (before + DARKEST)
    seen = np.isfinite(contrast)
    enough = seen.sum(axis=0) >= max(1.0, MEASURED * rows)
    dark = (np.where(seen, contrast, 0.0) > STEP).sum(axis=0)
    line = enough & (dark >= ALONG * seen.sum(axis=0))
    found = np.zeros(columns)
    if line.any():
        found[line] = np.nanmedian(contrast[:, line], axis=0)
    return found
