"""Give adjacent doors without visible seams equal widths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import dark_lines
from momapos.model.records import FaceImage, Part

if TYPE_CHECKING:
    from jaxtyping import Float32

DOORS = ("door_left", "door_right")
MAX_LEVEL_DIFFERENCE = 0.05
"""Tops and bottoms of doors in one row differ by less than this share of the face's height [-]."""
MAX_GAP = 0.4
"""Doors in a row overlap or are apart by less than this share of the narrower one [-]."""
SEARCH_RADIUS = 0.02
"""Seams are searched for this far from their predicted place [m]."""
RIM = 0.04
"""A door that starts closer to the rim of its face starts at the rim, unless a seam is visible
[m]."""
MIN_CONTRAST = 0.05
"""Contrast of a visible seam in `dark_lines` [-]."""
MAX_WIDTH_CHANGE = 0.3
"""No door changes its width by more than this share [-]."""


def equalize_doors(face: FaceImage, parts: Sequence[Part]) -> tuple[Part, ...]:
    """Divide rows of doors evenly between the visible seams.

    Args:
        face: The face.
        parts: All parts on it.

    Returns:
        The same parts in the same order. Only doors that meet without a visible seam change.
    """
    found, rows = list(parts), _rows(parts)
    upright = dark_lines(face.color, 1) if rows else np.zeros((0, 0), np.float32)
    for row in rows:
        doors = [parts[k] for k in row]
        edges = _edges(face, doors, upright)
        even = np.interp(np.arange(len(doors) + 1), list(edges), list(edges.values())).tolist()
        made = [_between(door, *span) for door, span in zip(doors, pairwise(even), strict=True)]
        if None not in made:
            for k, door in zip(row, made, strict=True):
                found[k] = door or found[k]
    return tuple(found)


def _rows(parts: Sequence[Part]) -> list[list[int]]:
    """Return the indices of the doors of each row, from left to right."""
    rows: list[list[int]] = []
    for k in sorted(range(len(parts)), key=lambda k: parts[k].box[0]):
        if parts[k].kind not in DOORS:
            continue
        for row in rows:
            if _side_by_side(parts[row[-1]], parts[k]):
                row.append(k)
                break
        else:
            rows.append([k])
    return [row for row in rows if len(row) > 1]


def _side_by_side(a: Part, b: Part) -> bool:
    level = max(abs(a.box[1] - b.box[1]), abs(a.box[3] - b.box[3])) < MAX_LEVEL_DIFFERENCE
    return level and abs(b.box[0] - a.box[2]) < MAX_GAP * min(_width(a), _width(b))


def _edges(
    face: FaceImage, doors: Sequence[Part], upright: Float32[np.ndarray, "h w"]
) -> dict[int, float]:
    """Return the visible seams of a row, and its start and end, by index.

    Without a visible seam, a door near the rim extends to the rim.
    """
    first, last = doors[0].box, doors[-1].box
    rim = RIM / face.width
    edges = [_seam(face, (a, b), (a.box[2], b.box[0]), upright) for a, b in pairwise(doors)]
    start, end = (
        _seam(face, (door, door), (edge, edge), upright)
        for door, edge in ((doors[0], first[0]), (doors[-1], last[2]))
    )
    begins = 0.0 if start is None and first[0] < rim else first[0]
    ends = 1.0 if end is None and last[2] > 1.0 - rim else last[2]
    known = [(0, begins), *enumerate(edges, start=1), (len(doors), ends)]
    return {k: edge for k, edge in known if edge is not None}


def _seam(
    face: FaceImage,
    doors: tuple[Part, Part],
    about: tuple[float, float],
    upright: Float32[np.ndarray, "h w"],
) -> float | None:
    """Find a line near two places over most of the height of two doors; None if there is none."""
    h, w = upright.shape
    near = SEARCH_RADIUS / face.width
    left, right = min(about) - near, max(about) + near
    start = max(int(left * w), 0)
    tops, bottoms = zip(*((door.box[1], door.box[3]) for door in doors), strict=True)
    rows = slice(int(max(tops) * h), int(min(bottoms) * h))
    lines = upright[rows, start : int(np.ceil(right * w)) + 1]
    if not lines.size:
        return None
    contrast = np.median(lines, axis=0)
    place = (start + int(contrast.argmax()) + 0.5) / w
    return place if contrast.max() > MIN_CONTRAST else None


def _between(door: Part, left: float, right: float) -> Part | None:
    """Return a door with other sides; None if it changes too much or loses its handle."""
    handle = door.handle
    off = abs((right - left) / max(_width(door), 1e-9) - 1.0)
    if off > MAX_WIDTH_CHANGE or (
        handle is not None and not left <= (handle[0] + handle[2]) / 2 <= right
    ):
        return None
    return replace(door, box=(left, door.box[1], right, door.box[3]))


def _width(part: Part) -> float:
    return part.box[2] - part.box[0]
