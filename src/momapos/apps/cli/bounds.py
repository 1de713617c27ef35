"""Limit the time and memory of work on untrusted files."""

from __future__ import annotations

import _thread
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from momapos.core import InputError

SECONDS, MEMORY = 60.0, 2_000_000_000
"""Limits for checking a robot: processor time [s] and memory [bytes]."""
_PERIOD = 0.05
"""Interval between checks of the processor time [s]."""


class _TooLong(BaseException):
    """Not an `Exception`, so that handlers in libraries don't catch it."""


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
