"""Random fronts of furniture, and faces to see them on."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st

from momapos.model.records.scans import FaceImage, Part, PartKind
from momapos.perception.reconstruction.height_maps import Area

KINDS: tuple[PartKind, ...] = ("door_left", "door_right", "door_down", "door_up", "drawer")
SCALE = 400.0  # [1/m] pixels of a face


def face_of(width: float, height: float, height_map: float = np.nan) -> FaceImage:
    """Return a face of one color and height [m], unmeasured by default."""
    shape = (round(height * SCALE), round(width * SCALE))
    color = np.full((*shape, 3), 200, np.uint8)
    return FaceImage(color, np.full(shape, height_map, np.float32), width, height)


def raised(face: FaceImage, box: tuple[float, float, float, float], height_map: float) -> None:
    """Set the height map [m] of a rectangle (left, top, right, bottom) of a face, in fractions."""
    h, w = face.height_map.shape
    left, top, right, bottom = np.round(np.array(box) * [w, h, w, h]).astype(int)
    face.height_map[top:bottom, left:right] = height_map


def overlap(a: Area, b: Area) -> float:
    """Return the area that two rectangles share [m^2]."""
    x = min(a.right, b.right) - max(a.left, b.left)
    z = min(a.top, b.top) - max(a.bottom, b.bottom)
    return max(x, 0.0) * max(z, 0.0)


@st.composite
def any_parts(draw: Any) -> list[Part]:
    """Draw random parts, like those of a bad predictor."""
    number = st.floats(-0.2, 1.2)
    box = st.tuples(number, number, number, number)
    part = st.builds(Part, st.sampled_from(KINDS), box, st.floats(0, 1), handle=st.none() | box)
    return draw(st.lists(part, max_size=8))


@st.composite
def fronts(draw: Any) -> tuple[tuple[float, float, float], list[Part]]:
    """Draw width, depth, height [m] of furniture, and 1 to 8 disjoint parts."""
    size = (draw(st.floats(0.3, 1.2)), draw(st.floats(0.25, 0.8)), draw(st.floats(0.3, 2.0)))
    count = draw(st.integers(1, 8))
    cells = [(0.0, 0.0, size[0], size[2])]  # left, top, right, bottom [m]
    while len(cells) < count:
        left, top, right, bottom = cells.pop(0)
        wide, share = right - left >= bottom - top, draw(st.floats(0.35, 0.65))
        if max(right - left, bottom - top) * 0.35 < 0.15:
            cells.append((left, top, right, bottom))
            break
        if wide:
            x = left + share * (right - left)
            cells += [(left, top, x, bottom), (x, top, right, bottom)]
        else:
            z = top + share * (bottom - top)
            cells += [(left, top, right, z), (left, z, right, bottom)]
    return size, [_part(draw, cell, size) for cell in cells]


def _part(
    draw: Any, cell: tuple[float, float, float, float], size: tuple[float, float, float]
) -> Part:
    """Draw a part in a cell, with or without a frame and a handle."""
    frame = draw(st.sampled_from([0.0, 0.004, 0.02]))
    left, top, right, bottom = np.add(cell, (frame, frame, -frame, -frame))
    handle = None
    if draw(st.booleans()):
        x, z = draw(st.floats(0.05, 0.95)), draw(st.floats(0.05, 0.95))
        long, thick = draw(st.floats(0.02, 0.5)), draw(st.floats(0.005, 0.05))
        w, h = (long, thick) if draw(st.booleans()) else (thick, long)
        cx, cz = left + x * (right - left), top + z * (bottom - top)
        handle = _fractions((cx - w / 2, cz - h / 2, cx + w / 2, cz + h / 2), size)
    kind = draw(st.sampled_from(KINDS))
    return Part(kind, _fractions((left, top, right, bottom), size), 0.9, handle)


def _fractions(
    box: tuple[float, ...], size: tuple[float, float, float]
) -> tuple[float, float, float, float]:
    left, top, right, bottom = np.divide(box, [size[0], size[2], size[0], size[2]]).tolist()
    return left, top, right, bottom
