"""Check that a detected part shows what a door or drawer has: a handle, or a seam around it.

The networks see a door in many flat rectangles: the side of a box, a screen, a wall. A door or
drawer differs from them by its border. Where the surface beyond an edge of the part lies in the
same plane, a seam must separate the two. A front whose handle is visible needs no visible seam:
from across a room, a gap of 3 mm between red fronts is not in the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import FaceImage, Part

from .faces import PLANE_STEP, Face
from .front_view import FaceSurroundings
from .placed_parts import transferred

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


NEAR = 0.02
"""A bar lies within this of its detected box [m]."""
MIN_PROTRUSION, MIN_SIGMAS = 0.01, 3.0
"""A handle protrudes by the first [m] and this many standard deviations of the noise [-]."""
MIN_COLOR, MIN_COLOR_RATIO = 0.06, 2.5
"""Contrast of a knob with the front [-], and relative to the contrast within the front [-]."""
MIN_BAR, MIN_BAR_RATIO = 0.03, 3.0
"""Contrast of a bar with the front [-], and relative to other lines on it [-]."""
MAX_BEYOND = 0.6
"""Contrast of the line beyond the ends of a bar, relative to the bar: a seam goes on [-]."""
MAX_END_GAP = 6
"""Gap between the end of a bar and what is examined beyond it [px]."""
MIN_BAR_ASPECT = 2.0
"""A less elongated handle is a knob [-]."""
BAR_SIDE = 0.02
"""Distance from a bar to the surface that it is compared with [m]."""
MAX_HANDLE_THICKNESS = 0.06
"""A larger patch of another color is a sign or a window [m]."""
AROUND_HANDLE = 0.02
"""Width of the ring that a handle is compared with [m]."""
MIN_RING = 12
"""Pixels needed for a comparison [-]."""


def protrudes(image: FaceImage, part: Part) -> bool:
    """Check whether the handle of a part protrudes from it in the height map."""
    inside, ring = _handle_and_ring(image, part)
    heights = image.height_map
    bar, front = (heights[mask & np.isfinite(heights)] for mask in (inside, ring))
    if min(len(bar), len(front)) < MIN_RING:
        return False
    level = float(np.median(front))
    noise = 1.4826 * float(np.median(np.abs(front - level)))
    out = float(np.percentile(bar, 75)) - level
    return out > max(MIN_PROTRUSION, MIN_SIGMAS * noise)


def differs(images: Sequence[FaceImage], part: Part) -> bool:
    """Check whether the handle of a part is a bar or a knob of another color than the part.

    One image must show a bar. The contrast of a knob adds up over the images, as the root of the
    sum of squares: that a pale knob is there in each of them is no noise.
    """
    assert part.handle is not None
    left, top, right, bottom = part.handle
    wide, tall = (right - left) * images[0].width, (bottom - top) * images[0].height
    if min(wide, tall) > MAX_HANDLE_THICKNESS:
        return False
    if max(wide, tall) >= MIN_BAR_ASPECT * min(wide, tall):
        return any(_is_bar(image, part, upright=tall > wide) for image in images)
    return bool(np.linalg.norm([_knob_contrast(image, part) for image in images]) > MIN_COLOR)


def _knob_contrast(image: FaceImage, part: Part) -> float:
    """Return the contrast of a handle with its part; 0 if it is not above that within the part."""
    inside, ring = _handle_and_ring(image, part)
    if ring.sum() < MIN_RING or not inside.any():
        return 0.0
    color = image.color.astype(float) / 255
    off = np.abs(color - np.median(color[ring], axis=0)).mean(axis=-1)
    contrast, noise = (float(np.percentile(off[m], q)) for m, q in ((inside, 60), (ring, 75)))
    return contrast if contrast > MIN_COLOR_RATIO * noise else 0.0


def _is_bar(image: FaceImage, part: Part, *, upright: bool) -> bool:
    """Check for a thin line at a handle that is much clearer than other lines on its part.

    From across a room a bar is one or two pixels wide, and its box is off by as much.
    """
    assert part.handle is not None
    gray = image.color.mean(axis=-1, dtype=np.float32) / 255
    box, handle = np.array(part.box), np.array(part.handle)
    size = image.height
    if upright:
        gray, size = gray.T, image.width
        box, handle = box[[1, 0, 3, 2]], handle[[1, 0, 3, 2]]
    rows, columns = gray.shape
    pixel = size / rows
    left, right = np.rint(handle[[0, 2]] * columns).astype(int)
    trim = (right - left) // 8
    own = slice(left + trim, max(right - trim, left + trim + 1))
    away = max(3, round(BAR_SIDE / pixel))
    contrast = _thin(gray[:, own].mean(axis=1), away)
    place = (np.arange(rows)[away:-away] + 0.5) / rows
    near = NEAR / size
    low, high = max(handle[1] - near, box[1] + near / 2), min(handle[3] + near, box[3] - near / 2)
    there = np.flatnonzero((place > low) & (place < high))
    inner = (place > box[1] + 2 * near) & (place < box[3] - 2 * near)
    others = contrast[inner & ((place < handle[1] - 3 * near) | (place > handle[3] + 3 * near))]
    if len(others) < MIN_RING or not len(there):
        return False
    row = there[contrast[there].argmax()]
    ends = [
        abs(float(_thin(gray[:, beyond].mean(axis=1), away)[row]))
        for beyond in _beyond(np.rint(box[[0, 2]] * columns).astype(int), int(left), int(right))
    ]
    least = max(MIN_BAR, MIN_BAR_RATIO * float(np.percentile(others, 90)))
    return bool(contrast[row] > least and all(end < MAX_BEYOND * contrast[row] for end in ends))


def _thin(line: Float[np.ndarray, " n"], away: int) -> Float[np.ndarray, " m"]:
    """Return how much brighter or darker each pixel of a line is than both pixels next to it."""
    before, middle, after = line[: -2 * away], line[away:-away], line[2 * away :]
    return np.maximum(middle - np.maximum(before, after), np.minimum(before, after) - middle)


def _beyond(part: Int[np.ndarray, "2"], left: int, right: int) -> list[slice]:
    """Return the columns of a part to the left and right of its bar, if there are enough."""
    gap = min(max(2, (right - left) // 8), MAX_END_GAP)
    wide = max(right - left, 3 * gap)
    sides = (
        slice(max(int(part[0]) + gap, left - gap - wide), left - gap),
        slice(right + gap, min(int(part[1]) - gap, right + gap + wide)),
    )
    return [side for side in sides if side.stop - side.start >= gap]


def _handle_and_ring(
    image: FaceImage, part: Part
) -> tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Return the pixels of a part's handle, and those of the part around it."""
    shape = image.height_map.shape
    inside, ring, allowed = (np.zeros(shape, bool) for _ in range(3))
    assert part.handle is not None
    rows, columns = pixels_of(image, part.handle)
    inside[rows, columns] = True
    wide = round(AROUND_HANDLE / image.width * shape[1])
    tall = round(AROUND_HANDLE / image.height * shape[0])
    for mask, y, x in ((ring, max(tall, 3), max(wide, 3)), (allowed, 1, 1)):
        mask[
            max(rows.start - y, 0) : rows.stop + y, max(columns.start - x, 0) : columns.stop + x
        ] = True
    own = np.zeros(shape, bool)
    own[pixels_of(image, part.box)] = True
    return inside & own, ring & ~allowed & own


def pixels_of(image: FaceImage, box: tuple[float, float, float, float]) -> tuple[slice, slice]:
    """Return the rows and columns of a box, at least one of each."""
    tall, wide = image.height_map.shape
    left, top, right, bottom = np.rint(np.array(box) * np.tile((wide, tall), 2)).astype(int)
    top, left = min(max(int(top), 0), tall - 1), min(max(int(left), 0), wide - 1)
    return slice(top, max(int(bottom), top + 1)), slice(left, max(int(right), left + 1))


SEGMENTS = 8
"""An edge is examined in this many segments [-]."""
MIN_SEGMENTS = 0.67
"""A line must be visible in this share of the segments; objects in front hide the others [-]."""
MAX_DRIFT = 3
"""Between the ends of an edge, a line may drift by this [px]."""
ENDS = 0.1
"""Share of an edge that is ignored at each end, because of rounded corners [-]."""
SEARCH = 0.02
"""Distance from an edge within which its line is searched [m]."""
SIDE = 3
"""Distance from a line to the pixels that it is compared with [px]."""
DARK_OFFSET = 16.0
"""Offset of the brightness, so that noise in dark areas is not contrast [0 to 255]."""
BAND = (0.01, 0.04)
"""Distances from an edge between which the height of both sides is measured [m]."""
FLUSH = 0.04
"""Surfaces within this height of each other continue in one plane [m]."""
MIN_MEASURED = 0.3
"""Share of pixels with depth that is needed for a height [-]."""
MIN_DARK, MIN_STEP, MIN_RELIEF = 0.04, 0.06, 0.01
"""Least contrast of a seam with both sides [-], of a change of color [-], and height of a step [m].
On 40 parts of the development objects and 22 detections on the blank boxes of
`benchmarks/no_fronts.py`, seams of parts are above and plain surfaces are below, mostly at 0.00."""
MIN_NOISE_RATIO = 2.0
"""Height of a step relative to the noise of the heights on the part [-]."""
MAX_TILT = 8.0
"""A closed front is upright within this; leaning pictures and round boxes are not [deg]."""
MIN_PLANE_PIXELS = 30
"""Measured pixels needed to estimate a plane [-]."""
MAX_OUTLIER = 0.1
"""Heights farther from the median are no part of the plane [m]."""
MIN_FRONT_SCORE = 0.3
"""A face below this score needs a handle that protrudes [-]: screens have 0.18, fronts 0.47."""
SIMILAR = 0.15
"""Relative difference in size of neighbors that are supported together [-]."""
MIN_STACK = 3
"""Parts of one size with handles in line that support each other [-]."""
MIN_BARE_SIDE = 0.1
"""Least width and height of a part without a handle [m]; plinths and strips have seams, too."""
ADJACENT = 0.03
"""Distance of neighbors, and misalignment of their edges [m]."""


@dataclass(frozen=True)
class Border:
    """What is visible along one edge of a part."""

    flush: bool
    """Whether the surface continues in the same plane beyond it."""
    seam: bool
    """Whether a dark line or a step in height runs along it."""
    color: bool
    """Whether the color changes along it."""


def parts_with_evidence(
    parts: Sequence[Part], face: Face, around: FaceSurroundings, front_score: float
) -> tuple[Part, ...]:
    """Keep the parts that show a handle or a seam.

    Without a handle, a part needs a seam on at least one edge, and a seam or a change of color on
    every edge beyond which the surface continues. A part next to a supported one of the same size
    is supported, too, and so are stacked parts of one size with handles in line: chance does not
    space three lines evenly.

    Args:
        parts: Parts, as fractions of the face.
        face: The face.
        around: The face with its surroundings.
        front_score: Probability that the face is a front [-].
    """
    shown = transferred(parts, face, around.face)
    known = [_supported(part, around.images, front_score) for part in shown]
    known = [a or b for a, b in zip(known, _stacked(shown, around.face), strict=True)]
    similar = np.array([[_similar(a, b, around.face) for b in shown] for a in shown], bool)
    for _ in shown:  # support spreads by one neighbor at a time
        known = [sure or bool(similar[k][known].any()) for k, sure in enumerate(known)]
    return tuple(part for part, sure in zip(parts, known, strict=True) if sure)


def _supported(part: Part, images: Sequence[FaceImage], front_score: float) -> bool:
    image = images[0]
    if tilt(image, part.box) > MAX_TILT:
        return False
    if part.handle is not None:
        if protrudes(image, part):
            return True
        if front_score >= MIN_FRONT_SCORE and differs(images, part):
            return True
    left, top, right, bottom = part.box
    least = min((right - left) * image.width, (bottom - top) * image.height)
    if front_score < MIN_FRONT_SCORE or least < MIN_BARE_SIDE:
        return False
    edges = borders(images, part.box)
    flush = [edge for edge in edges if edge.flush]
    return any(edge.seam for edge in flush) and all(edge.seam or edge.color for edge in flush)


def _stacked(parts: Sequence[Part], face: Face) -> list[bool]:
    """Tell which parts are in a stack of parts of one size with handles in line."""
    size = np.tile((face.width, face.height), 2)
    boxes = np.array([part.box for part in parts]).reshape(-1, 4) * size
    grips = [np.full(4, np.nan) if p.handle is None else np.array(p.handle) for p in parts]
    middle = np.array(grips).reshape(-1, 4)[:, [0, 2]].mean(axis=1) * face.width
    high = boxes[:, 3] - boxes[:, 1]
    off = np.abs(boxes[:, None, [0, 2]] - boxes[:, [0, 2]]).max(axis=-1)
    same = off < ADJACENT
    same &= np.abs(high[:, None] - high) < SIMILAR * np.maximum(high[:, None], high)
    same &= np.abs(middle[:, None] - middle) < ADJACENT  # false without a handle
    return (same.sum(axis=1) >= MIN_STACK).tolist()


def _similar(one: Part, other: Part, face: Face) -> bool:
    """Check whether two parts have one size and lie next to or above each other."""
    a, b = (np.array(part.box) * np.tile((face.width, face.height), 2) for part in (one, other))
    sizes = a[2:] - a[:2], b[2:] - b[:2]
    if (np.abs(sizes[0] - sizes[1]) > SIMILAR * np.maximum(*sizes)).any():
        return False
    gap = np.maximum(a[:2] - b[2:], b[:2] - a[2:])
    aligned = np.abs(a[:2] - b[:2]) < ADJACENT
    return bool((aligned & (np.abs(gap[::-1]) < ADJACENT)).any())


# ------------------------------------------------------------------------------------------- edges


def borders(
    images: Sequence[FaceImage], box: tuple[float, float, float, float]
) -> tuple[Border, ...]:
    """Return what is visible along the left, top, right and bottom edge of a box."""
    each = np.array([[_edge(image, box, side) for side in range(4)] for image in images])
    dark, step, relief, flush = np.median(each, axis=0).T
    least = max(MIN_RELIEF, MIN_NOISE_RATIO * roughness(images[0], box))
    return tuple(
        Border(bool(f >= 0.5), bool(d >= MIN_DARK or h >= least), bool(s >= MIN_STEP))
        for d, s, h, f in zip(dark, step, relief, flush, strict=True)
    )


def _edge(
    image: FaceImage, box: tuple[float, float, float, float], side: int
) -> tuple[float, float, float, float]:
    """Measure one edge, turned so that the part is on its right.

    Returns:
        Contrast of a dark line, of a change of color [-], height of a step [m], and the share of
        the edge beyond which the surface continues in the same plane [-].
    """
    gray = image.color.mean(axis=-1, dtype=np.float32)
    gray[~image.color.any(axis=-1)] = np.nan  # not seen
    heights = image.height_map
    left, top, right, bottom = box
    edge, ends = ((left, top, 1 - right, 1 - bottom)[side], (top, bottom, left, right))
    low, high = ends[:2] if side % 2 == 0 else ends[2:]
    if side % 2:
        gray, heights = gray.T, heights.T
    if side >= 2:
        gray, heights = gray[:, ::-1], heights[:, ::-1]
    pixel = (image.width, image.height)[side % 2] / gray.shape[1]
    trim = ENDS * (high - low)
    first = int(np.clip((low + trim) * len(gray), 0, len(gray) - SEGMENTS))
    last = int(np.clip((high - trim) * len(gray), first + SEGMENTS, len(gray)))
    at = round(edge * gray.shape[1])
    dark, step = _lines(gray[first:last], at, max(SIDE + 1, round(SEARCH / pixel)))
    relief, flush = _relief(heights[first:last], at, pixel)
    return dark, step, relief, flush


def _lines(strip: Float[np.ndarray, "n w"], at: int, search: int) -> tuple[float, float]:
    """Return the contrast of the strongest dark line and of the strongest change of color."""
    reach = search + SIDE + 1
    columns = slice(max(at - reach, 0), min(at + reach + 1, strip.shape[1]))
    mean = np.stack([rows[:, columns].mean(axis=0) for rows in np.array_split(strip, SEGMENTS)])
    if mean.shape[1] < 2 * SIDE + 2:
        return 0.0, 0.0
    before, middle, after = mean[:, : -2 * SIDE], mean[:, SIDE:-SIDE], mean[:, 2 * SIDE :]
    next_to = np.minimum(before, after)
    dark = _along(np.nan_to_num((next_to - middle) / (next_to + DARK_OFFSET)))
    change = np.nan_to_num((after - before) / (np.maximum(after, before) + DARK_OFFSET))
    return dark, max(_along(change), _along(-change))


def _along(contrast: Float[np.ndarray, "s w"]) -> float:
    """Return the contrast that the best straight line has in most segments."""
    segments, width = contrast.shape
    rank = int((1 - MIN_SEGMENTS) * segments)
    best = 0.0
    for drift in range(-MAX_DRIFT, MAX_DRIFT + 1):
        shift = np.rint(np.linspace(0, drift, segments)).astype(int)
        start = np.arange(max(0, -drift), width - max(0, drift))
        values = contrast[np.arange(segments), start[:, None] + shift]
        if len(values):
            best = max(best, float(np.sort(values, axis=1)[:, rank].max()))
    return best


def _relief(heights: Float[np.ndarray, "n w"], at: int, pixel: float) -> tuple[float, float]:
    """Return the height of the step at an edge [m], and the share of it without a large one."""
    near, far = (max(1, round(distance / pixel)) for distance in BAND)
    inside = _medians(heights[:, max(at + near, 0) : max(at + far, 0)])
    outside = _medians(heights[:, max(at - far, 0) : max(at - near, 0)])
    step = np.abs(inside - outside)
    flush = step < FLUSH  # false where unmeasured
    return (float(np.median(step[flush])) if flush.any() else 0.0), float(flush.mean())


def _medians(strip: Float[np.ndarray, "n w"]) -> Float[np.ndarray, " s"]:
    """Return the median height of each segment; NaN where too little was measured."""
    found = np.full(SEGMENTS, np.nan)
    for k, rows in enumerate(np.array_split(strip, SEGMENTS)):
        known = rows[np.isfinite(rows)]
        if len(known) > MIN_MEASURED * rows.size:
            found[k] = np.median(known)
    return found


# ------------------------------------------------------------------------------------------- plane


def tilt(image: FaceImage, box: tuple[float, float, float, float]) -> float:
    """Return the angle between the surface in a box and the face [deg]; 0 if unmeasured."""
    return _plane(image, box)[0]


def roughness(image: FaceImage, box: tuple[float, float, float, float]) -> float:
    """Return the standard deviation of the heights in a box from their plane [m]; 0 if
    unmeasured."""
    return _plane(image, box)[1]


def _plane(image: FaceImage, box: tuple[float, float, float, float]) -> tuple[float, float]:
    """Return the tilt of the plane in a box [deg], and the deviation from it [m]."""
    rows, columns = pixels_of(image, box)
    heights = image.height_map[rows, columns][::PLANE_STEP, ::PLANE_STEP]
    y, x = np.nonzero(np.isfinite(heights))
    if len(y) < max(MIN_PLANE_PIXELS, MIN_MEASURED * heights.size):
        return 0.0, 0.0
    z = heights[y, x].astype(float)
    tall, wide = image.color.shape[:2]
    x, y = PLANE_STEP * x * image.width / wide, PLANE_STEP * y * image.height / tall
    A = np.column_stack([x, y, np.ones(len(x))])
    kept = np.abs(z - np.median(z)) < MAX_OUTLIER
    slope, noise = np.zeros(3), 0.0
    for _ in range(3):
        slope = np.linalg.lstsq(A[kept], z[kept], rcond=None)[0]
        error = np.abs(z - A @ slope)
        noise = 1.4826 * float(np.median(error))
        kept = error <= max(2.0 * noise, 0.005)
    return float(np.degrees(np.arctan(np.hypot(slope[0], slope[1])))), noise
