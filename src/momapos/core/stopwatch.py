"""Measure processing time by stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

Clock = Callable[[], float]
"""Returns seconds since some origin; passed in as an argument."""


@dataclass
class Stopwatch:
    """Accumulates seconds by stage."""

    clock: Clock
    seconds: dict[str, float] = field(default_factory=dict)
    """Time by stage [s]."""
    began: float = field(init=False)
    """Time of creation [s]."""
    _inner: float = 0.0
    """Time in stages nested in the current one [s]."""

    def __post_init__(self) -> None:
        self.began = self.clock()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of a block to a stage, without the time of nested stages."""
        began, before, self._inner = self.clock(), self._inner, 0.0
        try:
            yield
        finally:
            spent = self.clock() - began
            self.seconds[name] = self.seconds.get(name, 0.0) + spent - self._inner
            self._inner = before + spent

    @property
    def timing(self) -> dict[str, float]:
        """Return the time by stage, and "total" [s]."""
        return {**self.seconds, "total": self.total}

    @property
    def total(self) -> float:
        """Return the time since creation [s]."""
        return self.clock() - self.began
