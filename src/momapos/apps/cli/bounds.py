"""Bounds of work on files from strangers: it ends in one line, not when the machine gives up."""

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
"""Processor time [s] and memory [bytes] that looking at a robot may take."""
_PERIOD = 0.05
"""How often the processor's time is looked at [s]."""


class _TooLong(BaseException):
    """No `Exception`: whoever catches those of a library must not catch this one."""


@contextmanager
def within_bounds(what: str, seconds: float = SECONDS, memory: int = MEMORY) -> Iterator[None]:
    """Do work within bounds, where the system can set them and no other thread asks.

    Args:
        what: Begins the message.
        seconds: Processor time [s].
        memory: Data that the process may take beyond what it has [bytes].

    Raises:
        InputError: The work takes more.
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

    # A thread, not a timer of the system: signals may be blocked where a program is started, and a
    # timer asks once, which is once too few where the exception is raised in a destructor.
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
        raise InputError(f"{what} takes more than {more}; give simpler shapes") from None
    except MemoryError:
        more = f"{memory / 1e9:g} GB of memory"
        raise InputError(f"{what} takes more than {more}; give simpler shapes") from None
    finally:
        done.set()
        resource.setrlimit(resource.RLIMIT_DATA, limits)
        watch.join()
        signal.signal(signal.SIGPROF, before)


def _data_size() -> int:
    """How much data the process has [bytes]; 0 where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[5])
    except (OSError, ValueError, IndexError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def _watch(until: float, done: threading.Event) -> None:
    """Interrupt the main thread from a processor time on, until its work is done."""
    while not done.wait(_PERIOD):
        if time.process_time() > until:
            _thread.interrupt_main(signal.SIGPROF)
