"""Records of a task: what must be done, and where the base may stand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

Verb = Literal["open", "close", "pick", "place"]


@dataclass(frozen=True)
class Task:
    """What is to be done."""

    verb: Verb
    object: str
    joint: str | None = None
    """The joint that must move; None for pick and place."""
    to: float | None = None
    """The value the joint must reach [rad] or [m]."""
    farthest: bool = False
    """Whether it must go no farther than `to`, but as far up to there as it can."""


Outline: TypeAlias = tuple[tuple[float, float], ...]
"""Corners of an area on the floor: x, y [m]."""


@dataclass(frozen=True)
class BaseRegion:
    """Where the base may stand, beside what the room and the arm allow."""

    keep_in: tuple[Outline, ...] = ()
    """The whole footprint stays in one of these; anywhere where there is none."""
    keep_out: tuple[Outline, ...] = ()
    """No part of the footprint is in any of these."""
    facing: float | None = None
    """Most angle between the base's x and the way to where the hand takes hold [rad]."""
    most_driving: float | None = None
    """Longest drive from the start [m]."""


ANYWHERE = BaseRegion()
