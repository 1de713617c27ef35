"""Plans of faces: moving and fixed rectangles.

A plan is in meters, with the origin at the face's top left corner, y down.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from momapos.model.records.scans import PartKind

from .canvas import Rect


@dataclass(frozen=True)
class Cell:
    """One field of a face."""

    rect: Rect
    kind: PartKind | None
    """None for a fixed field."""
    fill: str = "panel"
    """Appearance: panel, glass, window, open, knees, blank, controls, knobs, basin or vent."""
    free: str = ""
    """Side of the handle; "" for the side opposite the hinge."""
    along: float = 0.5
    """Position of the handle along that side [-]."""
    handle: bool = True
    """Whether it may have a handle."""


@dataclass(frozen=True)
class Plan:
    """A face with its fields."""

    family: str
    width: float
    height: float
    cells: list[Cell] = field(default_factory=list)
    appliance: bool = False
    stretch: tuple[float, float] | None = None
    """Visible range of x [m]; the whole width by default."""


def hinged(rng: np.random.Generator) -> PartKind:
    """Draw the hinge side of a door."""
    return "door_left" if rng.random() < 0.5 else "door_right"


def pair(
    rng: np.random.Generator, rect: Rect, gap: float, along: float, fill: str = "panel"
) -> list[Cell]:
    """Return two doors that open from their common edge."""
    left, top, right, bottom = rect
    share = 0.5 if rng.random() < 0.8 else rng.uniform(0.35, 0.65)
    at = left + share * (right - left)
    return [
        Cell((left, top, at - gap / 2, bottom), "door_left", fill, along=along),
        Cell((at + gap / 2, top, right, bottom), "door_right", fill, along=along),
    ]


def shares(rng: np.random.Generator, count: int, uneven: float) -> np.ndarray:
    """Draw the relative sizes of neighbors."""
    raw = np.ones(count) if rng.random() > uneven else rng.uniform(0.6, 1.7, count)
    return raw / raw.sum()


def split(
    rng: np.random.Generator, rect: Rect, count: int, gap: float, *, rows: bool, uneven: float
) -> list[Rect]:
    """Divide a rectangle into rows or columns with gaps between."""
    left, top, right, bottom = rect
    low, high = (top, bottom) if rows else (left, right)
    edges = low + (high - low + gap) * np.concatenate(([0], np.cumsum(shares(rng, count, uneven))))
    spans = [(edges[i], edges[i + 1] - gap) for i in range(count)]
    if rows:
        return [(left, a, right, b) for a, b in spans]
    return [(a, top, b, bottom) for a, b in spans]
