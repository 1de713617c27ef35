"""Split a row of cabinets and appliances between its fronts.

Points alone do not separate cabinets: fronts lie in one plane, and the gaps between them are
thinner than a depth camera resolves. The images show the doors, and a row can be cut wherever no
door crosses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import UprightBox, apply
from momapos.model.records import Frame, Part

from .faces import Face, box_faces, camera_position_of, face_image
from .front_view import (
    MAX_MERGED,
    MIN_FRONT_PROBABILITY,
    FaceViews,
    FrontDetector,
    KnownFront,
    choose_frames,
    equalize_doors,
    front_evidence,
)
from .placed_parts import most_confident, projection, shift_handles, transferred

if TYPE_CHECKING:
    from jaxtyping import Float

COARSE_PIXELS = 96
"""Resolution at which a window is checked for flatness: a table is open [px]."""
MIN_PIECE = 0.2
"""A narrower stretch without parts belongs to its neighbor [m]."""
MIN_WIDTH = 0.95
"""Narrower boxes are not split [m]."""
MIN_WINDOW = 1.3
"""Minimum window width, since drawers of low rows are as wide as those of high ones [m]."""
WINDOW_RATIO = 1.5
"""Width of the windows in which a face is examined, in heights of the row [-]."""
END_MARGIN = 0.03
"""Parts that end this close to a window's end may continue beyond it [m]."""


def split_row(
    box: UprightBox,
    frames: Sequence[Frame],
    look: FrontDetector,
) -> tuple[list[UprightBox], KnownFront | None]:
    """Split a box between the fronts on its longer faces.

    Args:
        box: The row.
        frames: All images.
        look: Finds the parts on a face.

    Returns:
        The pieces from left to right as seen from the front, or the box itself if it is not split;
        and the front with its parts, None if there is none or if an image of the whole box shows it
        as well.
    """
    wide = [face for face in box_faces(box) if face.width >= MIN_WIDTH]
    fronts = [_front_of(face, frames, look) for face in wide]
    best = max(fronts, key=lambda front: sum(part.score for part in front.parts), default=None)
    if best is None or not best.parts:
        return [box], None
    cuts = _cuts(best.parts, best.face.width)
    if not cuts:
        return [box], None if _window_width(best.face) == best.face.width else best
    return _pieces(box, best.face, cuts), best


def _window_width(face: Face) -> float:
    """Return the width of the windows in which a face is examined [m]."""
    return min(face.width, max(WINDOW_RATIO * face.height, MIN_WINDOW))


def _front_of(face: Face, frames: Sequence[Frame], look: FrontDetector) -> KnownFront:
    """Find the parts on a long face in overlapping windows."""
    wide = _window_width(face)
    count = max(1, int(np.ceil(2 * (face.width - wide) / wide)) + 1)
    found: list[Part] = []
    evidence = [0.0]
    for left in np.linspace(0.0, face.width - wide, count):
        window = _window(face, float(left), wide)
        chosen = _frames_for(window, frames)
        if not chosen:
            continue
        front = FaceViews(window, chosen, range(len(chosen))).look(0, look, MIN_FRONT_PROBABILITY)
        likely = front_evidence(front, face_image(window, chosen, pixels=COARSE_PIXELS))
        if likely >= MIN_FRONT_PROBABILITY:
            ends = (
                bool(left > END_MARGIN), bool(left + wide < face.width - END_MARGIN)
            )  # fmt: skip
            whole = _whole(front.parts, wide, ends, END_MARGIN)
            whole = equalize_doors(face_image(window, chosen), whole)
            whole = shift_handles(whole, window, camera_position_of(window, chosen[0]), undo=True)
            found += transferred(whole, window, face)
            evidence.append(likely)
    return KnownFront(face, max(evidence), most_confident(found))


def _window(face: Face, left: float, wide: float) -> Face:
    T = face.T_world_face.copy()
    offset = left + wide / 2 - face.width / 2
    T[:3, 3] = apply(face.T_world_face, np.array([[offset, 0.0, 0.0]]))[0]
    return replace(face, T_world_face=T, width=wide)


def _frames_for(face: Face, frames: Sequence[Frame]) -> list[Frame]:
    thin = UprightBox(
        face.T_world_face[:3, 3],
        np.array([0.02, face.width, face.height]),
        float(np.arctan2(face.outward[1], face.outward[0])),
    )
    candidates = [i for i, frame in enumerate(frames) if projection(thin, frame) is not None]
    order, partly = choose_frames(face, frames, np.array(candidates, int))
    return [frames[i] for i in [*order, *partly][:MAX_MERGED]] if order else []


def _whole(
    parts: Sequence[Part], wide: float, ends: tuple[bool, bool], margin: float
) -> tuple[Part, ...]:
    """Return the parts that do not touch a window end at which the row continues."""
    return tuple(
        part
        for part in parts
        if not (ends[0] and part.box[0] * wide < margin)
        and not (ends[1] and (1 - part.box[2]) * wide < margin)
    )


def _cuts(parts: Sequence[Part], width: float) -> list[float]:
    spans = sorted((part.box[0] * width, part.box[2] * width) for part in parts)
    spans += [
        (a.box[0] * width, b.box[2] * width) for a in parts for b in parts if _pair(a, b, width)
    ]
    columns: list[list[float]] = []
    for left, right in sorted(spans):
        if columns and left < columns[-1][1] - END_MARGIN:
            columns[-1][1] = max(columns[-1][1], right)
        else:
            columns.append([left, right])
    edges: list[float] = []
    ends = [0.0, *(v for column in columns for v in column), width]
    for right, left in zip(ends[0::2], ends[1::2], strict=True):
        gap = left - right
        if gap >= MIN_PIECE:
            edges += [right, left]
        else:
            edges.append((left + right) / 2 if right > 0.0 and left < width else 0.0)
    least = MIN_PIECE / 2
    return [e for e in sorted(set(edges)) if least < e < width - least]


def _pair(a: Part, b: Part, width: float) -> bool:
    """Check whether two doors are a double door, whose handles are where they meet."""
    gap = (b.box[0] - a.box[2]) * width
    level = abs(a.box[1] - b.box[1]) < 0.05 and abs(a.box[3] - b.box[3]) < 0.05
    return a.kind == "door_left" and b.kind == "door_right" and abs(gap) < 0.04 and level


def _pieces(box: UprightBox, face: Face, cuts: Sequence[float]) -> list[UprightBox]:
    edges: Float[np.ndarray, " k"] = np.array([0.0, *cuts, face.width])
    along = face.T_world_face[:3, 0]
    axis = 1 if face.index % 2 == 0 else 0
    pieces = []
    for left, right in pairwise(edges):
        size = box.size.copy()
        size[axis] = right - left
        middle = box.center + along * ((left + right) / 2 - face.width / 2)
        pieces.append(UprightBox(middle, size, box.yaw))
    return pieces
