"""Guess the label of a box from its size and position.

A table of rules, one per kind. It is a fallback for instances without a label, and it errs where
objects look alike from outside, such as a dishwasher behind a cabinet front.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import inf
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core.geometry import UprightBox, along_edges, bottom, to_local, top
from momapos.model.records import UNKNOWN, Cloud

from .room_shell import RoomShell, area

if TYPE_CHECKING:
    from jaxtyping import Int

Stand = Literal["floor", "support", "hung"]
Range = tuple[float, float, float, float]
"""A trapezoid: the fit rises from 0 to 1 between the first two numbers, and falls from 1 to 0
between the last two."""


@dataclass(frozen=True)
class BoxFeatures:
    """Input of the rules."""

    stand: Stand
    """Whether it stands on the floor, on another object, or hangs."""
    height: float
    """Vertical extent [m]."""
    width: float
    """Longer side seen from above [m]."""
    depth: float
    """Shorter side [m]."""
    bottom: float
    """Height above the floor [m]."""
    closed: float
    """Share of its fullest side that surfaces cover [-]."""
    step: float
    """How much higher it is than adjacent furniture [m]; 0 without neighbors."""
    free: float
    """Distance to the nearest wall [m]."""
    bright: float
    """Median brightness in [0, 1]."""

    @property
    def slender(self) -> float:
        """Height over width [-]."""
        return self.height / max(self.width, 1e-6)


@dataclass(frozen=True)
class SizeRule:
    """One kind of object."""

    label: str
    stand: tuple[Stand, ...]
    fits: Mapping[str, Range]
    """Ranges of features; all must fit."""
    score: float
    """Confidence if everything fits, in [0, 1]."""


def _from(low: float, full: float) -> Range:
    return (low, full, inf, inf)


def _to(full: float, high: float) -> Range:
    return (-inf, -inf, full, high)


FLOOR: tuple[Stand, ...] = ("floor",)
ON: tuple[Stand, ...] = ("support",)
HUNG: tuple[Stand, ...] = ("hung",)

RULES: tuple[SizeRule, ...] = (
    SizeRule("fridge", FLOOR, {"height": (1.1, 1.3, 2.1, 2.3), "width": (0.45, 0.55, 0.98, 1.1),
         "depth": (0.4, 0.5, 0.95, 1.05), "closed": _from(0.3, 0.5)}, 0.8),
    SizeRule("cabinet", FLOOR, {"height": _from(1.1, 1.5), "closed": _from(0.3, 0.5)}, 0.5),
    SizeRule("oven", FLOOR, {"height": (0.82, 0.88, 1.0, 1.05), "width": (0.5, 0.56, 0.92, 0.98),
         "depth": (0.45, 0.5, 0.8, 0.9), "step": (0.01, 0.025, 0.08, 0.12)}, 0.75),
    SizeRule("dishwasher", FLOOR, {"height": (0.75, 0.8, 0.92, 0.96),
         "width": (0.5, 0.55, 0.72, 0.8), "depth": (0.45, 0.5, 0.72, 0.8),
         "closed": _from(0.3, 0.5), "bright": _to(0.2, 0.3)}, 0.6),
    SizeRule("kitchen island", FLOOR, {"height": (0.75, 0.8, 1.0, 1.1), "width": _from(0.6, 0.8),
         "depth": _from(0.25, 0.32), "closed": _from(0.3, 0.5), "free": _from(0.5, 0.7)}, 0.6),
    SizeRule("cabinet", FLOOR, {"height": (0.4, 0.6, 1.0, 1.1), "width": _from(0.2, 0.3),
         "closed": _from(0.3, 0.5)}, 0.5),
    SizeRule("wall cabinet", HUNG, {"bottom": _from(1.0, 1.2), "height": (0.25, 0.3, 1.1, 1.3),
         "depth": (0.2, 0.25, 0.45, 0.55)}, 0.7),
    SizeRule("range hood", HUNG, {"bottom": _from(1.2, 1.35), "width": (0.4, 0.5, 1.0, 1.2),
         "depth": _from(0.42, 0.5)}, 0.6),
    SizeRule("counter", ("floor", "support", "hung"), {"height": _to(0.07, 0.1),
         "bottom": (0.6, 0.7, 1.05, 1.15), "width": _from(0.5, 0.6),
         "depth": _from(0.4, 0.5)}, 0.6),
    SizeRule("table", FLOOR, {"height": (0.35, 0.5, 0.95, 1.1), "width": _from(0.5, 0.65),
         "depth": _from(0.4, 0.5), "closed": _to(0.4, 0.5)}, 0.7),
    SizeRule("chair", FLOOR, {"height": (0.5, 0.65, 1.15, 1.25), "width": (0.2, 0.3, 0.65, 0.75),
         "depth": (0.15, 0.25, 0.6, 0.7)}, 0.45),
    SizeRule("shelf", HUNG, {"bottom": _from(0.3, 0.5), "height": _to(0.1, 0.15),
         "depth": _to(0.4, 0.5), "width": _from(0.3, 0.4)}, 0.5),
    SizeRule("microwave", ("support", "hung"), {"height": (0.17, 0.22, 0.42, 0.48),
         "width": (0.34, 0.4, 0.7, 0.85), "depth": (0.2, 0.26, 0.55, 0.62)}, 0.7),
    SizeRule("cup", ON, {"height": (0.05, 0.075, 0.12, 0.14), "width": (0.04, 0.055, 0.13, 0.16),
         "slender": (0.95, 1.12, 1.6, 1.9)}, 0.6),
    SizeRule("apple", ON, {"height": (0.04, 0.05, 0.08, 0.095), "width": (0.045, 0.055, 0.1, 0.12),
         "slender": (0.5, 0.6, 1.06, 1.15)}, 0.5),
    SizeRule("bottle", ON, {"height": (0.14, 0.17, 0.36, 0.42), "width": (0.035, 0.045, 0.11, 0.14),
         "slender": _from(1.7, 2.1)}, 0.6),
    SizeRule("box", ON, {"height": (0.1, 0.14, 0.36, 0.42), "width": (0.1, 0.12, 0.3, 0.36),
         "slender": (0.5, 0.7, 2.1, 2.5)}, 0.5),
    SizeRule("bowl", ON, {"height": (0.025, 0.04, 0.09, 0.11), "width": (0.11, 0.13, 0.26, 0.3),
         "depth": _from(0.1, 0.12)}, 0.4),
    SizeRule("plate", ON, {"height": _to(0.03, 0.045), "width": (0.13, 0.16, 0.3, 0.34),
         "depth": _from(0.12, 0.15)}, 0.4),
)  # fmt: skip
"""Earlier rules win ties."""

MIN_FIT = UNKNOWN[1]
"""Boxes that no rule fits at least this well are an "object" [-]."""


def guesses_of(features: BoxFeatures) -> tuple[tuple[str, float], ...]:
    """Return all labels whose rules fit a box well enough, with scores in [0, 1], best first."""
    values = {**asdict(features), "slender": features.slender}
    scores = [
        (rule.score * min(fit(values[name], spread) for name, spread in rule.fits.items()))
        if features.stand in rule.stand
        else 0.0
        for rule in RULES
    ]
    order = sorted(range(len(RULES)), key=lambda k: -scores[k])
    fitting = [(RULES[k].label, scores[k]) for k in order if scores[k] >= MIN_FIT]
    best: dict[str, float] = {}
    for label, score in fitting:
        best.setdefault(label, score)
    return tuple(best.items())


def fit(value: float, spread: Range) -> float:
    """Return how well a value fits a range, in [0, 1]."""
    low, full, still, high = spread
    if full <= value <= still:
        return 1.0
    if value <= low or value >= high:
        return 0.0
    return (value - low) / (full - low) if value < full else (high - value) / (high - still)


def features_of(
    cloud: Cloud,
    members: Int[np.ndarray, " k"],
    box: UprightBox,
    stand: Stand,
    others: Sequence[UprightBox],
    room: RoomShell,
) -> BoxFeatures:
    """Measure the features of a box.

    Args:
        cloud: Upright.
        members: Points of the object.
        box: Its box.
        stand: What it stands on.
        others: Boxes of all objects; it may be among them.
        room: Walls.
    """
    flat = np.sort(box.size[:2])
    walls = [
        float(wall.distance(box.center[None])[0]) - box.size[wall.axis] / 2
        for wall in room.walls
        if wall.spans(box.center[None], 0.5)[0]
    ]
    colors = cloud.colors[members]
    return BoxFeatures(
        stand=stand,
        height=float(box.size[2]),
        width=float(flat[1]),
        depth=float(flat[0]),
        bottom=bottom(box),
        closed=_closed(cloud, members, box),
        step=_step(box, others),
        free=min(walls, default=10.0),
        bright=float(np.median(colors)) / 255 if len(colors) else 0.5,
    )


def _closed(cloud: Cloud, members: Int[np.ndarray, " k"], box: UprightBox) -> float:
    """Return the share of the fullest upright side that surfaces cover [-]."""
    local = to_local(cloud.points[members], box)
    facing = along_edges(cloud.normals[members], box.yaw)
    inner = np.abs(local[:, 2]) < box.size[2] / 2 - 0.05
    if box.size[2] < 0.2:
        return 0.0
    shares = []
    for axis in (0, 1):
        for sign in (-1.0, 1.0):
            at = np.abs(sign * local[:, axis] - box.size[axis] / 2) < 0.08
            on = local[at & inner & (np.abs(facing[:, axis]) > 0.8)]
            whole = box.size[1 - axis] * (box.size[2] - 0.1)
            shares.append(area(on[:, 1 - axis], on[:, 2]) / whole)
    return float(max(shares))


def _step(box: UprightBox, others: Sequence[UprightBox]) -> float:
    """Return how much higher a box is than the highest similar one that touches its side [m]."""
    steps = []
    for other in others:
        apart = np.abs(box.center - other.center)[:2] - (box.size + other.size)[:2] / 2
        similar = abs(top(box) - top(other)) < 0.15
        if similar and apart.max() < 0.06 and apart.max() > -0.06:
            steps.append(top(box) - top(other))
    return min(steps, default=0.0)
