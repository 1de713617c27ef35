"""What became of the candidates, in the few kinds that a picture can show."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.placement.place import FEASIBLE, NOT_TRIED, PASSED, Search

if TYPE_CHECKING:
    from jaxtyping import Float, Int


@dataclass(frozen=True)
class Kind:
    """A group of reasons with one marker."""

    name: str
    matches: Callable[[str], bool]
    colour: str
    marker: str
    filled: bool = False
    size: float = 2.6
    """Size of the marker [pt]."""
    obvious: bool = False
    """Whether the room explains it at a glance; drawn on the open floor only."""


def _starts(*words: str) -> Callable[[str], bool]:
    return lambda reason: reason.startswith(words)


KINDS = (
    Kind("farther than the arm", _starts("farther"), "#c9ced3", ".", size=2.2, obvious=True),
    Kind("base", _starts("base", "no way to drive"), "#a3aab1", "x", size=2.2, obvious=True),
    Kind("out of reach", _starts("out of reach", "no grasp"), "#4f6d8f", "o"),
    Kind("not tried", _starts(NOT_TRIED, PASSED), "#6f7a83", ".", size=2.8),
    Kind("other", lambda _: True, "#555555", "*", size=3.4),
    Kind("arm hits", _starts("arm"), "#aa4499", "^", size=3.2),
    Kind("no continuous path", _starts("no continuous"), "#7a4a1e", "s"),
    Kind("no approach", _starts("no approach"), "#7d7a1f", "D"),
    Kind("exact check", _starts("exact check"), "#661100", "P", size=3.6),
    Kind("feasible", lambda reason: reason == FEASIBLE, "#009e73", "o", filled=True, size=5.0),
)
"""From what fails first to what succeeds; the order in which they are drawn."""
_OTHER = next(i for i, kind in enumerate(KINDS) if kind.name == "other")


def kind_of(reason: str) -> int:
    """Index of the kind that a reason belongs to."""
    named = (i for i, kind in enumerate(KINDS) if i != _OTHER and kind.matches(reason))
    return next(named, _OTHER)


@dataclass(frozen=True)
class Outcomes:
    """All candidates of a search."""

    poses: Float[np.ndarray, "n 3"]
    kind: Int[np.ndarray, " n"]
    """Index into `KINDS`."""
    counts: dict[str, int]
    """How many, by summarised reason."""


def outcomes(search: Search) -> Outcomes:
    """Sort the candidates of a search into kinds."""
    poses = np.concatenate([np.zeros((0, 3)), *search.poses])
    reasons = [str(r) for block in search.reasons for r in block]
    counts = Counter(map(summary, reasons))
    known = {reason: kind_of(reason) for reason in set(reasons)}
    kind = np.array([known[r] for r in reasons], int)
    # Where nothing can be sampled the search says so in one candidate that has no place.
    real = np.array([not r.endswith("at any distance") for r in reasons], bool)
    return Outcomes(poses[real], kind[real], dict(counts))


def summary(reason: str) -> str:
    """A reason without the waypoint at which it struck."""
    if reason.startswith("exact check"):
        return "exact check"
    if reason.startswith("out of reach at ") and not reason.endswith("distance"):
        return "out of reach at a waypoint"
    return re.sub(r" at (the pre-grasp|waypoint \d+)$", "", reason)


def thin(
    points: Float[np.ndarray, "n 2"], rank: Int[np.ndarray, " n"], most: int
) -> Int[np.ndarray, " k"]:
    """Choose points for a picture: all of them, or the highest rank in each cell of the floor.

    Args:
        points: Positions [m].
        rank: What is more worth showing.
        most: How many may be chosen; the cells grow until it holds.
    """
    cell = 0.0
    chosen = np.arange(len(points))
    while len(chosen) > most:
        cell += 0.05
        cells = np.floor(points / cell).astype(np.int64)
        off_centre = np.abs(points / cell - cells - 0.5).max(1).round(2)
        order = np.lexsort((off_centre, -rank, cells[:, 1], cells[:, 0]))
        step = np.diff(cells[order], axis=0, prepend=cells[order[:1]] - 1)
        chosen = order[(step != 0).any(1)]
    return np.sort(chosen)
