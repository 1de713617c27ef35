"""Find stacks of drawers without visible gaps by their handles: evenly spaced level lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from momapos.model.records import FaceImage, Part

from . import decode
from .free_bars import MAX_FRONT_DEPTH, reach
from .height_maps import area_of

if TYPE_CHECKING:
    from jaxtyping import Float, Float32

FLAPS = ("door_down", "door_up")
"""Kinds that are never stacks: the racks behind an oven's window look like one."""
MIN_CONTRAST = 0.08
"""Contrast of a handle in `dark_lines` [-]."""
MIN_PLAIN = 0.9
"""Share of a front without any line; wood grain hides handles otherwise [-]."""
MIN_LINES = 3
"""Lines in a stack [-]."""
HANDLE_WIDTHS = (0.08, 0.6)
"""Width of a handle relative to its part [-]."""
MAX_WIDTH_RATIO = 1.5
"""Between the width of a handle and the median [-]."""
MAX_HANDLE_HEIGHT = 0.04
"""Height of a handle relative to its part [-]."""
MAX_OFF_CENTER = 0.1
"""Distance of a handle from the middle of its drawer, relative to its width [-]."""
MAX_PITCH_DEVIATION = 0.2
"""Deviation of the distances from their median, relative to it [-]."""
DRAWER_HEIGHTS = (0.08, 0.5)
"""Height of a drawer [m]."""
MIN_MEASURED = 0.5
"""Share of a part with depth that is needed to find the end of its front [-]."""
MIN_INSIDE = 0.5
"""Parts with more than this share inside a stack belong to it [-]."""
MIN_BELOW = 0.75
"""Handles are at the tops of drawers if more than this share of a drawer is below the last [-]."""


def into_drawers(
    face: FaceImage, parts: Sequence[Part], lines: Float32[np.ndarray, "h w"]
) -> tuple[Part, ...]:
    """Replace parts that are stacks of drawers by their drawers.

    Without visible gaps, the networks may take all of a stack or any stretch of it for a part. So
    handles are also searched above and below each part, as far as its front continues.

    Args:
        face: The face.
        parts: Detected doors and drawers.
        lines: Level dark lines of the face.
    """
    rest = sorted(parts, key=lambda part: -part.score)
    kept: list[Part] = []
    while rest:
        part = rest.pop(0)
        drawers = () if part.kind in FLAPS else _stack(face, part, lines)
        whole = area_of(_around(drawers) if drawers else part.box, face)
        if not drawers or area_of(part.box, face).share_in(whole) <= MIN_INSIDE:
            kept.append(part)
            continue
        inside = [other for other in rest if area_of(other.box, face).share_in(whole) > MIN_INSIDE]
        rest = [other for other in rest if other not in inside]
        seen = [part, *inside]
        fronts = [area_of(one.box, face) for one in seen]
        handles = [area_of(drawer.handle or drawer.box, face) for drawer in drawers]
        fit = {sum(bar.share_in(front) > MIN_INSIDE for bar in handles) for front in fronts}
        kept += seen if len(seen) == len(drawers) and fit == {1} else drawers
    return tuple(kept)


def _stack(face: FaceImage, part: Part, lines: Float32[np.ndarray, "h w"]) -> tuple[Part, ...]:
    """Return the drawers of the stack that a part belongs to; empty if there is no stack."""
    box = _column(face, part)
    rows = _rows(lines, box)
    if len(rows) < MIN_LINES:
        return ()
    middle = rows[:, [1, 3]].mean(axis=1)
    pitch = float(np.median(np.diff(middle)))
    even = np.abs(np.diff(middle) - pitch).max() < MAX_PITCH_DEVIATION * pitch
    if not (even and DRAWER_HEIGHTS[0] < pitch * face.height < DRAWER_HEIGHTS[1]):
        return ()
    at_top = box[3] - middle[-1] > MIN_BELOW * pitch
    edges = middle if at_top else middle - pitch / 2
    edges = np.clip(np.append(edges, edges[-1] + pitch), box[1], box[3])
    return tuple(
        replace(
            decode.with_kind(part, "drawer"),
            box=(part.box[0], float(top), part.box[2], float(bottom)),
            handle=(float(x0), float(max(y0, top)), float(x1), float(y1)),
        )
        for top, bottom, (x0, y0, x1, y1) in zip(edges[:-1], edges[1:], rows, strict=True)
    )


def _around(drawers: Sequence[Part]) -> tuple[float, float, float, float]:
    """Return the rectangle of a stack, from its highest drawer to its lowest."""
    left, top, right, _ = drawers[0].box
    return left, top, right, drawers[-1].box[3]


def _column(face: FaceImage, part: Part) -> Float[np.ndarray, "4"]:
    """Extend a part up and down to the ends of its front; unchanged without depth."""
    box = np.array(part.box)
    high, wide = face.height_map.shape
    left, top, right, bottom = np.rint(box * [wide, high, wide, high]).astype(int)
    own = face.height_map[top:bottom, left:right]
    if np.isfinite(own).mean() < MIN_MEASURED:
        return box
    column = face.height_map[:, left:right]
    free = column > np.nanmedian(own) - MAX_FRONT_DEPTH  # false where unmeasured
    middle = int(top + bottom) // 2
    highest, lowest = reach(free.mean(axis=1), (middle, middle))
    box[1], box[3] = min(box[1], highest / high), max(box[3], lowest / high)
    return box


def _rows(
    lines: Float32[np.ndarray, "h w"], box: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "n 4"]:
    """Return the handles in the middle of a part, top to bottom, as fractions of the face."""
    none = np.zeros((0, 4))
    high, wide = lines.shape
    left, top, right, bottom = np.rint(box * [wide, high, wide, high]).astype(int)
    inner = lines[top:bottom, left:right]
    if min(inner.shape, default=0) < 8 or (inner < MIN_CONTRAST).mean() < MIN_PLAIN:
        return none
    label, count = ndimage.label(inner > MIN_CONTRAST, np.ones((3, 3)))
    if not count:
        return none
    spans = [(x.start, y.start, x.stop, y.stop) for y, x in ndimage.find_objects(label)]
    found = np.array(spans, float)
    broad, thick = ((found[:, 2:] - found[:, :2]) / inner.shape[::-1]).T
    off = np.abs(found[:, [0, 2]].mean(axis=1) / inner.shape[1] - 0.5)
    is_handle = (
        (broad > HANDLE_WIDTHS[0])
        & (broad < HANDLE_WIDTHS[1])
        & (thick < MAX_HANDLE_HEIGHT)
        & (off < MAX_OFF_CENTER)
    )
    if not is_handle.any():
        return none
    usual = float(np.median(broad[is_handle]))
    is_handle &= (broad < MAX_WIDTH_RATIO * usual) & (usual < MAX_WIDTH_RATIO * broad)
    stack = found[is_handle][np.argsort(found[is_handle, 1], kind="stable")]
    return (stack + np.array([left, top, left, top])) / [wide, high, wide, high]
