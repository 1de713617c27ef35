"""Processing time by stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

Clock = Callable[[], float]
"""Seconds from some origin; passed in, so that nothing else depends on the time of day."""


@dataclass
class Stopwatch:
    """Adds up seconds by stage."""

    clock: Clock
    seconds: dict[str, float] = field(default_factory=dict)
    """Seconds spent so far, by stage [s]."""
    began: float = field(init=False)
    """When it was made [s]."""
    _inner: float = 0.0
    """Seconds spent so far in stages within the one that runs [s]."""

    def __post_init__(self) -> None:
        self.began = self.clock()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time of a block for a stage, but for that of stages within the block."""
        began, before, self._inner = self.clock(), self._inner, 0.0
        try:
            yield
        finally:
            spent = self.clock() - began
            self.seconds[name] = self.seconds.get(name, 0.0) + spent - self._inner
            self._inner = before + spent

    @property
    def timing(self) -> dict[str, float]:
        """Seconds by stage, and "total"."""
        return {**self.seconds, "total": self.total}

    @property
    def total(self) -> float:
        """Seconds since it was made [s]."""
        return self.clock() - self.began
