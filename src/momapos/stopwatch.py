"""Processing time by stage."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from momapos.protocols import Clock


@dataclass
class Stopwatch:
    """Adds up seconds by stage."""

    clock: Clock
    seconds: dict[str, float] = field(default_factory=dict)
    """Seconds spent so far, by stage [s]."""
    began: float = field(init=False)
    """When it was made [s]."""

    def __post_init__(self) -> None:
        self.began = self.clock()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time of a block for a stage."""
        began = self.clock()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + self.clock() - began

    @property
    def timing(self) -> dict[str, float]:
        """Seconds by stage, and "total"."""
        return {**self.seconds, "total": self.total}

    @property
    def total(self) -> float:
        """Seconds since it was made [s]."""
        return self.clock() - self.began
