"""Parts above each other that look alike open alike, and mostly are drawers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from momapos.model.records import FaceImage, Part, PartKind

from . import decode
from .height_maps import Area, area_of

LEVEL_KINDS: tuple[PartKind, ...] = ("drawer", "door_down")
"""What has a level bar near its top."""
FLUSH = 0.04
"""Sides of one stack are in line, and its parts meet, within this [m]."""
SAME_PLACE = 0.05
"""Handles are as far below the tops of their parts, within this [m]."""
SAME_LENGTH = 1.25
"""And differ in length by less than this factor [-]."""
DRAWERS = 100.0
"""So many times likelier are drawers above each other than flaps [-]."""
CONTRARY = 1000.0
"""What is so many times likelier a drawer than another one is, is not like it [-]."""
LEAST = 1e-4
"""No kind is less probable [-]."""
HIGHEST = 0.42
"""Where one of them is lower than this: the doors of two ovens are above each other, too [m]."""


def opening_alike(face: FaceImage, parts: Sequence[Part]) -> tuple[Part, ...]:
    """Weigh what is thought of parts that are alike together: as drawers, or as flaps.

    A flap alone looks like a drawer with a handle at its top; above another one it hardly ever is
    one, unless it is clear of both, as of two ovens. What the networks say of parts that look alike
    is one and the same evidence, so it counts once: as the geometric mean over them.

    Args:
        face: The face.
        parts: What is on it; of parts without odds nothing is changed.
    """
    found = list(parts)
    for stack in _stacks(face, parts):
        odds = [dict(parts[k].odds) for k in stack]
        if len(stack) < 2 or _contrary(odds):
            continue
        drawers, flaps = (
            float(np.prod([each.get(kind, 0.0) for each in odds]) ** (1.0 / len(stack)))
            for kind in LEVEL_KINDS
        )
        low = min(area_of(parts[k].box, face).height for k in stack) < HIGHEST
        drawers *= DRAWERS if low else 1.0
        if drawers + flaps <= 0.0:
            continue
        share = drawers / (drawers + flaps)
        for k, each in zip(stack, odds, strict=True):
            both = each.get("drawer", 0.0) + each.get("door_down", 0.0)
            new = {**each, "drawer": share * both, "door_down": (1.0 - share) * both}
            ranked = decode.ranked(new)
            found[k] = replace(parts[k], kind=ranked[0][0], odds=ranked)
    return tuple(found)


def _contrary(odds: Sequence[Mapping[PartKind, float]]) -> bool:
    """Whether one part is clearly a drawer and another one clearly a flap: an oven above its
    drawer has handles that are alike, but does not look like it."""
    ratios = [
        max(each.get("drawer", 0.0), LEAST) / max(each.get("door_down", 0.0), LEAST)
        for each in odds
    ]
    return max(ratios) > CONTRARY * min(ratios)


def _stacks(face: FaceImage, parts: Sequence[Part]) -> list[list[int]]:
    """Indices of the parts of each stack, from below."""
    areas = [area_of(part.box, face) for part in parts]
    grips = [None if part.handle is None else area_of(part.handle, face) for part in parts]
    stacks: list[list[int]] = []
    for k in np.argsort([area.bottom for area in areas], kind="stable").tolist():
        if parts[k].kind not in LEVEL_KINDS or grips[k] is None:
            continue
        for stack in stacks:
            last = stack[-1]
            if _alike(areas[last], grips[last], areas[k], grips[k]):
                stack.append(k)
                break
        else:
            stacks.append([k])
    return stacks


def _alike(low: Area, one: Area | None, high: Area, other: Area | None) -> bool:
    """Whether a part stands on another one that is like it."""
    if one is None or other is None:
        return False
    in_line = max(abs(low.left - high.left), abs(low.right - high.right)) < FLUSH
    below_top = [area.top - (bar.bottom + bar.top) / 2 for area, bar in ((low, one), (high, other))]
    lengths = sorted((one.width, other.width))
    return (
        in_line
        and abs(low.top - high.bottom) < FLUSH
        and abs(below_top[0] - below_top[1]) < SAME_PLACE
        and lengths[1] < SAME_LENGTH * lengths[0]
    )
