"""Parts of a front by its label and size alone, for where nothing better is known."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from momapos.model.records import FaceImage, Front, Part, PartKind

GUESS = 0.3
"""Score of all that is guessed from a label, in [0, 1]."""
LONGEST = 0.6
"""Share of its part's side that a handle takes at most [-]."""


@dataclass(frozen=True)
class Band:
    """A strip over the width of a face, filled with parts of about one size."""

    kinds: tuple[PartKind, ...] = ()
    """Repeated from left to right; without any, the strip is a fixed panel."""
    share: float = 1.0
    """Of the face's height [-]."""
    widest: float = math.inf
    """Wider strips are divided side by side [m]."""
    tallest: float = math.inf
    """Taller strips are divided one above the other [m]."""
    until: float = 1.0
    """Share of the width, from the left, that has parts; the rest is a panel [-]."""


@dataclass(frozen=True)
class Template:
    """Strips from top to bottom, for faces up to a height."""

    bands: tuple[Band, ...]
    up_to: float = math.inf
    """Height of the tallest face it stands for [m]."""


@dataclass(frozen=True)
class Grip:
    """Where the handle of a part usually is."""

    toward: tuple[float, float]
    """The point it is drawn to, across and down, as fractions of the part."""
    size: tuple[float, float]
    """Width and height [m]."""
    inset: float = 0.05
    """Least distance of its center from the part's edges [m]."""


TEMPLATES: Mapping[str, tuple[Template, ...]] = {
    "fridge": (
        Template((Band(("door_right",)),), up_to=1.3),
        Template((Band(("door_right",), share=0.35), Band(("door_right",), share=0.65))),
    ),
    "microwave": (Template((Band(("door_left",), until=0.75),)),),
    "oven": (Template((Band(share=0.15), Band(("door_down",), share=0.85))),),
    "dishwasher": (Template((Band(("door_down",)),)),),
    "cabinet": (Template((Band(("door_left", "door_right"), widest=0.6),)),),
    "drawer": (Template((Band(("drawer",), widest=0.9, tallest=0.25),)),),
}
"""What most things of a label look like; of several, the first that is tall enough.

Guesses where makers differ: fridges are hinged on the right and have two doors from 1.3 m on, the
freezer above; microwaves are hinged on the left; cabinets have pairs of doors, and an odd one is
hinged on the left.
"""
ALIASES: Mapping[str, str] = {
    "refrigerator": "fridge",
    "minifridge": "fridge",
    "mini fridge": "fridge",
    "freezer": "fridge",
    "microwave oven": "microwave",
    "stove": "oven",
    "range": "oven",
    "dish washer": "dishwasher",
    "cabinets": "cabinet",
    "kitchen cabinet": "cabinet",
    "kitchen cabinets": "cabinet",
    "base cabinet": "cabinet",
    "wall cabinet": "cabinet",
    "sink cabinet": "cabinet",
    "cupboard": "cabinet",
    "wardrobe": "cabinet",
    "drawers": "drawer",
    "drawer unit": "drawer",
    "chest of drawers": "drawer",
    "dresser": "drawer",
    "nightstand": "drawer",
    "night stand": "drawer",
    "file cabinet": "drawer",
    "filing cabinet": "drawer",
}
"""Other labels for the same things."""
HANDLES: Mapping[PartKind, Grip] = {
    "door_left": Grip(toward=(1.0, 0.5), size=(0.02, 0.3)),
    "door_right": Grip(toward=(0.0, 0.5), size=(0.02, 0.3)),
    "door_down": Grip(toward=(0.5, 0.0), size=(0.4, 0.02)),
    "door_up": Grip(toward=(0.5, 1.0), size=(0.3, 0.02)),
    "drawer": Grip(toward=(0.5, 0.5), size=(0.2, 0.02)),
}
"""Bars along the edge that opens, and across the middle of a drawer."""


class TemplatePredictor:
    """An `ArticulationPredictor` that looks at the label and the size, not at the image."""

    def __call__(self, face: FaceImage, label: str) -> Front:
        """Lay the label's template over the face; an unknown label has no parts and score 0."""
        choices = TEMPLATES.get(common_name(label))
        if choices is None:
            return Front(0.0, ())
        template = next(choice for choice in choices if face.height <= choice.up_to)
        parts: list[Part] = []
        top = 0.0
        for band in template.bands:
            parts += _fill(band, top, face.width, face.height)
            top += band.share
        return Front(GUESS, tuple(parts))


def common_name(label: str) -> str:
    """What things of a label are called in the tables of this folder."""
    name = label.casefold().replace("_", " ").strip()
    return ALIASES.get(name, name)


def _fill(band: Band, top: float, width: float, height: float) -> list[Part]:
    """Divide a strip that begins at `top` on a face of this size [m] into its parts."""
    if not band.kinds:
        return []
    columns = _count(band.until * width, band.widest)
    rows = _count(band.share * height, band.tallest)
    step_x, step_y = band.until / columns, band.share / rows
    parts = []
    for row in range(rows):
        for column in range(columns):
            left, upper = column * step_x, top + row * step_y
            box = (left, upper, min(left + step_x, 1.0), min(upper + step_y, 1.0))
            kind = band.kinds[column % len(band.kinds)]
            parts.append(Part(kind, box, GUESS, _handle(HANDLES[kind], box, width, height)))
    return parts


def _count(length: float, most: float) -> int:
    """Count the equal pieces of at most this length."""
    return max(1, math.ceil(length / most - 1e-9))


def _handle(
    grip: Grip, box: tuple[float, float, float, float], width: float, height: float
) -> tuple[float, float, float, float]:
    """Place a handle on a part, as fractions of the face."""
    spans = []
    for low, high, face, toward, length in (
        (box[0], box[2], width, grip.toward[0], grip.size[0]),
        (box[1], box[3], height, grip.toward[1], grip.size[1]),
    ):
        side = (high - low) * face
        half = min(length, LONGEST * side) / 2
        inset = min(max(grip.inset, half), side / 2)
        center = min(max(toward * side, inset), side - inset)
        spans.append((low + (center - half) / face, low + (center + half) / face))
    (left, right), (top, bottom) = spans
    return left, top, right, bottom
