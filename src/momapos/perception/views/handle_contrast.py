"""Check that the handle of a detected part is visible, in the height map or in the colors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import FaceImage, Part

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

NEAR = 0.02
"""A bar lies within this of its detected box [m]."""
MIN_PROTRUSION, MIN_SIGMAS = 0.01, 3.0
"""A handle protrudes by the first [m] and this many standard deviations of the noise [-]."""
MIN_COLOR, MIN_COLOR_RATIO = 0.06, 2.5
"""Contrast of a handle with the front [-], and relative to the contrast within the front [-]."""
MIN_BAR, MIN_BAR_RATIO = 0.03, 3.0
"""Contrast of a bar with the front [-], and relative to other lines on it [-]."""
MAX_BEYOND = 0.6
"""Contrast of the line beyond the ends of a bar, relative to the bar: a seam goes on [-]."""
MAX_END_GAP = 6
"""Gap between the end of a bar and what is examined beyond it [px]."""
MIN_BAR_ASPECT = 2.0
"""A less elongated handle is a knob [-]."""
BAR_SIDE = 0.02
"""Distance from a bar to the surface that it is compared with [m]."""
MAX_HANDLE_THICKNESS = 0.06
"""A larger patch of another color is a sign or a window [m]."""
AROUND_HANDLE = 0.02
"""Width of the ring that a handle is compared with [m]."""
MIN_RING = 12
"""Pixels needed for a comparison [-]."""


def protrudes(image: FaceImage, part: Part) -> bool:
    """Check whether the handle of a part protrudes from it in the height map."""
    inside, ring = _handle_and_ring(image, part)
    heights = image.height_map
    bar, front = (heights[mask & np.isfinite(heights)] for mask in (inside, ring))
    if min(len(bar), len(front)) < MIN_RING:
        return False
    level = float(np.median(front))
    noise = 1.4826 * float(np.median(np.abs(front - level)))
    out = float(np.percentile(bar, 75)) - level
    return out > max(MIN_PROTRUSION, MIN_SIGMAS * noise)


def differs(image: FaceImage, part: Part) -> bool:
    """Check whether the handle of a part is a bar or a knob of another color than the part."""
    assert part.handle is not None
    left, top, right, bottom = part.handle
    wide, tall = (right - left) * image.width, (bottom - top) * image.height
    if min(wide, tall) > MAX_HANDLE_THICKNESS:
        return False
    if max(wide, tall) >= MIN_BAR_ASPECT * min(wide, tall):
        return _is_bar(image, part, upright=tall > wide)
    inside, ring = _handle_and_ring(image, part)
    if ring.sum() < MIN_RING or not inside.any():
        return False
    color = image.color.astype(float) / 255
    off = np.abs(color - np.median(color[ring], axis=0)).mean(axis=-1)
    contrast, noise = (float(np.percentile(off[m], q)) for m, q in ((inside, 60), (ring, 75)))
    return contrast > max(MIN_COLOR, MIN_COLOR_RATIO * noise)


def _is_bar(image: FaceImage, part: Part, *, upright: bool) -> bool:
    """Check for a thin line at a handle that is much clearer than other lines on its part.

    From across a room a bar is one or two pixels wide, and its box is off by as much.
    """
    assert part.handle is not None
    gray = image.color.mean(axis=-1, dtype=np.float32) / 255
    box, handle = np.array(part.box), np.array(part.handle)
    size = image.height
    if upright:
        gray, size = gray.T, image.width
        box, handle = box[[1, 0, 3, 2]], handle[[1, 0, 3, 2]]
    rows, columns = gray.shape
    pixel = size / rows
    left, right = np.rint(handle[[0, 2]] * columns).astype(int)
    trim = (right - left) // 8
    own = slice(left + trim, max(right - trim, left + trim + 1))
    away = max(3, round(BAR_SIDE / pixel))
    contrast = _thin(gray[:, own].mean(axis=1), away)
    place = (np.arange(rows)[away:-away] + 0.5) / rows
    near = NEAR / size
    low, high = max(handle[1] - near, box[1] + near / 2), min(handle[3] + near, box[3] - near / 2)
    there = np.flatnonzero((place > low) & (place < high))
    inner = (place > box[1] + 2 * near) & (place < box[3] - 2 * near)
    others = contrast[inner & ((place < handle[1] - 3 * near) | (place > handle[3] + 3 * near))]
    if len(others) < MIN_RING or not len(there):
        return False
    row = there[contrast[there].argmax()]
    ends = [
        abs(float(_thin(gray[:, beyond].mean(axis=1), away)[row]))
        for beyond in _beyond(np.rint(box[[0, 2]] * columns).astype(int), int(left), int(right))
    ]
    least = max(MIN_BAR, MIN_BAR_RATIO * float(np.percentile(others, 90)))
    return bool(contrast[row] > least and all(end < MAX_BEYOND * contrast[row] for end in ends))


def _thin(line: Float[np.ndarray, " n"], away: int) -> Float[np.ndarray, " m"]:
    """Return how much brighter or darker each pixel of a line is than both pixels next to it."""
    before, middle, after = line[: -2 * away], line[away:-away], line[2 * away :]
    return np.maximum(middle - np.maximum(before, after), np.minimum(before, after) - middle)


def _beyond(part: Int[np.ndarray, "2"], left: int, right: int) -> list[slice]:
    """Return the columns of a part to the left and right of its bar, if there are enough."""
    gap = min(max(2, (right - left) // 8), MAX_END_GAP)
    wide = max(right - left, 3 * gap)
    sides = (
        slice(max(int(part[0]) + gap, left - gap - wide), left - gap),
        slice(right + gap, min(int(part[1]) - gap, right + gap + wide)),
    )
    return [side for side in sides if side.stop - side.start >= gap]


def _handle_and_ring(
    image: FaceImage, part: Part
) -> tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Return the pixels of a part's handle, and those of the part around it."""
    shape = image.height_map.shape
    inside, ring, allowed = (np.zeros(shape, bool) for _ in range(3))
    assert part.handle is not None
    rows, columns = pixels_of(image, part.handle)
    inside[rows, columns] = True
    wide = round(AROUND_HANDLE / image.width * shape[1])
    tall = round(AROUND_HANDLE / image.height * shape[0])
    for mask, y, x in ((ring, max(tall, 3), max(wide, 3)), (allowed, 1, 1)):
        mask[
            max(rows.start - y, 0) : rows.stop + y, max(columns.start - x, 0) : columns.stop + x
        ] = True
    own = np.zeros(shape, bool)
    own[pixels_of(image, part.box)] = True
    return inside & own, ring & ~allowed & own


def pixels_of(image: FaceImage, box: tuple[float, float, float, float]) -> tuple[slice, slice]:
    """Return the rows and columns of a box, at least one of each."""
    tall, wide = image.height_map.shape
    left, top, right, bottom = np.rint(np.array(box) * np.tile((wide, tall), 2)).astype(int)
    top, left = min(max(int(top), 0), tall - 1), min(max(int(left), 0), wide - 1)
    return slice(top, max(int(bottom), top + 1)), slice(left, max(int(right), left + 1))
