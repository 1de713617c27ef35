"""The holds of a plan file: written, and read with care."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from momapos.core import FileFormatError
from momapos.model.records import Hold

from . import plan_members as members

UNIT = 1e-3
"""A unit vector in a file is so long, to within this [-]."""


def holds_to_dict(holds: tuple[Hold, ...]) -> dict[str, Any]:
    """Ranges of states, and the axes about which the hand may turn; nothing where it never does."""
    if not holds:
        return {}
    return {
        "holds": [[hold.first, hold.last] for hold in holds],
        "turn_axes": [hold.turn_axis for hold in holds],
        "families": [hold.family for hold in holds],
        "hold_words": [hold.words for hold in holds],
    }


def read_holds(motion: members.Manipulation, path: Path) -> tuple[Hold, ...]:
    """Ranges of states in order, within the manipulation, with unit axes or none."""
    axes = motion.turn_axes or [None] * len(motion.holds)
    bounds = [-1, *(state for hold in motion.holds for state in hold), len(motion.q)]
    in_order = all(a < b for a, b in zip(bounds[:-1:2], bounds[1::2], strict=True)) and all(
        first <= last for first, last in motion.holds
    )
    if not in_order:
        raise FileFormatError(
            f"{path}: manipulation.holds must be [first, last] of states 0 to {len(motion.q) - 1}, "
            "in order, none in two"
        )
    if len(axes) != len(motion.holds) or not all(
        axis is None or abs(math.hypot(*axis) - 1.0) < UNIT for axis in axes
    ):
        raise FileFormatError(
            f"{path}: manipulation.turn_axes must be a unit vector or null for each of the "
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
