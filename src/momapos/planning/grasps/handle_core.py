"""Find the graspable core of a handle, and classify the handle."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from .handle_shapes import Element

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MAX_HELD_DEPTH = 0.04
"""Only the outer end of a deeper handle is grasped [m]."""
FINGER_SPACE = 0.008
"""Space for a finger behind a handle [m]."""
_LEVELS = 41
"""Samples of the space behind a handle [-]."""
_MAX_GAP = 1e-4
"""Elements with a smaller gap are one body [m]."""


class HandleKind(StrEnum):
    """The kind of a handle; plans contain the words."""

    BAR = "bar"
    """Long, with space behind it."""
    KNOB = "knob"
    LEVER = "lever"
    """A bar that is fixed at one end."""
    LIP = "lip"
    """Long, without space behind it."""
    RECESS = "recessed pull"
    """A strip of the front itself, next to a pocket or a groove."""
    EDGE = "edge"
    """The free edge of a panel without a handle."""
    FACE = "face"
    """The front of a panel, for pushing or suction."""


@dataclass(frozen=True)
class Core:
    """The part of a handle that a hand grasps, without its fixings."""

    shift: float
    """Offset from the middle of the whole handle outwards [m]."""
    depth: float
    """Size along the outward direction [m]."""
    kind: HandleKind


def core_of(
    center: Float[np.ndarray, "3"],
    half_long: Float[np.ndarray, "3"],
    out: Float[np.ndarray, "3"],
    half_out: float,
    group: list[Element],
    others: list[Element],
) -> Core:
    """Find the solid outer part of a handle, and classify it by the space behind it.

    Args:
        center: Middle of the handle.
        half_long: Vector from there to its end.
        out: Outward unit vector.
        half_out: Half the size along `out` [m].
        group: Elements of the handle.
        others: Elements of the rest of the part.
    """
    top = half_out + FINGER_SPACE
    solid = _spans(group, center + top * out, -out)
    covered = _spans(others, center + top * out, -out)
    first = solid[:, 0].min(initial=np.inf)
    if not np.isfinite(first):
        return Core(0.0, 2 * half_out, HandleKind.BAR)
    last = first
    for begin, end in solid[np.argsort(solid[:, 0])]:
        last = max(last, end) if begin <= last + _MAX_GAP else last
    inside = covered[covered[:, 0] > first, 0].min(initial=np.inf)
    depth = min(last - first, inside - first, MAX_HELD_DEPTH)
    shift = top - first - depth / 2
    kind = _kind_of(center, half_long, out, half_out, float(first), [*group, *others])
    return Core(float(shift), float(depth), kind)


def _spans(
    elements: list[Element], origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 2"]:
    """Return where a line enters and leaves the elements that it hits [m]."""
    spans = [e.convex.span(origin, direction) for e in elements]
    return np.array([span for span in spans if span[0] < span[1]]).reshape(-1, 2)


def _kind_of(
    center: Float[np.ndarray, "3"],
    half_long: Float[np.ndarray, "3"],
    out: Float[np.ndarray, "3"],
    half_out: float,
    first: float,
    elements: list[Element],
) -> HandleKind:
    """Classify a bar, lever or lip by the space behind its middle and its ends.

    Args:
        center, half_long, out, half_out: See `core_of`.
        first: Where the handle begins, measured from `FINGER_SPACE` outside its outer side [m].
        elements: All elements of the part.
    """
    levels = np.linspace(half_out + FINGER_SPACE - first, -half_out - FINGER_SPACE, _LEVELS)
    step = float(levels[0] - levels[-1]) / (_LEVELS - 1)
    shares = np.array([-0.95, -0.5, 0.0, 0.5, 0.95])
    points = center + shares[:, None, None] * half_long + levels[:, None] * out
    free = ~_filled(elements, points)
    if free[1:4].all(0).sum() * step < FINGER_SPACE:
        return HandleKind.LIP
    ends = free[[0, 4]].sum(1) * step >= FINGER_SPACE
    return HandleKind.LEVER if ends[0] != ends[1] else HandleKind.BAR


def _filled(elements: list[Element], points: Float[np.ndarray, "k n 3"]) -> Bool[np.ndarray, "k n"]:
    """Check which points lie inside an element."""
    filled = np.zeros(points.shape[:-1], bool)
    for element in elements:
        filled |= element.convex.depth(points) > -1e-6
    return filled
