"""Find handles as bars that protrude in the height map, where the networks missed them.

A thin bar in the color of its door is a pixel or two wide in the image, but well in front of the
door. Its place tells how the door opens. Two bars on one detected part mean that it is two parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import FaceImage, Part, PartKind

from . import decode
from .height_maps import MIN_PIXELS, Area, area_of, bars, heights_in, is_flat

if TYPE_CHECKING:
    from jaxtyping import Float32

MIN_PROTRUSION, MIN_SIGMAS = 0.02, 4.0
"""A bar protrudes by the first [m] and by this many standard deviations of the noise [-]."""
MIN_HANDLE_PROTRUSION = 0.01
"""Flatter surfaces are labels or recesses [m]."""
MIN_EDGE_DISTANCE = 0.01
"""A bar closer to an edge of a part may belong to its neighbor [m]."""
MIN_LENGTH, MAX_THICKNESS = 0.06, 0.06
"""Minimum length and maximum thickness of a bar [m]."""
SIDE = 1 / 3
"""A door opens at the edge next to which its handle lies, within this share of the door [-]."""
MIN_FLAP_HANDLE = 0.5
"""A level bar over more than this share of a door belongs to a flap [-]."""
FLAPS = ("door_down", "door_up")
"""Kinds with one handle: a second bar is a towel bar."""
MIN_DISTANCE = 0.06
"""Between handles of two parts side by side [m]."""
MAX_OFFSET, MIN_GAP = 0.03, 0.1
"""Handles of two parts end to end are in line within the first, with at least the second between
them [m]."""
MIN_COMMON = 0.5
"""Handles side by side overlap over this share of the shorter one [-]."""
MAX_LENGTH_RATIO = 1.6
"""Between handles of two similar parts [-]."""
MAX_END_DIFFERENCE = 0.02
"""Between the ends of level bars of two similar parts [m]."""
MIN_PART_SIDE = 0.12
"""Minimum side of a part that is found by its handle alone [m]."""
MIN_SEAM_CONTRAST = 0.1
"""Contrast of a seam between two handles in `dark_lines` [-]."""


def with_bar(face: FaceImage, part: Part) -> Part:
    """Add the bar that protrudes from a part, unless another handle protrudes.

    Args:
        face: The face with its height map.
        part: From the networks, which also take dark labels for handles.
    """
    found = handles_on(face, part)
    area = area_of(part.box, face)
    if part.handle is not None:
        if not found or not is_flat(face, area, area_of(part.handle, face), MIN_HANDLE_PROTRUSION):
            return part
        found = tuple(bar for bar in found if bar.within(area, MIN_EDGE_DISTANCE) == bar)
    if not found:
        return part
    kind = opening(part.kind, area, found[0])
    return replace(decode.with_kind(part, kind), handle=fractions(found[0], face))


def divided_by_bars(
    face: FaceImage,
    parts: Sequence[Part],
    upright: Float32[np.ndarray, "h w"],
    level: Float32[np.ndarray, "h w"],
) -> tuple[Part, ...]:
    """Divide parts with several similar handles, so that each part has one.

    They are divided at a visible seam between the handles. Otherwise, they are divided so that the
    two parts are most similar in size, with handles at the same or mirrored places.

    Args:
        face: The face with its height map.
        parts: From the networks.
        upright, level: Dark lines of the face.
    """
    return tuple(
        one
        for k, part in enumerate(parts)
        for one in _divided(face, part, [*parts[:k], *parts[k + 1 :]], upright, level)
    )


def handles_on(face: FaceImage, part: Part) -> tuple[Area, ...]:
    """Return the bars that protrude from a part well above the noise, the longest first."""
    area = area_of(part.box, face)
    height_map = heights_in(face, area)
    if len(height_map) < MIN_PIXELS:
        return ()
    noise = 1.4826 * float(np.median(np.abs(height_map - np.median(height_map))))
    return bars(face, area, max(MIN_PROTRUSION, MIN_SIGMAS * noise), MIN_LENGTH, MAX_THICKNESS)


def _divided(
    face: FaceImage,
    part: Part,
    others: Sequence[Part],
    upright_lines: Float32[np.ndarray, "h w"],
    level: Float32[np.ndarray, "h w"],
) -> tuple[Part, ...]:
    held = [area_of(other.handle, face) for other in others if other.handle is not None]
    own = [bar for bar in handles_on(face, part) if not any(bar.within(area) for area in held)]
    if not own:
        return (part,)
    tall = own[0].height > own[0].width
    for in_line in (False, True):
        alike, upright = _alike(own, in_line=in_line), tall != in_line
        if len(alike) < 2 or (part.kind in FLAPS and not have_aligned_ends(alike)):
            continue
        cuts = _cuts(face, part, alike, upright_lines if upright else level, upright=upright)
        if np.diff(cuts).min() >= MIN_PART_SIDE:
            return _pieces(face, part, alike, cuts, upright=upright)
    return (part,)


def _cuts(
    face: FaceImage,
    part: Part,
    handles: Sequence[Area],
    lines: Float32[np.ndarray, "h w"],
    *,
    upright: bool,
) -> list[float]:
    """Return the edges of the pieces of a part, from the left or from below [m].

    The edge is at a visible seam between two handles. Otherwise it follows from `_even`, or is the
    middle between handles that are end to end if `_even` cuts one of them.
    """
    area = area_of(part.box, face)
    edges = (area.left, area.right) if upright else (area.bottom, area.top)
    places = [_place(bar, upright=upright) for bar in handles]
    cuts = [edges[0], *_even(edges, places), edges[1]]
    for k, (one, other) in enumerate(pairwise(handles), start=1):
        between = _between(one, other, upright=upright)
        if not between[0] < cuts[k] < between[1]:
            cuts[k] = sum(between) / 2
        cuts[k] = _seam(face, area, between, lines, upright=upright) or cuts[k]
    return cuts


def _between(one: Area, other: Area, *, upright: bool) -> tuple[float, float]:
    """Return where a seam between two handles may be: between their ends if they are end to end,
    else between their middles [m]."""
    tall = one.height > one.width
    if tall == upright:
        return _place(one, upright=upright), _place(other, upright=upright)
    return _span(one, upright=tall)[1], _span(other, upright=tall)[0]


def _pieces(
    face: FaceImage, part: Part, handles: Sequence[Area], cuts: Sequence[float], *, upright: bool
) -> tuple[Part, ...]:
    area = area_of(part.box, face)
    found = []
    for bar, (low, high) in zip(handles, pairwise(cuts), strict=True):
        one = (
            replace(area, left=low, right=high) if upright else replace(area, bottom=low, top=high)
        )
        kind = opening(part.kind, one, bar)
        if bar.width > bar.height and one.width > one.height:
            kind = "drawer"
        box, handle = fractions(one, face), fractions(bar, face)
        found.append(replace(decode.with_kind(part, kind), box=box, handle=handle))
    return tuple(found)


def _place(bar: Area, *, upright: bool) -> float:
    """Return the x coordinate of an upright bar, or the z coordinate of a level one [m]."""
    return (bar.left + bar.right if upright else bar.bottom + bar.top) / 2


def _alike(found: Sequence[Area], *, in_line: bool) -> list[Area]:
    """Return the longest bar and those like it, as handles of adjacent parts.

    Args:
        found: Bars, the longest first.
        in_line: Whether to return bars end to end with it, as on a freezer door above a fridge
            door, instead of bars side by side with it.

    Returns:
        Bars from the left or from below.
    """
    upright = found[0].height > found[0].width
    kept: list[Area] = []
    for bar in found:
        if upright != (bar.height > bar.width):
            continue
        low, high = _span(bar, upright=upright)
        for other in kept:
            start, end = _span(other, upright=upright)
            lengths = sorted((high - low, end - start))
            off = abs(_place(bar, upright=upright) - _place(other, upright=upright))
            common = min(high, end) - max(low, start)
            there = (
                off < MAX_OFFSET and common < -MIN_GAP
                if in_line
                else off > MIN_DISTANCE and common > MIN_COMMON * lengths[0]
            )
            if not (there and lengths[1] < MAX_LENGTH_RATIO * lengths[0]):
                break
        else:
            kept.append(bar)
    return sorted(kept, key=lambda bar: _place(bar, upright=upright != in_line))


def have_aligned_ends(alike: Sequence[Area]) -> bool:
    """Check whether stacked level bars start and end alike; a towel bar differs from a handle."""
    ends = np.array([_span(bar, upright=False) for bar in alike])
    return alike[0].width > alike[0].height and bool(
        (np.ptp(ends, axis=0) < MAX_END_DIFFERENCE).all()
    )


def _span(bar: Area, *, upright: bool) -> tuple[float, float]:
    """Return the ends of an upright bar along z, or of a level one along x [m]."""
    return (bar.bottom, bar.top) if upright else (bar.left, bar.right)


def _even(edges: tuple[float, float], places: Sequence[float]) -> list[float]:
    """Return where to divide a span so that each piece has one handle.

    Equal pieces if possible; else one after the other, so that handles of adjacent pieces are at
    the same or mirrored places.
    """
    low, high = edges
    cuts = np.linspace(low, high, len(places) + 1)
    if (cuts[:-1] < places).all() and (places < cuts[1:]).all():
        return cuts[1:-1].tolist()
    uneven: list[float] = []
    for first, second in pairwise(places):
        start = uneven[-1] if uneven else low
        tries = ((first + second) / 2, second - (first - start), first + (high - second))
        between = np.array([cut for cut in tries if first < cut < second])
        uneven.append(float(between[np.abs(between - (start + high) / 2).argmin()]))
    return uneven


def _seam(
    face: FaceImage,
    area: Area,
    between: tuple[float, float],
    lines: Float32[np.ndarray, "h w"],
    *,
    upright: bool,
) -> float | None:
    """Return where a line is visible between two handles on most of a part [m]; None if nowhere."""
    rows, columns = lines.shape
    x = np.clip(np.array([area.left, area.right]) / face.width * columns, 0, columns).astype(int)
    y = np.clip((1 - np.array([area.top, area.bottom]) / face.height) * rows, 0, rows).astype(int)
    mean = np.median(lines[y[0] : y[1], x[0] : x[1]], axis=0 if upright else 1)
    if not upright:
        mean = mean[::-1]
    start, size = (
        (area.left, face.width / columns) if upright else (area.bottom, face.height / rows)
    )
    places = start + (np.arange(len(mean)) + 0.5) * size
    inner = (places > between[0] + MAX_THICKNESS / 2) & (places < between[1] - MAX_THICKNESS / 2)
    mean = np.where(inner, mean, 0.0)
    return float(places[mean.argmax()]) if mean.max(initial=0.0) > MIN_SEAM_CONTRAST else None


def fractions(area: Area, face: FaceImage) -> tuple[float, float, float, float]:
    """Return an area as (left, top, right, bottom) in fractions of the face."""
    return (
        area.left / face.width,
        1 - area.top / face.height,
        area.right / face.width,
        1 - area.bottom / face.height,
    )


def opening(kind: PartKind, part: Area, bar: Area) -> PartKind:
    """Return how a part with a bar opens; `kind` if the bar does not tell."""
    if bar.height > bar.width:
        from_left = ((bar.left + bar.right) / 2 - part.left) / part.width
        if from_left > 1 - SIDE:
            return "door_left"
        return "door_right" if from_left < SIDE else kind
    from_bottom = ((bar.bottom + bar.top) / 2 - part.bottom) / part.height
    if kind == "drawer" or bar.width < MIN_FLAP_HANDLE * part.width:
        return kind
    if from_bottom > 1 - SIDE:
        return "door_down"
    return "door_up" if from_bottom < SIDE else kind
