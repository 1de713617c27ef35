"""The set S while it grows: which objects are modeled, and which come next."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from momapos.model.records import KeyObjects

from .ranking import Importance


@dataclass(frozen=True)
class Selection:
    """What is modeled at the moment."""

    ranked: Importance
    alpha: float
    """Threshold that has been reached [-]."""
    joined: frozenset[str] = frozenset()
    """Objects that a check has added, whatever their score."""
    rounds: int = 0
    """How often a plan was checked again because objects joined [-]."""

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
        """Add objects that a check found to matter."""
        return replace(self, joined=self.joined | frozenset(names))

    def relax_alpha(self) -> Selection:
        """Lower alpha until S is twice as large, or everything (MoMa-Pos, Lemma 1)."""
        wanted = min(2 * len(self.names), len(self.ranked.names))
        for score in self.ranked.scores:
            lower = replace(self, alpha=min(self.alpha, float(score)))
            if len(lower.names) >= wanted:
                return lower
        return replace(self, alpha=0.0)

    def record(self) -> KeyObjects:
        """What the plan says of it."""
        ranked = self.ranked
        return KeyObjects(ranked.scorer, self.alpha, self.names, ranked.by_name, self.rounds)


def everything(ranked: Importance) -> Selection:
    """The selection in which no object is a box."""
    return Selection(ranked, 0.0)


def start_of(ranked: Importance) -> Selection:
    """The selection at the configured threshold."""
    return Selection(ranked, ranked.alpha)
