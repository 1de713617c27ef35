"""Limit the time of a command, and the time and memory of work on untrusted files."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import replace
from importlib.abc import MetaPathFinder
from pathlib import Path
from types import FrameType
from typing import Any

from momapos.core import (
    InputError,
    OutOfTimeError,
    look,
    processor_time,
    time_left,
    time_limit,
)

SECONDS, MEMORY = 60.0, 2_000_000_000
"""Limits for checking a robot: processor time [s] and memory [bytes]."""
MIN_TIMEOUT = 0.001
"""Least time limit that a configuration takes [s]."""
_PERIOD = 0.05
"""Interval between checks of the processor time [s]."""


class _TooLong(BaseException):
    """Not an `Exception`, so that handlers in libraries don't catch it."""


_began: ContextVar[float | None] = ContextVar("processor time at which the command began [s]")


@contextmanager
def counting_from(began: float | None) -> Iterator[None]:
    """Let the time limit of a command count from a processor time [s]; None for now."""
    token = _began.set(processor_time() if began is None else began)
    try:
        yield
    finally:
        _began.reset(token)


class _LookingImports(MetaPathFinder):
    """Looks at the clock before each module that is imported, and leaves it to other finders.

    Importing scipy takes 0.3 s. An interrupted import cannot always be repeated, so this must not
    be active where work goes on after the time is over.
    """

    def find_spec(self, *_: object) -> None:
        numpy = getattr(sys.modules.get("numpy"), "__spec__", None)
        if not getattr(numpy, "_initializing", False):  # numpy's import cannot be repeated
            look()


_IMPORTS = _LookingImports()


@contextmanager
def within_time(seconds: float) -> Iterator[None]:
    """End the work of a command when its time limit is over.

    Args:
        seconds: Processor time since the command began [s].

    Raises:
        OutOfTimeError: It is over.
    """
    began = _began.get(None)
    spent = 0.0 if began is None else processor_time() - began
    try:
        with time_limit(seconds - spent, processor_time), _looking_imports():
            yield
    except OutOfTimeError:
        raise OutOfTimeError(
            f"the time limit of {seconds:g} s is over before a search ended; give more --timeout"
        ) from None


@contextmanager
def _looking_imports() -> Iterator[None]:
    sys.meta_path.insert(0, _IMPORTS)
    try:
        yield
    finally:
        _end_looking()


def _end_looking() -> None:
    with suppress(ValueError):
        sys.meta_path.remove(_IMPORTS)


def with_time_left(config: Any) -> Any:
    """Return a configuration of a search that ends with the command's time.

    From here on there may be an answer even if the time is over.
    """
    _end_looking()
    return replace(config, timeout=max(min(config.timeout, time_left()), MIN_TIMEOUT))


@contextmanager
def within_bounds(what: str, seconds: float = SECONDS, memory: int = MEMORY) -> Iterator[None]:
    """Limit work, if the system supports it and this is the main thread.

    Args:
        what: Beginning of the message.
        seconds: Processor time [s].
        memory: Further memory of the process [bytes].

    Raises:
        InputError: The work exceeds a limit.
    """
    alone = threading.current_thread() is threading.main_thread()
    if not (alone and hasattr(signal, "SIGPROF")):
        yield
        return
    import resource

    done = threading.Event()

    def stop(_signal: int, _frame: FrameType | None) -> None:
        if not done.is_set():
            raise _TooLong

    # A thread, not a system timer: signals may be blocked when the program starts, and a timer
    # fires only once, which is too few if the exception is raised in a destructor.
    watch = threading.Thread(target=_watch, args=(time.process_time() + seconds, done), daemon=True)
    limits = resource.getrlimit(resource.RLIMIT_DATA)
    most = memory + _data_size()
    least = most if limits[1] == resource.RLIM_INFINITY else min(most, limits[1])
    before = signal.signal(signal.SIGPROF, stop)
    try:
        watch.start()
        resource.setrlimit(resource.RLIMIT_DATA, (least, limits[1]))
        yield
    except _TooLong:
        done.set()
        more = f"{seconds:g} s of processor time"
        raise InputError(f"{what} takes more than {more}; use simpler shapes") from None
    except MemoryError:
        more = f"{memory / 1e9:g} GB of memory"
        raise InputError(f"{what} takes more than {more}; use simpler shapes") from None
    finally:
        done.set()
        resource.setrlimit(resource.RLIMIT_DATA, limits)
        watch.join()
        signal.signal(signal.SIGPROF, before)


def _data_size() -> int:
    """Return the data size of the process [bytes]; 0 if unknown."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[5])
    except (OSError, ValueError, IndexError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def _watch(until: float, done: threading.Event) -> None:
    """Interrupt the main thread after a processor time, repeatedly, until its work is done."""
    while not done.wait(_PERIOD):
        if time.process_time() > until:
            _thread.interrupt_main(signal.SIGPROF)
