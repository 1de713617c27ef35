"""Measure processing time by stage, and end work after a time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TypeVar

from .errors import OutOfTimeError

T = TypeVar("T")
R = TypeVar("R")
Clock = Callable[[], float]
"""Returns seconds since some origin; passed in as an argument."""
GRACE_PERIOD = 0.2
"""Time in which what catches an `OutOfTimeError` may put together what is known; each further time
half as long [s]."""
_limit: ContextVar[_Limit | None] = ContextVar("time limit", default=None)


class ProcessorClock:
    """The processor time of this process [s], without that of compiling kernels.

    So a busy machine changes no answer, and neither does the first start after installation.
    """

    def __init__(self) -> None:
        self._uncounted = 0.0
        self._stopped_at: float | None = None

    def __call__(self) -> float:
        at = self._stopped_at
        return (time.process_time() if at is None else at) - self._uncounted

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Stop the clock during a block, for other threads as well."""
        if self._stopped_at is not None:
            yield
            return
        self._stopped_at = began = time.process_time()
        try:
            yield
        finally:  # in this order, so that another thread sees no later time in between
            self._uncounted += time.process_time() - began
            self._stopped_at = None


processor_time = ProcessorClock()


@dataclass
class _Limit:
    """When work must end."""

    clock: Clock
    end: float
    """Time at which `look` raises next [s]."""
    seconds: float
    outer: _Limit | None
    grace: float = GRACE_PERIOD

    def look(self) -> None:
        late: _Limit | None = None
        limit: _Limit | None = self
        while limit is not None:
            now = limit.clock()
            if now > limit.end:
                limit.end, limit.grace, late = now + limit.grace, limit.grace / 2, limit
            limit = limit.outer
        if late is not None:
            raise OutOfTimeError(f"the time limit of {late.seconds:.3g} s is over")


@contextmanager
def time_limit(seconds: float, clock: Clock) -> Iterator[None]:
    """End the work in a block after a time: `look` raises `OutOfTimeError` from then on.

    Each call of a kernel looks at the clock. Longer work in Python calls `look` itself, at least
    every 0.1 s. What catches the error has `GRACE_PERIOD` before the next. Limits may be nested.

    Args:
        seconds: Time from now on [s].
        clock: Measures it.
    """
    token = _limit.set(_Limit(clock, clock() + seconds, seconds, _limit.get()))
    try:
        yield
    finally:
        _limit.reset(token)


def time_left() -> float:
    """Return the time until the first of the limits that hold here ends the work [s]."""
    limit, left = _limit.get(), math.inf
    while limit is not None:
        left, limit = min(left, limit.end - limit.clock()), limit.outer
    return left


def end_limits() -> None:
    """End the work in all limits that hold here, as if their time were over."""
    limit = _limit.get()
    while limit is not None:
        limit.end, limit = -math.inf, limit.outer


def within_limits(work: Callable[[T], R]) -> Callable[[T], R]:
    """Return a function for another thread, in which the time limits that hold here hold too."""
    limit = _limit.get()

    def limited(given: T) -> R:
        token = _limit.set(limit)
        try:
            return work(given)
        finally:
            _limit.reset(token)

    return limited


def look() -> None:
    """Look at the clock of the time limits that hold here, if any.

    Raises:
        OutOfTimeError: One is over.
    """
    limit = _limit.get()
    if limit is not None:
        limit.look()


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
