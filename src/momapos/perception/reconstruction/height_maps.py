"""Measure surfaces, and bars that protrude from them, in the height map of a face.

Areas are in meters from the face's lower left corner, x to the right and z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from momapos.model.records import FaceImage

if TYPE_CHECKING:
    from jaxtyping import Float

MIN_PIXELS = 12
"""Measured pixels needed for a median [-]."""
MAX_BAR_GAP = 0.06
"""Pieces of a bar are merged over smaller gaps [m]."""
MIN_FILLED = 0.3
"""Share of a merged bar that its pieces cover: specks in line are no bar [-]."""

EDGE_NOISE, EDGE_STEP = 0.015, 0.05
"""At the end of a face, where the surface beyond is outside of it, unmeasured or off by the second,
protrusions thinner than the first are noise or what the object stands on [m]."""


@dataclass(frozen=True)
class Area:
    """An upright rectangle in the frame of a face [m]."""

    left: float
    bottom: float
    right: float
    top: float

    @property
    def width(self) -> float:
        """Extent along x [m]."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """Extent along z [m]."""
        return self.top - self.bottom

    def turned(self) -> Area:
        """Return the area with x and z exchanged."""
        return Area(self.bottom, self.left, self.top, self.right)

    def within(self, other: Area, margin: float = 0.0) -> Area | None:
        """Return the part inside another area shrunk by a margin [m]; None if empty."""
        low_x, low_z = other.left + margin, other.bottom + margin
        high_x, high_z = other.right - margin, other.top - margin
        area = Area(
            max(self.left, low_x),
            max(self.bottom, low_z),
            min(self.right, high_x),
            min(self.top, high_z),
        )
        return area if area.width > 0 and area.height > 0 else None

    def share_in(self, other: Area) -> float:
        """Return the share of the area that lies inside another [-]."""
        inside = self.within(other)
        return 0.0 if inside is None else inside.width * inside.height / (self.width * self.height)

    def stands_on(self, other: Area) -> bool:
        """Check whether another area adjoins it from below."""
        beside = self.left < other.right and other.left < self.right
        return beside and other.top == self.bottom


def area_of(box: tuple[float, float, float, float], face: FaceImage) -> Area:
    """Return the area of a face given by (left, top, right, bottom) as fractions."""
    left, top, right, bottom = np.clip(box, 0.0, 1.0).tolist()
    (left, right), (top, bottom) = sorted((left, right)), sorted((top, bottom))
    w, h = face.width, face.height
    return Area(left * w, (1 - bottom) * h, right * w, (1 - top) * h)


def heights_in(face: FaceImage, area: Area, without: Area | None = None) -> Float[np.ndarray, " k"]:
    """Return the measured heights [m] inside an area, without those in another."""
    rows, columns = pixels(face, area)
    height_map = np.array(face.height_map[rows, columns], float)
    if without is not None:
        inner_rows, inner_columns = pixels(face, without)
        r, c = rows.start, columns.start
        height_map[
            max(inner_rows.start - r, 0) : max(inner_rows.stop - r, 0),
            max(inner_columns.start - c, 0) : max(inner_columns.stop - c, 0),
        ] = np.nan
    return height_map[np.isfinite(height_map)]


def pixels(face: FaceImage, area: Area) -> tuple[slice, slice]:
    """Return the rows and columns of an area; a pixel belongs to it if its center does."""
    h, w = face.height_map.shape
    x = np.array([area.left, area.right]) / face.width * w
    y = (1 - np.array([area.top, area.bottom]) / face.height) * h
    (left, right), (top, bottom) = (
        np.clip(np.round(v), 0, None).astype(int).tolist() for v in (x, y)
    )
    return slice(top, bottom), slice(left, right)


def bars(
    face: FaceImage, part: Area, out: float, least: float, thickest: float
) -> tuple[Area, ...]:
    """Return the bars that protrude from a part in the height map, the longest first.

    Args:
        face: The face.
        part: Where to search.
        out: Minimum protrusion [m].
        least: Minimum length [m]; bars are also at least twice as long as thick.
        thickest: Maximum thickness [m].
    """
    rows, columns = pixels(face, part)
    height_map = np.array(face.height_map[rows, columns], float)
    if np.isfinite(height_map).sum() < MIN_PIXELS:
        return ()
    plane = float(np.nanmedian(height_map))
    stands = height_map > plane + out  # NaN compares as false
    tall, wide = face.height / face.height_map.shape[0], face.width / face.height_map.shape[1]
    label, count = ndimage.label(stands, np.ones((3, 3)))
    pieces = [
        Area(
            (columns.start + across.start) * wide,
            face.height - (rows.start + down.stop) * tall,
            (columns.start + across.stop) * wide,
            face.height - (rows.start + down.start) * tall,
        )
        for down, across in ndimage.find_objects(label, count)
    ]
    turned = [piece.turned() for piece in pieces]
    found = [bar for bar in _merged(pieces, thickest) if bar.height > bar.width]
    found += [bar.turned() for bar in _merged(turned, thickest) if bar.height >= bar.width]
    sides = [sorted((area.width, area.height)) for area in found]
    bars = [
        (length, area)
        for (thick, length), area in zip(sides, found, strict=True)
        if length >= max(least, 2 * thick)
        and thick <= thickest
        and not (thick < EDGE_NOISE and _at_an_end(face, area, plane))
    ]
    return tuple(area for _, area in sorted(bars, key=lambda bar: -bar[0]))


def _at_an_end(face: FaceImage, bar: Area, plane: float) -> bool:
    """Check whether a face ends along a side of a bar: little beyond is near its plane [m]."""
    upright = bar.height > bar.width
    along = bar if upright else bar.turned()
    for left, right in (
        (along.left - EDGE_NOISE, along.left),
        (along.right, along.right + EDGE_NOISE),
    ):
        strip = Area(left, along.bottom, right, along.top)
        beyond = face.height_map[pixels(face, strip if upright else strip.turned())]
        whole = EDGE_NOISE * along.height * face.height_map.size / (face.width * face.height)
        if (np.abs(beyond - plane) < EDGE_STEP).sum() < 0.5 * whole:  # NaN compares as false
            return True
    return False


def _merged(pieces: Sequence[Area], thickest: float) -> list[Area]:
    """Merge pieces of upright bars that noise broke; other pieces stay as they are."""
    whole: list[tuple[Area, float]] = []
    for piece in sorted(pieces, key=lambda piece: piece.bottom):
        for k, (below, filled) in enumerate(whole):
            both = Area(
                min(piece.left, below.left),
                below.bottom,
                max(piece.right, below.right),
                max(piece.top, below.top),
            )
            beside = piece.left < below.right and below.left < piece.right
            near = beside and piece.bottom - below.top < MAX_BAR_GAP
            if near and both.width <= thickest:
                whole[k] = (both, filled + piece.height)
                break
        else:
            whole.append((piece, piece.height))
    return [area for area, filled in whole if filled > MIN_FILLED * area.height]


def is_flat(face: FaceImage, part: Area, handle: Area, least: float) -> bool:
    """Check whether a presumed handle was measured to be flatter [m]: a sign, label or lock."""
    inside = handle.within(part)
    out = None if inside is None else stands_out(face, part, inside)
    return out is not None and out < least


def stands_out(face: FaceImage, part: Area, handle: Area) -> float | None:
    """Return how far a handle protrudes beyond its surroundings on a part [m].

    Its rectangle contains some of the part behind it, so the upper quartile is used. None if too
    little was measured.
    """
    side = 0.02 + max(min(handle.width, handle.height), 0.0)
    around = Area(handle.left - side, handle.bottom - side, handle.right + side, handle.top + side)
    ring = around.within(part)
    assert ring is not None
    inside, beside = heights_in(face, handle), heights_in(face, ring, without=handle)
    if min(len(inside), len(beside)) < MIN_PIXELS:
        return None
    return float(np.percentile(inside, 75) - np.median(beside))
