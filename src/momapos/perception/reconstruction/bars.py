"""Handles found as bars that stand out in the height map: what the networks did not see of them.

A thin bar in the color of its door is a pixel or two of the image, but it is well before the
door. Where it is tells how the door opens; two of them on what was taken for one part tell that
it is two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import FaceImage, Part, PartKind

from . import decode
from .height_maps import FEWEST, Area, area_of, bars, heights_in, is_flat

if TYPE_CHECKING:
    from jaxtyping import Float32

CLEAR, NOISES = 0.02, 4.0
"""A bar stands out by the first [m] and by this many standard deviations of the noise [-]."""
FLAT = 0.01
"""What stands out by less is a label or a recess [m]."""
OFF_EDGE = 0.01
"""And what lies nearer to an edge of a part than this may be what is beside it [m]."""
LEAST, THICKEST = 0.06, 0.06
"""It is at least so long and at most so thick [m]."""
SIDE = 1 / 3
"""A handle in this share of a door next to an edge says that it opens there [-]."""
BROAD = 0.5
"""A level bar over more than this share of a door is that of a flap [-]."""
FLAPS = ("door_down", "door_up")
"""What has one handle: what else stands out of it is a towel bar."""
APART = 0.06
"""Handles of two parts are at least this far from each other [m]."""
FLUSH, BETWEEN = 0.03, 0.1
"""Or they lie end to end, within the first, with more than the second between them [m]."""
BESIDE = 0.5
"""And lie side by side over this share of the shorter one [-]."""
ALIKE = 1.6
"""Handles of two like parts differ in length by less than this factor [-]."""
TWINS = 0.02
"""Level bars of two like parts begin and end at the same places, within this [m]."""
LEAST_PART = 0.12
"""A part that is told by its handle alone has sides of at least this [m]."""
SEAM = 0.1
"""Contrast of a seam between two handles, as `dark_lines` tells it [-]."""


def with_bar(face: FaceImage, part: Part) -> Part:
    """A part with the bar that stands out of it, if one does and no other handle does.

    Args:
        face: The face; its height map tells.
        part: As the networks saw it. They take a dark label for a handle, too.
    """
    found = handles_on(face, part)
    area = area_of(part.box, face)
    if part.handle is not None:
        if not found or not is_flat(face, area, area_of(part.handle, face), FLAT):
            return part
        found = tuple(bar for bar in found if bar.within(area, OFF_EDGE) == bar)
    if not found:
        return part
    kind = opening(part.kind, area, found[0])
    return replace(decode.told(part, kind), handle=fractions(found[0], face))


def by_bars(
    face: FaceImage,
    parts: Sequence[Part],
    upright: Float32[np.ndarray, "h w"],
    level: Float32[np.ndarray, "h w"],
) -> tuple[Part, ...]:
    """Parts of which each has one handle: those with two that are alike are divided between them.

    They are divided where a seam is seen between the handles; else where the two parts come out
    most alike in size with handles at the same or at mirrored places.

    Args:
        face: The face; its height map tells.
        parts: As the networks saw them.
        upright, level: Its dark lines.
    """
    return tuple(
        one
        for k, part in enumerate(parts)
        for one in _divided(face, part, [*parts[:k], *parts[k + 1 :]], upright, level)
    )


def handles_on(face: FaceImage, part: Part) -> tuple[Area, ...]:
    """The bars that stand out of a part well above the noise, the longest first."""
    area = area_of(part.box, face)
    height_map = heights_in(face, area)
    if len(height_map) < FEWEST:
        return ()
    noise = 1.4826 * float(np.median(np.abs(height_map - np.median(height_map))))
    return bars(face, area, max(CLEAR, NOISES * noise), LEAST, THICKEST)


def _divided(
    face: FaceImage,
    part: Part,
    others: Sequence[Part],
    upright_lines: Float32[np.ndarray, "h w"],
    level: Float32[np.ndarray, "h w"],
) -> tuple[Part, ...]:
    """A part, divided between its handles, from the left or from below."""
    held = [area_of(other.handle, face) for other in others if other.handle is not None]
    own = [bar for bar in handles_on(face, part) if not any(bar.within(area) for area in held)]
    if not own:
        return (part,)
    tall = own[0].height > own[0].width
    for in_line in (False, True):
        alike, upright = _alike(own, in_line=in_line), tall != in_line
        if len(alike) < 2 or (part.kind in FLAPS and not twins(alike)):
            continue
        cuts = _cuts(face, part, alike, upright_lines if upright else level, upright=upright)
        if np.diff(cuts).min() >= LEAST_PART:
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
    """Edges of the pieces of a part, each with one of the handles, from the left or from below [m].

    Where a seam is seen between two handles, it is there; else where `_even` says, or in the middle
    between handles end to end where that is beside one of them.
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
    """Where a seam between two handles may be: between their ends where they lie end to end, else
    between their middles [m]."""
    tall = one.height > one.width
    if tall == upright:
        return _place(one, upright=upright), _place(other, upright=upright)
    return _span(one, upright=tall)[1], _span(other, upright=tall)[0]


def _pieces(
    face: FaceImage, part: Part, handles: Sequence[Area], cuts: Sequence[float], *, upright: bool
) -> tuple[Part, ...]:
    """The pieces of a part between cuts, each with its handle."""
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
        found.append(replace(decode.told(part, kind), box=box, handle=handle))
    return tuple(found)


def _place(bar: Area, *, upright: bool) -> float:
    """Where an upright bar is along x, or a level one along z [m]."""
    return (bar.left + bar.right if upright else bar.bottom + bar.top) / 2


def _alike(found: Sequence[Area], *, in_line: bool) -> list[Area]:
    """The longest bar, and those that are like it, as the handles of other parts are.

    Args:
        found: Bars, the longest first.
        in_line: Those end to end with it, as of a freezer's door above a fridge's; else those side
            by side with it.

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
                off < FLUSH and common < -BETWEEN
                if in_line
                else off > APART and common > BESIDE * lengths[0]
            )
            if not (there and lengths[1] < ALIKE * lengths[0]):
                break
        else:
            kept.append(bar)
    return sorted(kept, key=lambda bar: _place(bar, upright=upright != in_line))


def twins(alike: Sequence[Area]) -> bool:
    """Whether level bars above each other begin and end alike: a towel bar is no second handle."""
    ends = np.array([_span(bar, upright=False) for bar in alike])
    return alike[0].width > alike[0].height and bool((np.ptp(ends, axis=0) < TWINS).all())


def _span(bar: Area, *, upright: bool) -> tuple[float, float]:
    """Ends of an upright bar along z, or of a level one along x [m]."""
    return (bar.bottom, bar.top) if upright else (bar.left, bar.right)


def _even(edges: tuple[float, float], places: Sequence[float]) -> list[float]:
    """Where to divide a span so that each part has one handle.

    In equal parts if that does it; else one after the other, each two with handles at the same or
    at mirrored places.
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
    """Where a line is seen between two handles on most of a part [m]; None where there is none."""
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
    inner = (places > between[0] + THICKEST / 2) & (places < between[1] - THICKEST / 2)
    mean = np.where(inner, mean, 0.0)
    return float(places[mean.argmax()]) if mean.max(initial=0.0) > SEAM else None


def fractions(area: Area, face: FaceImage) -> tuple[float, float, float, float]:
    """An area as (left, top, right, bottom) in fractions of the face."""
    return (
        area.left / face.width,
        1 - area.top / face.height,
        area.right / face.width,
        1 - area.bottom / face.height,
    )


def opening(kind: PartKind, part: Area, bar: Area) -> PartKind:
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
