"""Determine jointly how similar stacked parts open: mostly as drawers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from momapos.model.records import FaceImage, Part, PartKind

from . import decode
from .height_maps import Area, area_of

LEVEL_KINDS: tuple[PartKind, ...] = ("drawer", "door_down")
"""Kinds with a level bar near the top."""
MAX_MISALIGNMENT = 0.04
"""Sides of one stack are in line, and its parts meet, within this [m]."""
MAX_PLACE_DIFFERENCE = 0.05
"""Between the distances of handles from the tops of their parts [m]."""
MAX_LENGTH_RATIO = 1.25
"""Between the lengths of handles [-]."""
DRAWER_PRIOR = 100.0
"""Prior odds of drawers to flaps in a stack [-]."""
MAX_ODDS_RATIO = 1000.0
"""Parts whose odds of being a drawer differ by more are not similar [-]."""
MIN_PROBABILITY = 1e-4
"""Lower bound of the probability of a kind [-]."""
MAX_HEIGHT = 0.42
"""The prior applies if one part is lower than this: doors of two ovens are stacked, too [m]."""


def weigh_stacks(face: FaceImage, parts: Sequence[Part]) -> tuple[Part, ...]:
    """Weigh the odds of similar stacked parts together: all drawers, or all flaps.

    A single flap looks like a drawer with a handle at its top. In a stack it is rarely a flap,
    unless the networks are confident about each part, as for two ovens. The odds of similar parts
    are the same evidence, so they count once, as their geometric mean.

    Args:
        face: The face.
        parts: Parts on it; parts without odds stay unchanged.
    """
    found = list(parts)
    for stack in _stacks(face, parts):
        odds = [dict(parts[k].odds) for k in stack]
        if len(stack) < 2 or _is_mixed(odds):
            continue
        drawers, flaps = (
            float(np.prod([each.get(kind, 0.0) for each in odds]) ** (1.0 / len(stack)))
            for kind in LEVEL_KINDS
        )
        low = min(area_of(parts[k].box, face).height for k in stack) < MAX_HEIGHT
        drawers *= DRAWER_PRIOR if low else 1.0
        if drawers + flaps <= 0.0:
            continue
        share = drawers / (drawers + flaps)
        for k, each in zip(stack, odds, strict=True):
            both = each.get("drawer", 0.0) + each.get("door_down", 0.0)
            new = {**each, "drawer": share * both, "door_down": (1.0 - share) * both}
            ranked = decode.ranked(new)
            found[k] = replace(parts[k], kind=ranked[0][0], odds=ranked)
    return tuple(found)


def _is_mixed(odds: Sequence[Mapping[PartKind, float]]) -> bool:
    """Check whether one part is clearly a drawer and another clearly a flap, like an oven above its
    drawer, which have similar handles."""
    ratios = [
        max(each.get("drawer", 0.0), MIN_PROBABILITY)
        / max(each.get("door_down", 0.0), MIN_PROBABILITY)
        for each in odds
    ]
    return max(ratios) > MAX_ODDS_RATIO * min(ratios)


def _stacks(face: FaceImage, parts: Sequence[Part]) -> list[list[int]]:
    areas = [area_of(part.box, face) for part in parts]
    grips = [None if part.handle is None else area_of(part.handle, face) for part in parts]
    stacks: list[list[int]] = []
    for k in np.argsort([area.bottom for area in areas], kind="stable").tolist():
        if parts[k].kind not in LEVEL_KINDS or grips[k] is None:
            continue
        for stack in stacks:
            last = stack[-1]
            if _is_similar(areas[last], grips[last], areas[k], grips[k]):
                stack.append(k)
                break
        else:
            stacks.append([k])
    return stacks


def _is_similar(low: Area, one: Area | None, high: Area, other: Area | None) -> bool:
    if one is None or other is None:
        return False
    in_line = max(abs(low.left - high.left), abs(low.right - high.right)) < MAX_MISALIGNMENT
    below_top = [area.top - (bar.bottom + bar.top) / 2 for area, bar in ((low, one), (high, other))]
    lengths = sorted((one.width, other.width))
    return (
        in_line
        and abs(low.top - high.bottom) < MAX_MISALIGNMENT
        and abs(below_top[0] - below_top[1]) < MAX_PLACE_DIFFERENCE
        and lengths[1] < MAX_LENGTH_RATIO * lengths[0]
    )
