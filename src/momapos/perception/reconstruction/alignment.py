"""Fit parts of a face, given as fractions of it, to each other in meters.

The inner line of a leaf's frame is as dark as a seam. The frame differs from a seam by its
symmetry: it has two sides, so its lines are equally far from the edges of the leaf.

Frame of a face: its origin is the lower left corner as seen from the front, x right, z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.core.geometry import dark_lines
from momapos.model.records import FaceImage, Part, PartKind

from .height_maps import MIN_PIXELS, Area, area_of, bars, heights_in, is_flat, pixels, stands_out

if TYPE_CHECKING:
    from jaxtyping import Float


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


BAR_LENGTH = 0.1
"""Minimum length of such a bar [m]."""
BAR_PROTRUSION = 0.03
"""If a detected handle is flat, a bar with this protrusion replaces it [m]."""
BAR_THICKNESS = 0.12
"""Maximum thickness of such a bar [m]."""
HANDLE_PROTRUSION = 0.04
"""Protrusion of a handle without measurement [m]."""
MIN_DRAWER_SIDE = 0.05
"""Minimum height of a drawer [m]."""
MIN_SIDE = 0.08
"""Minimum width and height of a door, and width of a drawer [m]."""
MAX_HEIGHT_MAP = 0.12
"""Maximum distance of a part's front from the face [m]."""
MERGE_DISTANCE = 0.015
"""Edges closer to each other, or to the rim of the face, are merged [m]."""
MAX_SHARED = 0.5
"""Of two parts that share this much of the smaller one, the less certain is dropped [-]."""
HANDLE_THICKNESS = (0.008, 0.035)
"""Minimum and maximum thickness of a handle, so that a gripper can hold it [m]."""
PROTRUSION_RANGE = (0.015, 0.12)
"""Measured protrusions below the first are ignored, above the second clipped [m]."""


@dataclass(frozen=True)
class AlignedHandle:
    """A handle on a part."""

    area: Area
    out: float
    """Protrusion of its front beyond the part's [m]."""
    measured: bool = True
    """Whether `out` was measured; else it is the default."""


@dataclass(frozen=True)
class AlignedPart:
    """A door or drawer with its place on a face."""

    kind: PartKind
    area: Area
    out: float
    """Protrusion of its front beyond the face's plane [m]."""
    handle: AlignedHandle | None
    odds: tuple[tuple[PartKind, float], ...] = ()
    """Probabilities of its kinds, see `Part`."""
    score: float = 1.0
    """Confidence, see `Part`."""


def align(
    face: FaceImage, parts: Sequence[Part], grid: int | None = None
) -> tuple[AlignedPart, ...]:
    """Fit the parts of a face to the face and to each other.

    In the result no parts overlap, edges that nearly meet do, and every handle lies on its part.

    Args:
        face: The face, with its size and height map.
        parts: The detected parts.
        grid: Grid steps across the face to which parts snap, 12 as in URDFormer; None: no grid.

    Returns:
        The parts, top to bottom and left to right, without small and duplicate ones.

    Raises:
        InputError: A rectangle is not finite.
    """
    for index, part in enumerate(parts):
        if not np.isfinite([*part.box, *(part.handle or ())]).all():
            raise InputError(
                f"part {index} of the front ({part.kind}): box and handle must be finite, "
                f"not {part.box}, {part.handle}"
            )
    if grid is not None:
        parts = [_snapped(part, grid) for part in parts]
    seen = sorted(parts, key=lambda part: -part.score)
    areas = _merged(_separated([area_of(part.box, face) for part in seen]), face)
    areas = with_frames(areas, face)
    aligned = [
        _aligned(face, part, area)
        for part, area in zip(seen, areas, strict=True)
        if area is not None and not _too_small(part.kind, area)
    ]
    return tuple(sorted(aligned, key=lambda part: (-part.area.top, part.area.left)))


def front_of(face: FaceImage, area: Area, most: float, without: Area | None = None) -> float:
    """Return the protrusion of a surface beyond the face, within +-`most` [m]; 0 if unknown."""
    height_map = heights_in(face, area, without)
    return (
        float(np.clip(np.median(height_map), -most, most)) if len(height_map) >= MIN_PIXELS else 0.0
    )


# ----------------------------------------------------------------------------- parts to each other


def _snapped(part: Part, steps: int) -> Part:
    """Snap a part to a grid, at least one step long, and move its handle along."""
    old = np.array(part.box).reshape(2, 2)  # (start or end, x or y)
    new = np.round(old * steps)
    new[0] = np.minimum(new[0], steps - 1)
    new[1] = np.maximum(new[1], new[0] + 1)
    new /= steps
    handle = None
    if part.handle is not None:
        share = (np.array(part.handle).reshape(2, 2) - old[0]) / np.maximum(old[1] - old[0], 1e-9)
        handle = tuple((new[0] + share * (new[1] - new[0])).ravel().tolist())
    return replace(part, box=tuple(new.ravel().tolist()), handle=handle)


def _separated(areas: Sequence[Area]) -> list[Area | None]:
    """Cut overlapping areas at the middle of their overlap; None for duplicates.

    Args:
        areas: The most certain first.
    """
    kept: list[Area | None] = []
    for area in areas:
        shared = [0.0 if a is None else _overlap(a, area) for a in kept]
        if max(shared, default=0.0) > MAX_SHARED:
            kept.append(None)
            continue
        for index, other in enumerate(kept):
            if other is not None and area.within(other) is not None:
                kept[index], area = _cut(other, area)
        kept.append(area)
    return kept


def _overlap(a: Area, b: Area) -> float:
    both = a.within(b)
    least = min(a.width * a.height, b.width * b.height)
    return 0.0 if both is None or least <= 0 else both.width * both.height / least


def _cut(a: Area, b: Area) -> tuple[Area, Area]:
    """Divide what two areas share, across the direction in which they overlap less."""
    both = a.within(b)
    assert both is not None
    if both.width / min(a.width, b.width) < both.height / min(a.height, b.height):
        middle = (both.left + both.right) / 2
        if a.left + a.right <= b.left + b.right:
            return replace(a, right=middle), replace(b, left=middle)
        return replace(a, left=middle), replace(b, right=middle)
    middle = (both.bottom + both.top) / 2
    if a.bottom + a.top <= b.bottom + b.top:
        return replace(a, top=middle), replace(b, bottom=middle)
    return replace(a, bottom=middle), replace(b, top=middle)


def _merged(areas: Sequence[Area | None], face: FaceImage) -> list[Area | None]:
    """Merge edges that are nearly equal; their order stays, so no new overlaps arise."""
    there = [area for area in areas if area is not None]
    x = np.array([[a.left, a.right] for a in there]).ravel()
    z = np.array([[a.bottom, a.top] for a in there]).ravel()
    x, z = _seams(x, face.width, MERGE_DISTANCE), _seams(z, face.height, MERGE_DISTANCE)
    merged = iter(np.column_stack([x[::2], z[::2], x[1::2], z[1::2]]).tolist())
    return [None if area is None else Area(*next(merged)) for area in areas]


def _seams(edges: Float[np.ndarray, " n"], size: float, near: float) -> Float[np.ndarray, " n"]:
    """Move edges [m] to the mean of those near them, or to the rim at 0 or `size` [m].

    No group spans more than `near`, so a chain of edges cannot collapse a part.
    """
    out = edges.copy()
    rim = np.where(edges < near, 0.0, np.where(edges > size - near, size, np.nan))
    out[np.isfinite(rim)] = rim[np.isfinite(rim)]
    order = np.argsort(edges, kind="stable")
    order = order[np.isnan(rim[order])]
    while len(order):
        group = edges[order] <= edges[order[0]] + near
        out[order[group]] = edges[order[group]].mean()
        order = order[~group]
    return out


def _too_small(kind: PartKind, area: Area) -> bool:
    least = MIN_DRAWER_SIDE if kind == "drawer" else MIN_SIDE
    return area.width < MIN_SIDE or area.height < least


# ----------------------------------------------------------------------------------- part by part


def _aligned(face: FaceImage, part: Part, area: Area) -> AlignedPart:
    seen = None if part.handle is None else area_of(part.handle, face)
    if seen is not None and is_flat(face, area, seen, PROTRUSION_RANGE[0]):
        found = bars(face, area, BAR_PROTRUSION, BAR_LENGTH, BAR_THICKNESS)
        seen = found[0] if found else seen
    out = front_of(face, area, MAX_HEIGHT_MAP, without=seen)
    handle = None if seen is None else _handle(face, area, seen, out)
    return AlignedPart(part.kind, area, out, handle, part.odds, part.score)


def _handle(face: FaceImage, part: Area, seen: Area, behind: float) -> AlignedHandle | None:
    """Return a handle with a place and a graspable size; None if it is not on the part."""
    thinnest, thickest = HANDLE_THICKNESS
    room = min(part.width, part.height) / 4
    inside = seen.within(part)
    if inside is None:
        return None
    width, height = inside.width, inside.height
    if width <= height:
        width = float(np.clip(width, thinnest, thickest))
        height = max(height, width)
    else:
        height = float(np.clip(height, thinnest, thickest))
        width = max(width, height)
    margin = min(thinnest, room)  # off the edges, so that it clears the neighbors
    out, measured = _standing_out(face, part, inside)
    x, z = _straight(face, inside, behind + out)
    left, right = _placed(x, width, part.left + margin, part.right - margin)
    bottom, top = _placed(z, height, part.bottom + margin, part.top - margin)
    return AlignedHandle(Area(left, bottom, right, top), out, measured)


def _straight(face: FaceImage, area: Area, out: float) -> tuple[float, float]:
    """Return the middle of a protruding area of a face without parallax [m]."""
    x, z = (area.left + area.right) / 2, (area.bottom + area.top) / 2
    if face.camera_position is None:
        return x, z
    camera_x, camera_z, away = (
        face.camera_position[0] + face.width / 2,
        face.camera_position[1] + face.height / 2,
        face.camera_position[2],
    )
    return x + (camera_x - x) * out / away, z + (camera_z - z) * out / away


def _placed(middle: float, size: float, low: float, high: float) -> tuple[float, float]:
    """Return a span about a middle, shifted and cut to stay within limits."""
    size = min(size, high - low)
    start = float(np.clip(middle - size / 2, low, high - size))
    return start, start + size


def _standing_out(face: FaceImage, part: Area, handle: Area) -> tuple[float, bool]:
    """Return the protrusion of a handle [m], and whether it was measured."""
    least, most = PROTRUSION_RANGE
    out = stands_out(face, part, handle)
    if out is None or out < least:
        return HANDLE_PROTRUSION, False
    return min(out, most), True
