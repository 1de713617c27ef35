"""The frame around the panel of a leaf, of which one side was taken for a part of the body.

The inner line of such a frame is as dark as a seam. It is told from one by its twin: a frame has
two sides, so its lines lie equally far from the edges of the leaf.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from momapos.core.geometry import dark_lines
from momapos.model.records import FaceImage

from .height_maps import FEWEST, Area, heights_in, pixels

BROAD = 0.12
"""The side of a frame is narrower than this [m]."""
LEVEL = 0.008
"""And in the plane of its leaf, within this [m]."""
LINE = 0.1
"""Its inner line has this contrast, as `dark_lines` tells it [-]."""
TWIN = 0.5
"""And the one at the other side this share of it [-]."""
NEAR = 0.008
"""A line is looked for within this of its place [m]."""


def with_frames(areas: Sequence[Area | None], face: FaceImage) -> list[Area | None]:
    """Let parts go on to the left or right rim where what is between is the frame of their leaf.

    Only where the row of parts reaches the other rim: a body that shows on one side of its doors
    shows on the other one, too, and beside controls there is no twin.

    Args:
        areas: Where parts are; None for those that are left out.
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
    free = strip.width < BROAD and all(a.within(strip) is None for a in areas)
    whole = replace(area, left=min(area.left, strip.left), right=max(area.right, strip.right))
    framed = free and _level(face, area, strip) and _twins(face, whole, edge)
    return whole if framed else area


def _level(face: FaceImage, area: Area, strip: Area) -> bool:
    """Whether a strip lies in the plane of what is beside it."""
    heights = [heights_in(face, one) for one in (area, strip)]
    if min(map(len, heights)) < FEWEST:
        return False
    front, beside = (float(np.median(each)) for each in heights)
    return abs(front - beside) < LEVEL


def _twins(face: FaceImage, leaf: Area, edge: float) -> bool:
    """Whether the line at an edge within a leaf has one like it at the other side."""
    lines = dark_lines(face.color, across=1)

    def at(x: float) -> float:
        near = lines[pixels(face, replace(leaf, left=x - NEAR, right=x + NEAR))]
        return float(np.median(near, axis=0).max(initial=0.0)) if near.size else 0.0

    own = at(edge)
    return own > LINE and at(leaf.left + leaf.right - edge) > TWIN * own
