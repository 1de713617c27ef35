"""Find narrow pieces of a front that fingers can reach around: lips and rims of recessed pulls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.urdf import fit_box

from .handle_shapes import Element

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_WIDTH = 0.06
"""Maximum size of a strip across its long axis [m]."""
MIN_LENGTH = 0.02
"""Minimum length of a strip [m]."""
FINGER_SPACE = 0.008
"""Space for a finger on each side of a strip, and for its tip behind the strip's near side [m]."""
APPROACH_LENGTH = 0.06
"""Length of the straight approach that must be free [m]."""
_SHARES = np.array([-0.5, 0.0, 0.5])
_LEVELS = 9
_MIN_COSINE = 0.9
"""Cosine above which directions count as the same [-]."""


@dataclass(frozen=True, eq=False)
class Strip:
    """A piece that two fingers reach around from one side, in the part's frame."""

    element: Element
    end: Float[np.ndarray, "3"]
    """Middle of the side that faces the hand [m]."""
    long: Float[np.ndarray, "3"]
    out: Float[np.ndarray, "3"]
    """Unit vectors along the strip (long) and toward the hand (out)."""
    half_length: float
    thickness: float
    depth: float
    """Half length, size between the fingers, and size toward the hand [m]."""


def strips_of(
    elements: tuple[Element, ...], pieces: tuple[Element, ...], front: Float[np.ndarray, "3"]
) -> list[Strip]:
    """Find the narrow pieces of a part with space for a finger on both sides.

    Args:
        elements: All elements of the part.
        pieces: The elements that may be grasped.
        front: Unit normal of the part's front; no hand approaches from behind.
    """
    return [s for piece in pieces for s in _sides(piece, front) if _is_graspable(s, elements)]


def _sides(piece: Element, front: Float[np.ndarray, "3"]) -> list[Strip]:
    """Return a strip for each side of a piece from which fingers may approach."""
    center, rotation, half = fit_box(piece.convex.vertices)
    order = np.argsort(half)
    if 2 * half[order[1]] > MAX_WIDTH or 2 * half[order[2]] < MIN_LENGTH:
        return []
    long = rotation[:, order[2]]
    strips = []
    for out_axis, between in ((order[0], order[1]), (order[1], order[0])):
        for side in (1.0, -1.0):
            out = side * rotation[:, out_axis]
            thick, depth = 2 * float(half[between]), 2 * float(half[out_axis])
            if out @ front > -_MIN_COSINE:
                end = center + depth / 2 * out
                strips.append(Strip(piece, end, long, out, float(half[order[2]]), thick, depth))
    return strips


def _is_graspable(strip: Strip, elements: tuple[Element, ...]) -> bool:
    """Check that fingers fit on both sides of a strip, at its middle or middle of a half."""
    across = np.cross(strip.out, strip.long)
    along = _SHARES[:, None] * strip.half_length * strip.long
    levels = (
        np.linspace(-min(FINGER_SPACE, strip.depth), APPROACH_LENGTH, _LEVELS)[:, None] * strip.out
    )
    near, far = strip.thickness / 2 + 1e-3, strip.thickness / 2 + FINGER_SPACE
    beside = np.array([-far, -near, near, far])[:, None] * across
    points = strip.end + along[:, None, None] + levels[:, None] + beside
    filled = np.zeros(points.shape[:-1], bool)
    for element in elements:
        if element is not strip.element:
            filled |= element.convex.depth(points) > 0.0
    return bool((~filled).all((1, 2)).any())
