"""How the doors of things of a label usually open, weighed against what is seen of them.

A front alone leaves doubt: a level bar near the top is that of a flap or of a drawer, a door
without a handle may be hinged at either side. Whoever knows that it is an oven or a microwave
doubts less, and so does who stands before a wall cabinet: nobody looks into a drawer above the
eyes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from momapos.model.records import FaceImage, Part, PartKind

from . import decode
from .height_maps import area_of
from .templates import common_name

LEARNT: Mapping[PartKind, float] = {
    "door_left": 0.31, "door_right": 0.31, "door_down": 0.09, "door_up": 0.09, "drawer": 0.2,
}  # fmt: skip
"""Shares of the kinds among what the front networks learnt from last, which their odds start
from; `training.fronts.generator.HUNG` draws them so [-]."""
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
"""Shares of the kinds among the parts of things of a label [-]. They are estimates from what shops
sell: most fridges are hinged on the right and some have drawers for the freezer, nearly all
microwaves and washing machines are hinged on the left, ovens drop down, a few stand above a drawer
or are hinged at a side. A cabinet may have anything."""
EYES = 1.5
"""Height of the eyes of who stands, a little lower so that it holds for most [m]."""
HIGH: Mapping[PartKind, float] = {
    "door_left": 0.4, "door_right": 0.4, "door_down": 0.02, "door_up": 0.16, "drawer": 0.02,
}  # fmt: skip
"""Shares of the kinds among what is above the eyes [-]; estimates, too: wall cabinets have doors,
some of which are lifted."""
LOW: Mapping[PartKind, float] = {
    "door_left": 0.32, "door_right": 0.32, "door_down": 0.1, "door_up": 0.01, "drawer": 0.25,
}  # fmt: skip
"""Shares of the kinds among what is lower [-]; nobody stoops to lift a door."""


def weighed(parts: Sequence[Part], label: str, sure: float) -> tuple[Part, ...]:
    """Weigh what is seen of parts with how such parts usually open, by Bayes' rule.

    Args:
        parts: What is on a front; of parts without odds nothing is changed.
        label: What the thing is called; of labels that tell nothing nothing is changed.
        sure: Probability that it is what it is called, in [0, 1]; it is anything else otherwise.
    """
    usual = USUAL.get(common_name(label))
    if usual is None:
        return tuple(parts)
    factors = _factors(usual, sure)
    return tuple(_weighed(part, factors) for part in parts)


def weighed_by_height(parts: Sequence[Part], face: FaceImage, floor: float) -> tuple[Part, ...]:
    """Weigh what is seen of parts with how such parts, above the eyes or lower, usually open.

    Args:
        parts: What is on a front; of parts without odds nothing is changed.
        face: The front.
        floor: From its lower edge down to the floor [m].
    """
    high, low = _factors(HIGH, 1.0), _factors(LOW, 1.0)

    def middle(part: Part) -> float:
        area = area_of(part.box, face)
        return floor + (area.bottom + area.top) / 2

    return tuple(_weighed(part, high if middle(part) > EYES else low) for part in parts)


def _factors(usual: Mapping[PartKind, float], sure: float) -> dict[PartKind, float]:
    """How much likelier each kind is among some parts than among all, if they surely are such."""
    return {kind: 1.0 - sure + sure * usual[kind] / share for kind, share in LEARNT.items()}


def _weighed(part: Part, factors: Mapping[PartKind, float]) -> Part:
    if not part.odds:
        return part
    raw = {kind: probability * factors[kind] for kind, probability in part.odds}
    total = sum(raw.values())
    odds = decode.ranked({kind: weight / total for kind, weight in raw.items()})
    return replace(part, kind=odds[0][0], odds=odds)
