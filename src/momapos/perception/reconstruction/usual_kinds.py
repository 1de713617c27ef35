"""Guess how parts of such objects usually open, and parts that no image shows.

An image alone is ambiguous: a level bar near the top belongs to a flap or a drawer, and a door
without a handle may have its hinge on either side. The object's label (oven, microwave) and its
height reduce the ambiguity: nobody looks into a drawer above eye level.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from momapos.model.records import FaceImage, Front, Part, PartKind

from . import decode
from .height_maps import Area, area_of

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


TRAINING_SHARES: Mapping[PartKind, float] = {
    "door_left": 0.285, "door_right": 0.285, "door_down": 0.07, "door_up": 0.07, "drawer": 0.29,
}  # fmt: skip
"""Shares of the kinds in the last training of the front networks, the prior of their odds;
`training.fronts.generator.LAST` draws them like this [-]."""
USUAL: Mapping[str, Mapping[PartKind, float]] = {
    "fridge": {
        "door_left": 0.38, "door_right": 0.45, "door_down": 0.01, "door_up": 0.01, "drawer": 0.15,
    },
    "microwave": {
        "door_left": 0.85, "door_right": 0.04, "door_down": 0.09, "door_up": 0.01, "drawer": 0.01,
    },
    "oven": {
        "door_left": 0.04, "door_right": 0.03, "door_down": 0.8, "door_up": 0.01, "drawer": 0.12,
    },
    "dishwasher": {
        "door_left": 0.01, "door_right": 0.01, "door_down": 0.89, "door_up": 0.01, "drawer": 0.08,
    },
    "washing machine": {
        "door_left": 0.85, "door_right": 0.05, "door_down": 0.03, "door_up": 0.01, "drawer": 0.06,
    },
}  # fmt: skip
"""Shares of the kinds among the parts of objects with a label [-], estimated from what shops sell:
most fridges have hinges on the right and some have freezer drawers, nearly all microwaves and
washing machines have hinges on the left, ovens drop down, a few stand above a drawer or have hinges
at a side. Cabinets may have anything."""
EYE_HEIGHT = 1.5
"""Eye height of a standing person, a little lower so that it holds for most [m]."""
HIGH: Mapping[PartKind, float] = {
    "door_left": 0.4, "door_right": 0.4, "door_down": 0.02, "door_up": 0.16, "drawer": 0.02,
}  # fmt: skip
"""Shares of the kinds above eye level [-], estimated: wall cabinets have doors, some of which are
lifted."""
LOW: Mapping[PartKind, float] = {
    "door_left": 0.32, "door_right": 0.32, "door_down": 0.1, "door_up": 0.01, "drawer": 0.25,
}  # fmt: skip
"""Shares of the kinds below eye level [-]; nobody stoops to lift a door."""
MIN_UPRIGHT, MIN_ASPECT = 0.45, 1.15
"""A part is upright if it is higher than the first [m], and than its width times the second [-]."""
MIN_FLAP_WIDTH, MAX_FLAP_HEIGHT = 0.42, 0.9
"""The narrowest dishwashers are 45 cm wide; the highest doors that drop down are those of ovens and
dishwashers [m]."""
UNUSUAL = 0.02
"""Probability of a kind in a size that shops do not sell, relative to other sizes [-]."""
UPRIGHT_DRAWER = 0.15
"""The same for drawers that are higher than wide: pull-outs for bins and bottles [-]."""
REPEATED_FLAP = 0.1
"""The same for a flap next to a part of its size: two dishwashers side by side [-]."""
MAX_GAP, MAX_OFF_LEVEL, MAX_WIDTH_RATIO = 0.06, 0.1, 1.6
"""Gap between neighbors, difference of their heights [m], and ratio of their widths [-]."""


def weighted_by_label(parts: Sequence[Part], label: str, sure: float) -> tuple[Part, ...]:
    """Combine the odds of parts with those of the object's label by Bayes' rule.

    Args:
        parts: Parts of a front; parts without odds stay unchanged.
        label: Label of the object; labels without known shares change nothing.
        sure: Probability that the label is correct, in [0, 1].
    """
    usual = USUAL.get(common_name(label))
    if usual is None:
        return tuple(parts)
    factors = _factors(usual, sure)
    return tuple(_weighed(part, factors) for part in parts)


def weighted_by_height(parts: Sequence[Part], face: FaceImage, floor: float) -> tuple[Part, ...]:
    """Combine the odds of parts with those of parts above or below eye level.

    Args:
        parts: Parts of a front; parts without odds stay unchanged.
        face: The front.
        floor: Height of its lower edge above the floor [m].
    """
    high, low = _factors(HIGH, 1.0), _factors(LOW, 1.0)

    def middle(part: Part) -> float:
        area = area_of(part.box, face)
        return floor + (area.bottom + area.top) / 2

    return tuple(_weighed(part, high if middle(part) > EYE_HEIGHT else low) for part in parts)


def weighted_by_size(
    parts: Sequence[Part], face: FaceImage, adjacent: Sequence[Part] = ()
) -> tuple[Part, ...]:
    """Lower the odds of flaps and drawers that nobody builds in this size, and of flaps in a row.

    A level bar at the top belongs to a flap, a drawer or a door. But dishwashers and ovens are at
    least 42 cm wide, and stand alone among doors of the same size.

    Args:
        parts: Parts of a front; parts without odds stay unchanged.
        face: The front.
        adjacent: Parts next to the front, as fractions of it, outside of [0, 1].
    """
    areas = [_unclipped(part, face) for part in (*parts, *adjacent)]
    weighed = []
    for part, area in zip(parts, areas, strict=False):
        factors = dict.fromkeys(TRAINING_SHARES, 1.0)
        upright = area.height > max(MIN_UPRIGHT, MIN_ASPECT * area.width)
        if (upright and area.width < MIN_FLAP_WIDTH) or area.height > MAX_FLAP_HEIGHT:
            factors["door_down"] *= UNUSUAL
        if upright:
            factors["drawer"] *= UPRIGHT_DRAWER
        if upright and any(_is_next_to(area, other) for other in areas):
            factors["door_down"] *= REPEATED_FLAP
        weighed.append(_weighed(part, factors))
    return tuple(weighed)


def _unclipped(part: Part, face: FaceImage) -> Area:
    left, top, right, bottom = part.box
    w, h = face.width, face.height
    return Area(left * w, (1 - bottom) * h, right * w, (1 - top) * h)


def _is_next_to(one: Area, other: Area) -> bool:
    """Check whether two areas have about one size and height, side by side."""
    sides = min(abs(one.left - other.right), abs(one.right - other.left)) < MAX_GAP
    level = max(abs(one.bottom - other.bottom), abs(one.top - other.top)) < MAX_OFF_LEVEL
    return sides and level and 1 / MAX_WIDTH_RATIO < one.width / other.width < MAX_WIDTH_RATIO


def _factors(usual: Mapping[PartKind, float], sure: float) -> dict[PartKind, float]:
    """Return the probability ratio of each kind to the training shares, given the label's."""
    return {
        kind: 1.0 - sure + sure * usual[kind] / share for kind, share in TRAINING_SHARES.items()
    }


def _weighed(part: Part, factors: Mapping[PartKind, float]) -> Part:
    if not part.odds:
        return part
    raw = {kind: probability * factors[kind] for kind, probability in part.odds}
    total = sum(raw.values())
    odds = decode.ranked({kind: weight / total for kind, weight in raw.items()})
    return replace(part, kind=odds[0][0], odds=odds)
