"""Limit the time of a command, and the time and memory of work on untrusted files."""

from __future__ import annotations

import _thread
import math
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
    GRACE_PERIOD,
    Clock,
    InputError,
    MomaposError,
    OutOfTimeError,
    end_limits,
    look,
    one_line,
    processor_time,
    time_left,
    time_limit,
)

from .options import EXIT_STATUS

SECONDS, MEMORY = 60.0, 2_000_000_000
"""Limits for checking a robot: processor time [s] and memory [bytes]."""
MIN_TIMEOUT = 0.001
"""Least time limit that a configuration takes [s]."""
_PERIOD = 0.05
"""Interval between checks of the processor time [s]."""


class _TooLong(BaseException):
    """Not an `Exception`, so that handlers in libraries don't catch it."""


_OVERTIME = 2.0 * GRACE_PERIOD
"""Time after its limit at which a process ends itself, because one call goes on and on [s]."""
_began: ContextVar[tuple[float, bool] | None] = ContextVar("when the command began", default=None)
"""Processor time [s], and whether the process is there for the command alone."""


@contextmanager
def counting_from(began: float | None) -> Iterator[None]:
    """Let the time limit of a command count from a processor time [s]; None for now.

    A given time means that the process is there for the command alone, so that a limit may end it.
    """
    token = _began.set((processor_time() if began is None else began, began is not None))
    try:
        yield
    finally:
        _began.reset(token)


class _LookingImports(MetaPathFinder):
    """Looks at the clock before each module that is imported, and leaves it to other finders.

    Importing scipy takes 0.3 s. An interrupted import cannot always be repeated, so this must not
    be active where work goes on after the time is over.
    """

    interrupted = threading.Event()
    """Set before an import is interrupted."""

    def find_spec(self, *_: object) -> None:
        if not _imports_numpy():
            try:
                look()
            except OutOfTimeError:
                self.interrupted.set()
                raise


_IMPORTS = _LookingImports()


def _imports_numpy() -> bool:
    """Return whether numpy is being imported, which cannot be repeated if it is interrupted."""
    spec = getattr(sys.modules.get("numpy"), "__spec__", None)
    return bool(getattr(spec, "_initializing", False))


@contextmanager
def within_time(seconds: float | None) -> Iterator[None]:
    """End the search of a command when its time limit is over, and soon after it anything else.

    Args:
        seconds: Processor time since the command began [s]; None for no limit.

    Raises:
        OutOfTimeError: It is over.
    """
    if seconds is None:
        yield
        return
    left, alone = _left(seconds)
    error = OutOfTimeError(
        f"the time limit of {seconds:g} s is over before a search ended; give more --timeout"
    )

    def clock() -> float:
        # Once the search has begun, what catches the error of a look may put together what is
        # known, in twice the grace period.
        return processor_time() - (0.0 if _IMPORTS in sys.meta_path else 2.0 * GRACE_PERIOD)

    interrupted = threading.Event()
    with (
        _looking_imports(interrupted),
        _interrupted(left, clock, error, interrupted, ends_process=alone),
    ):
        try:
            with time_limit(left, processor_time):
                yield
        except OutOfTimeError:
            raise error from None


def _left(seconds: float) -> tuple[float, bool]:
    """Return the time left to a command [s], and whether it is alone in its process."""
    began, alone = _began.get() or (processor_time(), False)
    return seconds - (processor_time() - began), alone


@contextmanager
def ended_after(seconds: float) -> Iterator[None]:
    """End a command when its time limit is over; no search in it returns what is known so far.

    Args:
        seconds: Processor time since the command began [s].

    Raises:
        OutOfTimeError: It is over.
    """
    error = OutOfTimeError(f"the time limit of {seconds:g} s is over; give more --timeout")
    left, alone = _left(seconds)
    with _interrupted(left, processor_time, error, ends_process=alone):
        yield


@contextmanager
def _looking_imports(interrupted: threading.Event) -> Iterator[None]:
    _IMPORTS.interrupted = interrupted
    sys.meta_path.insert(0, _IMPORTS)
    try:
        yield
    finally:
        _end_looking()


def _end_looking() -> None:
    with suppress(ValueError):
        sys.meta_path.remove(_IMPORTS)


@contextmanager
def ended_by_interrupt() -> Iterator[threading.Event]:
    """End the time limits that hold in a block at the first Ctrl-C, so that it keeps what it knows.

    The second one interrupts it as usual. Only the main thread takes interrupts.

    Yields:
        Whether there was one.

    Raises:
        KeyboardInterrupt: The block knew nothing by then.
    """
    interrupted = threading.Event()
    if not _interruptible():
        yield interrupted
        return
    before = signal.getsignal(signal.SIGINT)

    def stop(*_: object) -> None:
        signal.signal(signal.SIGINT, before)
        interrupted.set()
        end_limits()

    signal.signal(signal.SIGINT, stop)
    try:
        yield interrupted
    except OutOfTimeError:
        if interrupted.is_set():
            raise KeyboardInterrupt from None
        raise
    finally:
        signal.signal(signal.SIGINT, before)


def with_time_left(config: Any, later: float = 0.0) -> Any:
    """Return a configuration of a search that ends with the command's time.

    From here on there may be an answer even if the time is over.

    Args:
        config: The configuration.
        later: Time that the command needs after the search [s].
    """
    _end_looking()
    return replace(config, timeout=max(min(config.timeout, time_left()) - later, MIN_TIMEOUT))


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
    if not _interruptible():
        yield
        return
    import resource

    late = InputError(f"{what} takes more than {seconds:g} s of processor time; use simpler shapes")
    limits = resource.getrlimit(resource.RLIMIT_DATA)
    most = memory + _data_size()
    least = most if limits[1] == resource.RLIM_INFINITY else min(most, limits[1])
    with _interrupted(seconds, time.process_time, late):  # its thread starts with enough memory
        try:
            resource.setrlimit(resource.RLIMIT_DATA, (least, limits[1]))
            yield
        except MemoryError:
            more = f"{memory / 1e9:g} GB of memory"
            raise InputError(f"{what} takes more than {more}; use simpler shapes") from None
        finally:
            resource.setrlimit(resource.RLIMIT_DATA, limits)


def _data_size() -> int:
    """Return the data size of the process [bytes]; 0 if unknown."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[5])
    except (OSError, ValueError, IndexError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def _interruptible() -> bool:
    alone = threading.current_thread() is threading.main_thread()
    return alone and hasattr(signal, "SIGPROF")


@contextmanager
def _interrupted(
    seconds: float,
    clock: Clock,
    error: MomaposError,
    interrupted: threading.Event | None = None,
    *,
    ends_process: bool = False,
) -> Iterator[None]:
    """Interrupt the main thread after a time, wherever it is, until the block ends.

    Blocks may be nested. In another thread, nothing is interrupted.

    Args:
        seconds: Time from now on [s].
        clock: Measures it.
        error: Raised if the time is over.
        interrupted: Set when the work is interrupted. From then on its errors are consequences:
            some libraries catch every exception while they import others, and fail later.
        ends_process: Whether to end the process if a single call goes on after the time is over.
    """
    if not _interruptible():
        yield
        return
    interrupted = interrupted or threading.Event()
    until, due, done = clock() + seconds, threading.Event(), threading.Event()
    last = processor_time() + seconds + _OVERTIME if ends_process else math.inf
    before = signal.getsignal(signal.SIGPROF)

    def stop(number: int, frame: FrameType | None) -> None:
        if due.is_set() and not done.is_set():
            due.clear()
            if not _imports_numpy():
                interrupted.set()
                raise _TooLong(done)
        elif callable(before):
            before(number, frame)

    def watch() -> None:
        nonlocal until
        while not done.wait(_PERIOD):
            now = clock()
            if now > until:
                due.set()
                _thread.interrupt_main(signal.SIGPROF)
                until = now + GRACE_PERIOD  # to clean up
            elif processor_time() > last and not done.is_set():
                os.write(2, f"momapos: {one_line(str(error))}\n".encode())
                os._exit(EXIT_STATUS["timeout"])

    # A thread, not a system timer: signals may be blocked when the program starts, and a timer
    # fires only once, which is too few if the exception is raised in a destructor.
    watcher = threading.Thread(target=watch, daemon=True)
    signal.signal(signal.SIGPROF, stop)
    try:
        watcher.start()
        yield
    except _TooLong as late:
        if late.args != (done,):
            raise
        done.set()
        raise error from None
    except Exception:
        if not interrupted.is_set():
            raise
        done.set()
        raise error from None
    finally:
        done.set()
        watcher.join()
        signal.signal(signal.SIGPROF, before)
