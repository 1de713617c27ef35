"""The set S of key objects, and how it grows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from momapos.model.records import KeyObjects

from .ranking import Importance


@dataclass(frozen=True)
class Selection:
    """The objects that have a kinematic model; all others are boxes."""

    ranked: Importance
    alpha: float
    """Current threshold [-]."""
    joined: frozenset[str] = frozenset()
    """Objects that a check has added, regardless of their score."""
    rounds: int = 0
    """Number of times that a plan was checked again because objects were added [-]."""

    @property
    def names(self) -> tuple[str, ...]:
        """S, most important first."""
        scored = set(self.ranked.selected(self.alpha))
        return tuple(n for n in self.ranked.names if n in scored or n in self.joined)

    @property
    def boxes(self) -> tuple[str, ...]:
        """All other objects, most important first."""
        chosen = set(self.names)
        return tuple(n for n in self.ranked.names if n not in chosen)

    def join(self, names: Iterable[str]) -> Selection:
        """Return the selection with more objects, regardless of their score."""
        return replace(self, joined=self.joined | frozenset(names))

    def relax_alpha(self) -> Selection:
        """Lower alpha until S is twice as large or contains all objects (MoMa-Pos, Lemma 1)."""
        wanted = min(2 * len(self.names), len(self.ranked.names))
        for score in self.ranked.scores:
            lower = replace(self, alpha=min(self.alpha, float(score)))
            if len(lower.names) >= wanted:
                return lower
        return replace(self, alpha=0.0)

    def record(self) -> KeyObjects:
        """Return the record for the plan."""
        ranked = self.ranked
        return KeyObjects(ranked.scorer, self.alpha, self.names, ranked.by_name, self.rounds)


def everything(ranked: Importance) -> Selection:
    """Select all objects."""
    return Selection(ranked, 0.0)


def start_of(ranked: Importance) -> Selection:
    """Select the objects above the configured threshold."""
    return Selection(ranked, ranked.alpha)
