"""Records of a task: what must be done, and where the base may stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from momapos.core import InputError, expect, finite_array, finite_number, one_of, shown

Verb = Literal["open", "close", "pick", "place"]


@dataclass(frozen=True)
class Task:
    """What must be done; `make_task` makes one.

    Raises:
        InputError: A field has the wrong type or is not finite.
    """

    verb: Verb
    object: str
    joint: str | None = None
    """The joint that must move; None for pick and place."""
    to: float | None = None
    """The value the joint must reach [rad] or [m]."""
    farthest: bool = False
    """Whether `to` is an upper bound, up to which the joint must move as far as possible."""
    follower: str = ""
    """The requested joint, if it is a mimic joint that follows `joint`."""

    def __post_init__(self) -> None:
        one_of("Task.verb", self.verb, get_args(Verb))
        expect("Task.object", self.object, str)
        if self.joint is not None:
            expect("Task.joint", self.joint, str)
        if self.to is not None:
            object.__setattr__(self, "to", finite_number("Task.to", self.to))


Outline: TypeAlias = tuple[tuple[float, float], ...]
"""Corners of an area on the floor: x, y [m]."""


@dataclass(frozen=True)
class BaseRegion:
    """Where the base may stand and drive, in addition to what the room and the arm allow.

    Raises:
        InputError: An outline is not three or more finite corners, or a bound is negative.
    """

    keep_in: tuple[Outline, ...] = ()
    """At the base pose the whole footprint is in one of these; empty for anywhere."""
    keep_out: tuple[Outline, ...] = ()
    """The outline of the base, `Robot.base_outline`, touches none of these, neither at the base
    pose nor on the way there nor while the base moves. The arm may be over them."""
    facing: float | None = None
    """Largest angle between the base's x axis and the direction to the grasp [rad]."""
    most_driving: float | None = None
    """Longest drive from the start [m]."""

    def __post_init__(self) -> None:
        for name in ("keep_in", "keep_out"):
            object.__setattr__(self, name, _outlines(f"BaseRegion.{name}", getattr(self, name)))
        for name in ("facing", "most_driving"):
            if getattr(self, name) is not None:
                value = finite_number(f"BaseRegion.{name}", getattr(self, name), 0.0)
                object.__setattr__(self, name, value)


def _outlines(name: str, value: object) -> tuple[Outline, ...]:
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise InputError(f"{name} must be a sequence of outlines, not {shown(value)}")
    outlines = []
    for k, corners in enumerate(value):
        points = finite_array(f"{name}[{k}]", corners, (None, 2))
        if len(points) < 3:
            raise InputError(f"{name}[{k}] must have 3 or more corners x, y, not {len(points)}")
        outlines.append(tuple((float(x), float(y)) for x, y in points))
    return tuple(outlines)


ANYWHERE: BaseRegion = BaseRegion()
