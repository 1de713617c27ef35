"""Parts that the networks miss, told by a handle that stands out of the front where no part is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import FaceImage, Part, PartKind

from . import decode
from .bars import LEAST_PART, fractions, handles_on, opening, twins
from .height_maps import Area, area_of

if TYPE_CHECKING:
    from jaxtyping import Bool

LEAST_DOOR = 0.2
"""Sides of a part with an upright handle are at least this, or it is a panel with buttons [m]."""
SCORE = 0.35
"""How sure a part is that only its handle tells [-]."""
EDGE = 0.05
"""What stands out along an edge of the face, this near to it, may be a worktop, or belong to what
is beside it [m]."""
FLUSH = 0.02
"""A front lies in one plane, within this [m]."""
HIDDEN = 0.2
"""A row or column of pixels ends a front where more than this share of it is none [-]."""
CENTERED = 0.1
"""A level handle is in the middle of its part, within this share of its width [-]."""
LONGEST = 0.8
"""Handles are shorter than this share of their part: longer ones are boards and rails, but where a
part is known that has one like it [-]."""
MOSTLY = 0.5
"""A bar belongs to a part that holds more than this share of it [-]."""


def told_by_bars(face: FaceImage, parts: Sequence[Part]) -> tuple[Part, ...]:
    """What of a front is free of parts and has bars standing out of it: a part, or some.

    Each reaches from its bar as far as the front is flat and no part is. `bars.by_bars` divides
    those with several.

    Args:
        face: The face; its height map tells.
        parts: What the networks saw on it.

    Returns:
        The parts that they did not see, each with one handle.
    """
    whole = Part("drawer", (0.0, 0.0, 1.0, 1.0), SCORE)
    bars = handles_on(face, whole)
    held = [bar for bar in bars if _known(bar, parts, face)]
    others = [bar for bar in bars if bar not in held and not _along_edge(bar, face)]
    if not others:
        return ()
    free = _free(face, parts)
    found: list[Part] = []
    for bar in others:
        if _known(bar, found, face):
            continue
        longest = 1.0 if any(twins((bar, other)) for other in held) else LONGEST
        part = _around(face, bar, free, longest)
        if part is not None:
            found.append(part)
    return tuple(found)


def _known(bar: Area, parts: Sequence[Part], face: FaceImage) -> bool:
    """Whether a bar belongs to one of some parts."""
    return any(bar.share_in(area_of(part.box, face)) > MOSTLY for part in parts)


def _along_edge(bar: Area, face: FaceImage) -> bool:
    """Whether a bar runs along an edge of the face, near to it; the ends of others may be there."""
    if bar.height > bar.width:
        return min(bar.left, face.width - bar.right) < EDGE
    return min(bar.bottom, face.height - bar.top) < EDGE


def _free(face: FaceImage, parts: Sequence[Part]) -> Bool[np.ndarray, "h w"]:
    """Pixels of the plane of the front, or before it, that belong to no part."""
    height_map = np.where(np.isfinite(face.height_map), face.height_map, 0.0)
    known = face.height_map[np.isfinite(face.height_map)]
    free = height_map > float(np.median(known)) - FLUSH
    h, w = free.shape
    for part in parts:
        left, top, right, bottom = np.round(np.array(part.box) * [w, h, w, h]).astype(int)
        free[top:bottom, left:right] = False
    return free


def _around(
    face: FaceImage, bar: Area, free: Bool[np.ndarray, "h w"], longest: float
) -> Part | None:
    """The largest free rectangle about a bar, None where it is too small for a part with it, or
    the bar is longer than a share of it."""
    h, w = free.shape
    x = np.array([bar.left, bar.right]) / face.width * w
    y = (1 - np.array([bar.top, bar.bottom]) / face.height) * h
    rows = (int(np.clip(y[0], 0, h - 1)), int(np.clip(np.ceil(y[1]), 1, h)))
    columns = (int(np.clip(x[0], 0, w - 1)), int(np.clip(np.ceil(x[1]), 1, w)))
    free = free.copy()
    free[slice(*rows), slice(*columns)] = True  # though a known part may reach over some of the bar
    wide = reach(free[slice(*rows)].mean(axis=0), columns)
    high = reach(free[:, slice(*columns)].mean(axis=1), rows)
    first = (wide, reach(free[:, slice(*wide)].mean(axis=1), rows))
    second = (reach(free[slice(*high)].mean(axis=0), columns), high)
    across, down = max(first, second, key=lambda pair: np.ptp(pair[0]) * np.ptp(pair[1]))
    box = (across[0] / w, down[0] / h, across[1] / w, down[1] / h)
    area = area_of(box, face)
    level = bar.width > bar.height
    share = bar.width / area.width if level else bar.height / area.height
    least = LEAST_PART if level else LEAST_DOOR
    if min(area.width, area.height) < least or share > longest:
        return None
    off = abs(bar.left + bar.right - area.left - area.right) / 2
    if level and off > CENTERED * area.width:
        return None
    kind: PartKind = "drawer" if level and area.width > area.height else "door_left"
    odds = tuple((one, 1.0 / len(decode.KINDS)) for one in decode.KINDS)
    said = Part(kind, box, SCORE, None, odds)
    return replace(decode.told(said, opening(kind, area, bar)), handle=fractions(bar, face))


def reach(share: np.ndarray, start: tuple[int, int]) -> tuple[int, int]:
    """How far a stretch of pixels can be widened until too few of a row or column are free."""
    blocked = np.flatnonzero(share < 1.0 - HIDDEN)
    before, behind = blocked[blocked < start[0]], blocked[blocked >= start[1]]
    return (
        int(before[-1]) + 1 if len(before) else 0,
        int(behind[0]) if len(behind) else len(share),
    )
