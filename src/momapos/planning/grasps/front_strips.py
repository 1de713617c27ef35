"""Narrow pieces of a front that fingers reach around: lips, and the rims of recessed pulls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.urdf import fit_box

from .handle_shapes import Element

if TYPE_CHECKING:
    from jaxtyping import Float

NARROW = 0.06
"""What is larger across its long axis is no strip [m]."""
LEAST_LENGTH = 0.02
"""A shorter strip is none [m]."""
FINGER = 0.008
"""Room that a finger needs beside a strip, and its tip behind the strip's near side [m]."""
WAY = 0.06
"""Fingers come straight from this far outside [m]."""
_SHARES = np.array([-0.5, 0.0, 0.5])
_LEVELS = 9
_STRAIGHT = 0.9
"""Cosine up to which directions are the same [-]."""


@dataclass(frozen=True, eq=False)
class Strip:
    """A piece that two fingers reach around from one side, in the frame of the part."""

    element: Element
    end: Float[np.ndarray, "3"]
    """Middle of the side that faces the hand."""
    long: Float[np.ndarray, "3"]
    out: Float[np.ndarray, "3"]
    """Unit vectors along it, and toward the hand."""
    half_length: float
    thickness: float
    depth: float
    """Half its length, its size between the fingers and toward the hand [m]."""


def strips_of(
    elements: tuple[Element, ...], pieces: tuple[Element, ...], front: Float[np.ndarray, "3"]
) -> list[Strip]:
    """The narrow pieces of a part beside which there is room for two fingers.

    Args:
        elements: All of the part.
        pieces: Those of them that may be held.
        front: Unit normal of the part's front; from behind no hand comes.
    """
    return [s for piece in pieces for s in _ways(piece, front) if _has_room(s, elements)]


def _ways(piece: Element, front: Float[np.ndarray, "3"]) -> list[Strip]:
    """The sides from which fingers may come: across its long axis, not from behind."""
    center, rotation, half = fit_box(piece.convex.vertices)
    order = np.argsort(half)
    if 2 * half[order[1]] > NARROW or 2 * half[order[2]] < LEAST_LENGTH:
        return []
    long = rotation[:, order[2]]
    ways = []
    for out_axis, between in ((order[0], order[1]), (order[1], order[0])):
        for side in (1.0, -1.0):
            out = side * rotation[:, out_axis]
            thick, depth = 2 * float(half[between]), 2 * float(half[out_axis])
            if out @ front > -_STRAIGHT:
                end = center + depth / 2 * out
                ways.append(Strip(piece, end, long, out, float(half[order[2]]), thick, depth))
    return ways


def _has_room(strip: Strip, elements: tuple[Element, ...]) -> bool:
    """Whether a finger fits on both sides of the middle or of both halves of a strip."""
    across = np.cross(strip.out, strip.long)
    along = _SHARES[:, None] * strip.half_length * strip.long
    levels = np.linspace(-min(FINGER, strip.depth), WAY, _LEVELS)[:, None] * strip.out
    near, far = strip.thickness / 2 + 1e-3, strip.thickness / 2 + FINGER
    beside = np.array([-far, -near, near, far])[:, None] * across
    points = strip.end + along[:, None, None] + levels[:, None] + beside
    filled = np.zeros(points.shape[:-1], bool)
    for element in elements:
        if element is not strip.element:
            filled |= element.convex.depth(points) > 0.0
    return bool((~filled).all((1, 2)).any())
