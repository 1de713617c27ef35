"""Recognize sizes that are not in meters."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

UNITS = (("millimeters", 0.001), ("centimeters", 0.01), ("inches", 0.0254))
"""Units in which files are often written, with their length [m]."""
_LARGE, _SMALL = (0.2, 5.0), (0.015, 1.2)
_WORDS = {
    _LARGE: (
        "fridge", "refrigerator", "freezer", "oven", "stove", "dishwasher", "microwave", "cabinet",
        "cupboard", "wardrobe", "closet", "drawer", "dresser", "chest", "table", "desk", "counter",
        "chair", "sofa", "couch", "bed", "shelf", "door", "sink", "washer", "bench",
    ),
    _SMALL: (
        "cup", "mug", "bottle", "bowl", "plate", "apple", "banana", "pear", "fork", "spoon",
        "knife", "phone",
    ),
}  # fmt: skip
_ARTICULATED, _RIGID = (0.05, 6.0), (0.004, 8.0)
"""Usual largest edge of an object with joints, and of any other object [m]. Taps and small boxes
are 6 cm, a wall of cupboards is 5 m, and a pea is 7 mm."""
FLOOR_EDGE = (0.8, 50.0)
"""Usual edge of a floor: a robot is 0.4 to 0.8 m wide, and larger rooms are refused [m]."""


def usual_edge(category: str, name: str, *, jointed: bool) -> tuple[float, float]:
    """Return the usual range of an object's largest edge [m].

    Args:
        category: For example "fridge"; the last known word counts.
        name: Its name, which counts if the category is unknown.
        jointed: Whether it has movable joints.
    """
    for text in (category, name):
        words = re.findall(r"[a-z]+", text.lower())
        for word in reversed(words):
            for usual, known in _WORDS.items():
                if word in known:
                    return usual
    return _ARTICULATED if jointed else _RIGID


def unit_factors(edge: float, usual: tuple[float, float]) -> list[tuple[str, float]]:
    """Return the units in which a length may have been written, and the factors that correct it.

    Args:
        edge: The length as read in meters.
        usual: Range of usual lengths [m].

    Returns:
        Unit, and a factor below 1 if it was read as meters, above 1 if it was converted once too
        often. The most probable comes first: that which leads nearest to the middle of the range,
        inches last. Nothing if the length is usual, or unusual in every unit.
    """
    low, high = usual
    if low <= edge <= high:
        return []
    found = [
        (name, factor)
        for name, unit in UNITS
        for factor in (unit, 1 / unit)
        if low <= edge * factor <= high
    ]
    middle = (low * high) ** 0.5
    return sorted(found, key=lambda f: (f[0] == "inches", abs(math.log(edge * f[1] / middle))))


def size_hint(size: Sequence[float], usual: tuple[float, float]) -> str:
    """Return the question whether a size was written in another unit; "" if it is usual."""
    found = unit_factors(max(size), usual)
    if not found:
        return ""
    words = [
        f"{unit} (factor {factor:.4g}: {' x '.join(f'{factor * v:.3g}' for v in size)} m)"
        for unit, factor in found
    ]
    if found[0][1] < 1:
        return f"lengths are meters; are these {' or '.join(words)}?"
    return f"were meters converted as {' or '.join(words)} once too often?"
