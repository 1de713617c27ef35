"""Extend parts over the frame of a door leaf when one of its sides was taken for the body.

The inner line of such a frame is as dark as a seam. A frame differs from a seam by its symmetry: it
has two sides, so its lines are equally far from the edges of the leaf.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from momapos.core.geometry import dark_lines
from momapos.model.records import FaceImage

from .height_maps import MIN_PIXELS, Area, heights_in, pixels

MAX_FRAME_WIDTH = 0.12
"""Width of one side of a frame [m]."""
MAX_LEVEL_DIFFERENCE = 0.008
"""A frame is coplanar with its leaf within this [m]."""
MIN_CONTRAST = 0.1
"""Contrast of the inner line of a frame in `dark_lines` [-]."""
MIN_RELATIVE_CONTRAST = 0.5
"""Contrast of the line on the other side, relative to it [-]."""
SEARCH_RADIUS = 0.008
"""A line is searched within this of its place [m]."""


def with_frames(areas: Sequence[Area | None], face: FaceImage) -> list[Area | None]:
    """Extend parts to the left or right rim where the space between is the frame of their leaf.

    The row of parts must reach the other rim: a body that shows on one side of its doors also shows
    on the other, and controls have no symmetric line.

    Args:
        areas: Areas of the parts; None for dropped parts.
        face: The face, with its size, image and height map.
    """
    there = [area for area in areas if area is not None]
    return [None if area is None else _with_frame(area, there, face) for area in areas]


def _with_frame(area: Area, areas: Sequence[Area], face: FaceImage) -> Area:
    row = [a for a in areas if min(a.top, area.top) - max(a.bottom, area.bottom) >= area.height / 2]
    from_left, from_right = min(a.left for a in row), face.width - max(a.right for a in row)
    if from_left == 0.0 and area.right < face.width:
        strip, edge = replace(area, left=area.right, right=face.width), area.right
    elif from_right == 0.0 and area.left > 0.0:
        strip, edge = replace(area, left=0.0, right=area.left), area.left
    else:
        return area
    free = strip.width < MAX_FRAME_WIDTH and all(a.within(strip) is None for a in areas)
    whole = replace(area, left=min(area.left, strip.left), right=max(area.right, strip.right))
    framed = free and _level(face, area, strip) and _is_symmetric(face, whole, edge)
    return whole if framed else area


def _level(face: FaceImage, area: Area, strip: Area) -> bool:
    """Check whether a strip is coplanar with the area next to it."""
    heights = [heights_in(face, one) for one in (area, strip)]
    if min(map(len, heights)) < MIN_PIXELS:
        return False
    front, beside = (float(np.median(each)) for each in heights)
    return abs(front - beside) < MAX_LEVEL_DIFFERENCE


def _is_symmetric(face: FaceImage, leaf: Area, edge: float) -> bool:
    """Check whether a leaf has lines at an edge and at the mirrored place."""
    lines = dark_lines(face.color, across=1)

    def at(x: float) -> float:
        near = lines[pixels(face, replace(leaf, left=x - SEARCH_RADIUS, right=x + SEARCH_RADIUS))]
        return float(np.median(near, axis=0).max(initial=0.0)) if near.size else 0.0

    own = at(edge)
    return own > MIN_CONTRAST and at(leaf.left + leaf.right - edge) > MIN_RELATIVE_CONTRAST * own
