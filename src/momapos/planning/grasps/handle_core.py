"""The part of a handle that hands hold, and what kind of handle it makes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from .handle_shapes import Element

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

HELD_DEPTH = 0.04
"""Of what is deeper the outer end is held [m]."""
BEHIND = 0.008
"""Room behind a handle that a finger may use [m]."""
_LEVELS = 41
"""Points at which room is looked for behind a handle [-]."""
_JOINT = 1e-4
"""Elements that are nearer to each other are one body [m]."""


class HandleKind(StrEnum):
    """What a handle is like; the words stand in answers."""

    BAR = "bar"
    """Long, with room behind it."""
    KNOB = "knob"
    LEVER = "lever"
    """A bar that hangs on one end."""
    LIP = "lip"
    """Long, without room behind it."""
    RECESS = "recessed pull"
    """A strip of the front itself, beside a pocket or a groove."""
    EDGE = "edge"
    """The free edge of a panel that has no handle."""
    FACE = "face"
    """The front of a panel, to be pushed or sucked."""


@dataclass(frozen=True)
class Core:
    """The part of a handle that hands hold, without what fastens it."""

    shift: float
    """From the middle of the whole toward the outside [m]."""
    depth: float
    """Size along the outside direction [m]."""
    kind: HandleKind


def core_of(
    center: Float[np.ndarray, "3"],
    half_long: Float[np.ndarray, "3"],
    out: Float[np.ndarray, "3"],
    half_out: float,
    group: list[Element],
    others: list[Element],
) -> Core:
    """Where a handle is solid from its outer side on, and whether there is room behind that.

    Bars, levers and lips are told apart by that room, and by what closes it at the ends.

    Args:
        center: Middle of the whole.
        half_long: From there to its end.
        out: Unit vector to the outside.
        half_out: Half its size along that [m].
        group: Its elements.
        others: Those of the rest of the part.
    """
    top = half_out + BEHIND
    solid = _spans(group, center + top * out, -out)
    covered = _spans(others, center + top * out, -out)
    first = solid[:, 0].min(initial=np.inf)
    if not np.isfinite(first):
        return Core(0.0, 2 * half_out, HandleKind.BAR)
    last = first
    for begin, end in solid[np.argsort(solid[:, 0])]:
        last = max(last, end) if begin <= last + _JOINT else last
    inside = covered[covered[:, 0] > first, 0].min(initial=np.inf)
    depth = min(last - first, inside - first, HELD_DEPTH)
    shift = top - first - depth / 2
    kind = _room_behind(center, half_long, out, half_out, float(first), [*group, *others])
    return Core(float(shift), float(depth), kind)


def _spans(
    elements: list[Element], origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 2"]:
    """Where a line enters and leaves elements, those left out that it misses [m]."""
    spans = [e.convex.span(origin, direction) for e in elements]
    return np.array([span for span in spans if span[0] < span[1]]).reshape(-1, 2)


def _room_behind(
    center: Float[np.ndarray, "3"],
    half_long: Float[np.ndarray, "3"],
    out: Float[np.ndarray, "3"],
    half_out: float,
    first: float,
    elements: list[Element],
) -> HandleKind:
    """Tell bars, levers and lips apart by the room behind their middle and their ends.

    Args:
        center, half_long, out, half_out: The whole of it.
        first: Where it begins, from `BEHIND` outside of its outer side [m].
        elements: All of the part.
    """
    levels = np.linspace(half_out + BEHIND - first, -half_out - BEHIND, _LEVELS)
    step = float(levels[0] - levels[-1]) / (_LEVELS - 1)
    shares = np.array([-0.95, -0.5, 0.0, 0.5, 0.95])
    points = center + shares[:, None, None] * half_long + levels[:, None] * out
    free = ~_filled(elements, points)
    if free[1:4].all(0).sum() * step < BEHIND:
        return HandleKind.LIP
    ends = free[[0, 4]].sum(1) * step >= BEHIND
    return HandleKind.LEVER if ends[0] != ends[1] else HandleKind.BAR


def _filled(elements: list[Element], points: Float[np.ndarray, "k n 3"]) -> Bool[np.ndarray, "k n"]:
    """Which points lie in some element."""
    filled = np.zeros(points.shape[:-1], bool)
    for element in elements:
        filled |= element.convex.depth(points) > -1e-6
    return filled
