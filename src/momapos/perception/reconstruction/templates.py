"""Guess the parts of a front from its label and size alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from momapos.model.records import FaceImage, Front, Part, PartKind

SCORE = 0.3
"""Score of parts guessed from a label, in [0, 1]."""
MAX_HANDLE_LENGTH = 0.6
"""Length of a handle relative to its part's side [-]."""


@dataclass(frozen=True)
class Band:
    """A strip across a face, filled with parts of about one size."""

    kinds: tuple[PartKind, ...] = ()
    """Repeated from left to right; without kinds, the strip is a fixed panel."""
    share: float = 1.0
    """Share of the face's height [-]."""
    widest: float = math.inf
    """Wider strips are divided side by side [m]."""
    tallest: float = math.inf
    """Taller strips are divided vertically [m]."""
    until: float = 1.0
    """Share of the width, from the left, with parts; the rest is a panel [-]."""


@dataclass(frozen=True)
class Template:
    """Strips from top to bottom, for faces up to a height."""

    bands: tuple[Band, ...]
    up_to: float = math.inf
    """Maximum height of a face [m]."""


@dataclass(frozen=True)
class HandlePlacement:
    """Usual place of the handle of a part."""

    toward: tuple[float, float]
    """Preferred center, across and down, as fractions of the part."""
    size: tuple[float, float]
    """Width and height [m]."""
    inset: float = 0.05
    """Minimum distance of its center from the part's edges [m]."""


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
"""Appearance of most objects with a label; the first template that is tall enough is used.

Makers differ: fridges have hinges on the right and two doors from 1.3 m on, the freezer above;
microwaves have hinges on the left; cabinets have pairs of doors, and an odd one has its hinge on
the left.
"""
ALIASES: Mapping[str, str] = {
    "refrigerator": "fridge", "minifridge": "fridge", "mini fridge": "fridge",
    "freezer": "fridge", "microwave oven": "microwave", "stove": "oven", "range": "oven",
    "dish washer": "dishwasher", "cabinets": "cabinet", "kitchen cabinet": "cabinet",
    "kitchen cabinets": "cabinet", "base cabinet": "cabinet", "wall cabinet": "cabinet",
    "sink cabinet": "cabinet", "cupboard": "cabinet", "wardrobe": "cabinet",
    "drawers": "drawer", "drawer unit": "drawer", "chest of drawers": "drawer",
    "dresser": "drawer", "nightstand": "drawer", "night stand": "drawer",
    "file cabinet": "drawer", "filing cabinet": "drawer",
}  # fmt: skip
"""Synonyms of the labels."""
HANDLES: Mapping[PartKind, HandlePlacement] = {
    "door_left": HandlePlacement(toward=(1.0, 0.5), size=(0.02, 0.3)),
    "door_right": HandlePlacement(toward=(0.0, 0.5), size=(0.02, 0.3)),
    "door_down": HandlePlacement(toward=(0.5, 0.0), size=(0.4, 0.02)),
    "door_up": HandlePlacement(toward=(0.5, 1.0), size=(0.3, 0.02)),
    "drawer": HandlePlacement(toward=(0.5, 0.5), size=(0.2, 0.02)),
}
"""Bars along the edge that opens, and in the middle of a drawer."""


class TemplatePredictor:
    """An `ArticulationPredictor` that uses the label and the size, not the image."""

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
        return Front(SCORE, tuple(parts))


def common_name(label: str) -> str:
    """Return the canonical name of a label."""
    name = label.casefold().replace("_", " ").strip()
    return ALIASES.get(name, name)


def has_parts(label: str) -> bool:
    """Check whether objects with a label have doors or drawers."""
    return common_name(label) in TEMPLATES


def _fill(band: Band, top: float, width: float, height: float) -> list[Part]:
    """Divide a strip that starts at `top` on a face of this size [m] into its parts."""
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
            parts.append(Part(kind, box, SCORE, _handle(HANDLES[kind], box, width, height)))
    return parts


def _count(length: float, most: float) -> int:
    return max(1, math.ceil(length / most - 1e-9))


def _handle(
    placement: HandlePlacement, box: tuple[float, float, float, float], width: float, height: float
) -> tuple[float, float, float, float]:
    spans = []
    for low, high, face, toward, length in (
        (box[0], box[2], width, placement.toward[0], placement.size[0]),
        (box[1], box[3], height, placement.toward[1], placement.size[1]),
    ):
        side = (high - low) * face
        half = min(length, MAX_HANDLE_LENGTH * side) / 2
        inset = min(max(placement.inset, half), side / 2)
        center = min(max(toward * side, inset), side - inset)
        spans.append((low + (center - half) / face, low + (center + half) / face))
    (left, right), (top, bottom) = spans
    return left, top, right, bottom
