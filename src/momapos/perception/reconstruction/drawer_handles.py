"""Stacks of drawers whose gaps nobody sees, told by their handles: level lines, evenly spaced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from momapos.model.records import FaceImage, Part

from . import decode
from .free_bars import FLUSH, reach
from .height_maps import area_of

if TYPE_CHECKING:
    from jaxtyping import Float, Float32

FLAPS = ("door_down", "door_up")
"""What is never a stack: the racks behind an oven's window look like one."""
SEEN = 0.08
"""Contrast of a handle, as `dark_lines` tells it [-]."""
PLAIN = 0.9
"""Share of a front that is without any line, where handles can be told from its grain [-]."""
FEWEST = 3
"""Fewer lines are no stack [-]."""
BROAD = (0.08, 0.6)
"""Width of a handle as a share of its part [-]."""
ALIKE = 1.5
"""They differ in width from the usual one by less than this factor: else it is another line [-]."""
THIN = 0.04
"""And its height at most [-]."""
OFF = 0.1
"""Handles are this near to the middle of their drawer, as a share of its width [-]."""
EVEN = 0.2
"""Their distances differ by less, as a share of the usual one [-]."""
PITCH = (0.08, 0.5)
"""Height of a drawer [m]."""
MEASURED = 0.5
"""Share of a part that must have depth to tell how far its front goes on [-]."""
INSIDE = 0.5
"""What lies in a stack by more than this share is of it [-]."""
BELOW = 0.75
"""With more than this share of a drawer below the last handle, they are at the tops [-]."""


def into_drawers(
    face: FaceImage, parts: Sequence[Part], lines: Float32[np.ndarray, "h w"]
) -> tuple[Part, ...]:
    """Parts of which those that are a stack are the drawers of it.

    Where no gap is seen, what the networks take for a part may be all of a stack or any stretch of
    it. So handles are looked for above and below each part, as far as its front goes on.

    Args:
        face: The face.
        parts: What was taken for doors and drawers.
        lines: Level dark lines of the face.
    """
    left = sorted(parts, key=lambda part: -part.score)
    kept: list[Part] = []
    while left:
        part = left.pop(0)
        drawers = () if part.kind in FLAPS else _stack(face, part, lines)
        whole = area_of(_around(drawers) if drawers else part.box, face)
        if not drawers or area_of(part.box, face).share_in(whole) <= INSIDE:
            kept.append(part)
            continue
        inside = [other for other in left if area_of(other.box, face).share_in(whole) > INSIDE]
        left = [other for other in left if other not in inside]
        seen = [part, *inside]
        fronts = [area_of(one.box, face) for one in seen]
        handles = [area_of(drawer.handle or drawer.box, face) for drawer in drawers]
        fit = {sum(bar.share_in(front) > INSIDE for bar in handles) for front in fronts}
        kept += seen if len(seen) == len(drawers) and fit == {1} else drawers
    return tuple(kept)


def _stack(face: FaceImage, part: Part, lines: Float32[np.ndarray, "h w"]) -> tuple[Part, ...]:
    """The drawers of which a part is one, or some, or all; none where it is no stack."""
    box = _column(face, part)
    rows = _rows(lines, box)
    if len(rows) < FEWEST:
        return ()
    middle = rows[:, [1, 3]].mean(axis=1)
    pitch = float(np.median(np.diff(middle)))
    even = np.abs(np.diff(middle) - pitch).max() < EVEN * pitch
    if not (even and PITCH[0] < pitch * face.height < PITCH[1]):
        return ()
    at_top = box[3] - middle[-1] > BELOW * pitch
    edges = middle if at_top else middle - pitch / 2
    edges = np.clip(np.append(edges, edges[-1] + pitch), box[1], box[3])
    return tuple(
        replace(
            decode.told(part, "drawer"),
            box=(part.box[0], float(top), part.box[2], float(bottom)),
            handle=(float(x0), float(max(y0, top)), float(x1), float(y1)),
        )
        for top, bottom, (x0, y0, x1, y1) in zip(edges[:-1], edges[1:], rows, strict=True)
    )


def _around(drawers: Sequence[Part]) -> tuple[float, float, float, float]:
    """The rectangle of a stack, from its highest drawer to its lowest."""
    left, top, right, _ = drawers[0].box
    return left, top, right, drawers[-1].box[3]


def _column(face: FaceImage, part: Part) -> Float[np.ndarray, "4"]:
    """A part and what of its front is above and below it; the part itself without depth."""
    box = np.array(part.box)
    high, wide = face.height_map.shape
    left, top, right, bottom = np.rint(box * [wide, high, wide, high]).astype(int)
    own = face.height_map[top:bottom, left:right]
    if np.isfinite(own).mean() < MEASURED:
        return box
    column = face.height_map[:, left:right]
    free = column > np.nanmedian(own) - FLUSH  # not where nothing was measured
    middle = int(top + bottom) // 2
    highest, lowest = reach(free.mean(axis=1), (middle, middle))
    box[1], box[3] = min(box[1], highest / high), max(box[3], lowest / high)
    return box


def _rows(
    lines: Float32[np.ndarray, "h w"], box: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "n 4"]:
    """Handles in the middle of a part, top to bottom, as fractions of the face."""
    none = np.zeros((0, 4))
    high, wide = lines.shape
    left, top, right, bottom = np.rint(box * [wide, high, wide, high]).astype(int)
    inner = lines[top:bottom, left:right]
    if min(inner.shape, default=0) < 8 or (inner < SEEN).mean() < PLAIN:
        return none
    label, count = ndimage.label(inner > SEEN, np.ones((3, 3)))
    if not count:
        return none
    spans = [(x.start, y.start, x.stop, y.stop) for y, x in ndimage.find_objects(label)]
    found = np.array(spans, float)
    broad, thick = ((found[:, 2:] - found[:, :2]) / inner.shape[::-1]).T
    off = np.abs(found[:, [0, 2]].mean(axis=1) / inner.shape[1] - 0.5)
    grip = (broad > BROAD[0]) & (broad < BROAD[1]) & (thick < THIN) & (off < OFF)
    if not grip.any():
        return none
    usual = float(np.median(broad[grip]))
    grip &= (broad < ALIKE * usual) & (usual < ALIKE * broad)
    stack = found[grip][np.argsort(found[grip, 1], kind="stable")]
    return (stack + np.array([left, top, left, top])) / [wide, high, wide, high]
