"""Doors beside each other whose seams nobody sees are taken to be equally wide."""

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
LEVEL = 0.05
"""Tops and bottoms of doors in one row differ by less than this share of the face's height [-]."""
MEET = 0.4
"""And they overlap, or are apart, by less than this share of the narrower one [-]."""
NEAR = 0.02
"""A seam is looked for this far from where it is believed [m]."""
RIM = 0.04
"""A door that begins nearer than this to the rim of its face begins there, unless a seam is seen
[m]."""
SEEN = 0.05
"""Contrast of a seam that is seen, as `dark_lines` tells it [-]."""
MOST = 0.3
"""No door gets wider or narrower than it was believed by more than this share [-]."""


def evened(face: FaceImage, parts: Sequence[Part]) -> tuple[Part, ...]:
    """Divide what doors beside each other take up evenly between the seams that are seen.

    Args:
        face: The face.
        parts: What is on it, whole.

    Returns:
        The same parts in the same order; only doors of a row that meet where no line is seen have
        other sides.
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
    """Indices of the doors that stand side by side, from left to right, of each row of several."""
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
    level = max(abs(a.box[1] - b.box[1]), abs(a.box[3] - b.box[3])) < LEVEL
    return level and abs(b.box[0] - a.box[2]) < MEET * min(_width(a), _width(b))


def _edges(
    face: FaceImage, doors: Sequence[Part], upright: Float32[np.ndarray, "h w"]
) -> dict[int, float]:
    """Where a row begins, where its doors meet as far as that is seen, and where it ends.

    Of what is next to the rim nothing shows but the door where no line is seen between them.
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
    """Where a line is seen near two places, over most of the height of two doors, or None."""
    h, w = upright.shape
    near = NEAR / face.width
    left, right = min(about) - near, max(about) + near
    start = max(int(left * w), 0)
    tops, bottoms = zip(*((door.box[1], door.box[3]) for door in doors), strict=True)
    rows = slice(int(max(tops) * h), int(min(bottoms) * h))
    lines = upright[rows, start : int(np.ceil(right * w)) + 1]
    if not lines.size:
        return None
    contrast = np.median(lines, axis=0)
    place = (start + int(contrast.argmax()) + 0.5) / w
    return place if contrast.max() > SEEN else None


def _between(door: Part, left: float, right: float) -> Part | None:
    """A door with other sides; None where it would change too much or lose its handle."""
    held = door.handle
    off = abs((right - left) / max(_width(door), 1e-9) - 1.0)
    if off > MOST or (held is not None and not left <= (held[0] + held[2]) / 2 <= right):
        return None
    return replace(door, box=(left, door.box[1], right, door.box[3]))


def _width(part: Part) -> float:
    return part.box[2] - part.box[0]
