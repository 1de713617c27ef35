"""Parts of one face as parts of another, and handles where they are, not where they appear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert
from momapos.model.records import Part

from .faces import Face
from .projection import area, common_area

if TYPE_CHECKING:
    from jaxtyping import Float

WITHIN = 0.6
"""Share of a part that must lie on the face [-]."""
STAND_OFF = 0.04
"""Handles stand out about this far [m]."""
PARALLEL, COPLANAR = 0.99, 0.12
"""Two faces are in one plane where the cosine between them is more than the first, and the distance
less than the second [m]."""
SAME = 0.5
"""Of two parts that share this much of the smaller one, one is left out [-]."""


def placed(parts: Sequence[Part], source: Face, target: Face) -> tuple[Part, ...]:
    """Parts of one face as parts of another that lies in its plane.

    Args:
        parts: Rectangles as fractions of `source`.
        source: Where they were seen.
        target: The other face.

    Returns:
        Rectangles as fractions of `target`, cut off at its rim; without those that lie mostly
        beside it. None where the faces look different ways or are apart.
    """
    T = invert(target.T_world_face) @ source.T_world_face
    if T[2, 2] < PARALLEL or abs(T[2, 3]) > COPLANAR:
        return ()
    scale = np.array([source.width / target.width, source.height / target.height] * 2)
    at = np.array([T[0, 3] / target.width, -T[1, 3] / target.height] * 2)

    def moved(box: tuple[float, ...]) -> Float[np.ndarray, "4"]:
        return (np.array(box) - 0.5) * scale + 0.5 + at

    there = []
    for part in parts:
        box = moved(part.box)
        kept = np.clip(box, 0.0, 1.0)
        if np.prod(kept[2:] - kept[:2]) > WITHIN * np.prod(box[2:] - box[:2]):
            grip = None if part.handle is None else _rectangle(moved(part.handle))
            there.append(replace(part, box=_rectangle(kept), handle=grip))
    return tuple(there)


def handles_seen_from(
    parts: Sequence[Part], face: Face, camera: Float[np.ndarray, "3"], *, undo: bool = False
) -> tuple[Part, ...]:
    """Move handles from where they are on a face to where they appear on it, or back.

    Args:
        parts: Rectangles as fractions of the face.
        face: The face.
        camera: Where the image is taken, in the face's frame [m].
        undo: From where they appear to where they are.
    """
    sign = 1.0 if undo else -1.0
    size, origin = np.array([face.width, face.height]), np.array([camera[0], -camera[1]])

    def moved(handle: tuple[float, ...]) -> tuple[float, float, float, float]:
        box = np.array(handle).reshape(2, 2)
        middle = (box.mean(axis=0) - 0.5) * size
        return _rectangle((box + sign * STAND_OFF * (origin - middle) / camera[2] / size).ravel())

    return tuple(p if p.handle is None else replace(p, handle=moved(p.handle)) for p in parts)


def surest(parts: Sequence[Part]) -> tuple[Part, ...]:
    """The surest of parts that were seen twice, as one or as several, the surest first.

    What shows no handle, or that of a part in it, is none where several others lie in it that have
    theirs: not the same bar, seen in pieces.
    """

    def gives_way(part: Part) -> bool:
        inner = _apart([one for one in parts if one.handle is not None and _in(one, part)])
        theirs = [one.handle for one in inner if one.handle is not None]
        own = part.handle
        known = own is None or any(common_area(own, handle) for handle in theirs)
        return known and any(not common_area(*pair) for pair in combinations(theirs, 2))

    return _apart([part for part in parts if not gives_way(part)])


def _apart(parts: Sequence[Part]) -> tuple[Part, ...]:
    """The surest of parts that lie on each other, the surest first."""
    kept: list[Part] = []
    for part in sorted(parts, key=lambda p: -p.score):
        if all(shared(part, other) < SAME for other in kept):
            kept.append(part)
    return tuple(kept)


def _in(small: Part, large: Part) -> bool:
    """Whether a part lies mostly in a larger one."""
    return area(small.box) < area(large.box) and shared(small, large) >= SAME


def shared(a: Part, b: Part) -> float:
    """Common area of two parts, as a share of the smaller [-]."""
    least = min(area(a.box), area(b.box))
    return common_area(a.box, b.box) / least if least > 0 else 1.0


def _rectangle(values: Float[np.ndarray, "4"]) -> tuple[float, float, float, float]:
    left, top, right, bottom = np.clip(values, 0.0, 1.0).tolist()
    return left, top, right, bottom
