"""Find handles as bars that protrude in the height map, and the parts that they belong to.

A thin bar in the color of its door is a pixel or two wide in the image, but well in front of the
door. Its place tells how the door opens. Two bars on one detected part mean that it is two parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from momapos.model.records import FaceImage, Part, PartKind

from . import decode
from .height_maps import MIN_PIXELS, Area, area_of, bars, heights_in, is_flat

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32


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


MIN_DOOR_SIDE = 0.2
"""Minimum side of a part with an upright handle; smaller ones are panels with buttons [m]."""
SCORE = 0.35
"""Confidence of a part found only by its handle [-]."""
MIN_FREE_EDGE_DISTANCE = 0.05
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
        part = _part_around(face, bar, free, longest)
        if part is not None:
            found.append(part)
    return tuple(found)


def _known(bar: Area, parts: Sequence[Part], face: FaceImage) -> bool:
    return any(bar.share_in(area_of(part.box, face)) > MIN_INSIDE for part in parts)


def _along_edge(bar: Area, face: FaceImage) -> bool:
    """Check whether a bar runs close to an edge of the face; its ends may be there."""
    if bar.height > bar.width:
        return min(bar.left, face.width - bar.right) < MIN_FREE_EDGE_DISTANCE
    return min(bar.bottom, face.height - bar.top) < MIN_FREE_EDGE_DISTANCE


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


def _part_around(
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
MAX_PITCH_DEVIATION = 0.2
"""Deviation of the distances from their median, relative to it [-]."""
DRAWER_HEIGHTS = (0.08, 0.5)
"""Height of a drawer [m]."""
MIN_MEASURED = 0.5
"""Share of a part with depth that is needed to find the end of its front [-]."""
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
        whole = area_of(_box_around(drawers) if drawers else part.box, face)
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


def _box_around(drawers: Sequence[Part]) -> tuple[float, float, float, float]:
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
