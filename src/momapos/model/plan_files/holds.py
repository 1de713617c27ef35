"""Read and write the holds of a plan file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from momapos.core import FileFormatError
from momapos.model.records import Hold

from . import plan_members as members

MAX_UNIT_ERROR = 1e-3
"""Largest error of the length of a unit vector in a file [-]."""


def holds_to_dict(holds: tuple[Hold, ...]) -> dict[str, Any]:
    """Return the members of a plan file that describe holds; none if there are no holds."""
    if not holds:
        return {}
    return {
        "holds": [[hold.first, hold.last] for hold in holds],
        "turn_axes": [hold.turn_axis for hold in holds],
        "families": [hold.family for hold in holds],
        "hold_words": [hold.words for hold in holds],
    }


def read_holds(motion: members.Manipulation, path: Path) -> tuple[Hold, ...]:
    """Check and return the holds: ordered state ranges, with unit axes or none."""
    axes = motion.turn_axes or [None] * len(motion.holds)
    bounds = [-1, *(state for hold in motion.holds for state in hold), len(motion.q)]
    in_order = all(a < b for a, b in zip(bounds[:-1:2], bounds[1::2], strict=True)) and all(
        first <= last for first, last in motion.holds
    )
    if not in_order:
        raise FileFormatError(
            f"{path}: manipulation.holds must be ordered, disjoint [first, last] of states 0 to "
            f"{len(motion.q) - 1}"
        )
    if len(axes) != len(motion.holds) or not all(
        axis is None or abs(math.hypot(*axis) - 1.0) < MAX_UNIT_ERROR for axis in axes
    ):
        raise FileFormatError(
            f"{path}: manipulation.turn_axes must be a unit vector or null for each of "
            f"{len(motion.holds)} holds"
        )
    families = motion.families or [""] * len(motion.holds)
    if len(families) != len(motion.holds) or any(len(name) > 40 for name in families):
        raise FileFormatError(f"{path}: manipulation.families must be a word for each hold")
    words = motion.hold_words or [""] * len(motion.holds)
    if len(words) != len(motion.holds) or any(len(text) > 400 for text in words):
        raise FileFormatError(f"{path}: manipulation.hold_words must be a line for each hold")
    holds = zip(motion.holds, axes, families, words, strict=True)
    return tuple(Hold(*hold, axis, family, text) for hold, axis, family, text in holds)
