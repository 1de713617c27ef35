"""Handles that the networks did not see, found as bars that stand out in the height map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from momapos.reconstruction.height_maps import FEWEST, Area, area_of, heights_in, longest_bar
from momapos.types import FaceImage, Part, PartKind

CLEAR, NOISES = 0.02, 4.0
"""A bar stands out by the first [m] and by this many standard deviations of the noise [-]."""
LEAST, THICKEST = 0.06, 0.06
"""It is at least so long and at most so thick [m]."""
SIDE = 1 / 3
"""A handle in this share of a door next to an edge says that it opens there [-]."""
BROAD = 0.5
"""A level bar over more than this share of a door is that of a flap [-]."""


def with_bar(face: FaceImage, part: Part) -> Part:
    """A part that has no handle, with the bar that stands out of it, if one does.

    A thin bar in the color of its door is a pixel or two of the image, but it is well before
    the door. Where it is tells how the door opens.

    Args:
        face: The face; its height map tells.
        part: As the networks saw it.
    """
    if part.handle is not None:
        return part
    area = area_of(part.box, face)
    height_map = heights_in(face, area)
    if len(height_map) < FEWEST:
        return part
    noise = 1.4826 * float(np.median(np.abs(height_map - np.median(height_map))))
    bar = longest_bar(face, area, max(CLEAR, NOISES * noise), LEAST, THICKEST)
    if bar is None:
        return part
    handle = (
        bar.left / face.width,
        1 - bar.top / face.height,
        bar.right / face.width,
        1 - bar.bottom / face.height,
    )
    return replace(part, kind=_opening(part.kind, area, bar), handle=handle)


def _opening(kind: PartKind, part: Area, bar: Area) -> PartKind:
    """How a part with a bar opens; as was thought where the bar does not tell."""
    if bar.height > bar.width:
        from_left = ((bar.left + bar.right) / 2 - part.left) / part.width
        if from_left > 1 - SIDE:
            return "door_left"
        return "door_right" if from_left < SIDE else kind
    from_bottom = ((bar.bottom + bar.top) / 2 - part.bottom) / part.height
    if kind == "drawer" or bar.width < BROAD * part.width:
        return kind
    if from_bottom > 1 - SIDE:
        return "door_down"
    return "door_up" if from_bottom < SIDE else kind
