"""Add parts that the networks missed, at handles that protrude where no part was detected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import FaceImage, Part, PartKind

from . import decode
from .bars import MIN_PART_SIDE, fractions, handles_on, have_aligned_ends, opening
from .height_maps import Area, area_of

if TYPE_CHECKING:
    from jaxtyping import Bool

MIN_DOOR_SIDE = 0.2
"""Minimum side of a part with an upright handle; smaller ones are panels with buttons [m]."""
SCORE = 0.35
"""Confidence of a part found only by its handle [-]."""
MIN_EDGE_DISTANCE = 0.05
"""A bar along an edge of the face closer than this may be a worktop or a neighbor [m]."""
MAX_FRONT_DEPTH = 0.02
"""A front lies in one plane within this [m]."""
MAX_BLOCKED = 0.2
"""A front ends at a row or column of pixels with more than this share outside of it [-]."""
MAX_OFF_CENTER = 0.1
"""Distance of a level handle from the middle of its part, relative to its width [-]."""
MAX_HANDLE_LENGTH = 0.8
"""Length of a handle relative to its part. Longer bars are boards and rails, unless a known part
has a similar one [-]."""
MIN_INSIDE = 0.5
"""A bar belongs to a part that contains more than this share of it [-]."""


def parts_from_bars(face: FaceImage, parts: Sequence[Part]) -> tuple[Part, ...]:
    """Find parts at bars that protrude from a front outside the known parts.

    Each extends from its bar as far as the front is flat and free of parts.
    `bars.divided_by_bars` divides those with several bars.

    Args:
        face: The face with its height map.
        parts: Parts from the networks.

    Returns:
        The missing parts, each with one handle.
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
        longest = (
            1.0 if any(have_aligned_ends((bar, other)) for other in held) else MAX_HANDLE_LENGTH
        )
        part = _around(face, bar, free, longest)
        if part is not None:
            found.append(part)
    return tuple(found)


def _known(bar: Area, parts: Sequence[Part], face: FaceImage) -> bool:
    return any(bar.share_in(area_of(part.box, face)) > MIN_INSIDE for part in parts)


def _along_edge(bar: Area, face: FaceImage) -> bool:
    """Check whether a bar runs close to an edge of the face; its ends may be there."""
    if bar.height > bar.width:
        return min(bar.left, face.width - bar.right) < MIN_EDGE_DISTANCE
    return min(bar.bottom, face.height - bar.top) < MIN_EDGE_DISTANCE


def _free(face: FaceImage, parts: Sequence[Part]) -> Bool[np.ndarray, "h w"]:
    """Tell which pixels are in or in front of the plane of the front, and in no part."""
    height_map = np.where(np.isfinite(face.height_map), face.height_map, 0.0)
    known = face.height_map[np.isfinite(face.height_map)]
    free = height_map > float(np.median(known)) - MAX_FRONT_DEPTH
    h, w = free.shape
    for part in parts:
        left, top, right, bottom = np.round(np.array(part.box) * [w, h, w, h]).astype(int)
        free[top:bottom, left:right] = False
    return free


def _around(
    face: FaceImage, bar: Area, free: Bool[np.ndarray, "h w"], longest: float
) -> Part | None:
    """Return the largest free rectangle around a bar as a part; None if it is too small, or the bar
    is longer than a share of it."""
    h, w = free.shape
    x = np.array([bar.left, bar.right]) / face.width * w
    y = (1 - np.array([bar.top, bar.bottom]) / face.height) * h
    rows = (int(np.clip(y[0], 0, h - 1)), int(np.clip(np.ceil(y[1]), 1, h)))
    columns = (int(np.clip(x[0], 0, w - 1)), int(np.clip(np.ceil(x[1]), 1, w)))
    free = free.copy()
    free[slice(*rows), slice(*columns)] = True  # even if a known part covers some of the bar
    wide = reach(free[slice(*rows)].mean(axis=0), columns)
    high = reach(free[:, slice(*columns)].mean(axis=1), rows)
    first = (wide, reach(free[:, slice(*wide)].mean(axis=1), rows))
    second = (reach(free[slice(*high)].mean(axis=0), columns), high)
    across, down = max(first, second, key=lambda pair: np.ptp(pair[0]) * np.ptp(pair[1]))
    box = (across[0] / w, down[0] / h, across[1] / w, down[1] / h)
    area = area_of(box, face)
    level = bar.width > bar.height
    share = bar.width / area.width if level else bar.height / area.height
    least = MIN_PART_SIDE if level else MIN_DOOR_SIDE
    if min(area.width, area.height) < least or share > longest:
        return None
    off = abs(bar.left + bar.right - area.left - area.right) / 2
    if level and off > MAX_OFF_CENTER * area.width:
        return None
    kind: PartKind = "drawer" if level and area.width > area.height else "door_left"
    odds = tuple((one, 1.0 / len(decode.KINDS)) for one in decode.KINDS)
    said = Part(kind, box, SCORE, None, odds)
    return replace(decode.with_kind(said, opening(kind, area, bar)), handle=fractions(bar, face))


def reach(share: np.ndarray, start: tuple[int, int]) -> tuple[int, int]:
    """Extend a stretch of pixels until too few of a row or column are free."""
    blocked = np.flatnonzero(share < 1.0 - MAX_BLOCKED)
    before, behind = blocked[blocked < start[0]], blocked[blocked >= start[1]]
    return (
        int(before[-1]) + 1 if len(before) else 0,
        int(behind[0]) if len(behind) else len(share),
    )
