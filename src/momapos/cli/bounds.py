"""Bounds of work on files from strangers: it ends in one line, not when the machine gives up."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from momapos.errors import InputError

SECONDS, MEMORY = 60.0, 2_000_000_000
"""Processor time [s] and memory [bytes] that looking at a robot may take."""


class _TooLong(BaseException):
    """No `Exception`: whoever catches those of a library must not catch this one."""


@contextmanager
def within_bounds(what: str, seconds: float = SECONDS, memory: int = MEMORY) -> Iterator[None]:
    """Do work within bounds, where the system can watch them and no other thread asks.

    Args:
        what: Begins the message.
        seconds: Processor time [s].
        memory: Data of the process altogether [bytes].

    Raises:
        InputError: The work takes more.
    """
    alone = threading.current_thread() is threading.main_thread()
    if not (alone and hasattr(signal, "setitimer")):
        yield
        return
    import resource

    limits = resource.getrlimit(resource.RLIMIT_DATA)
    least = memory if limits[1] == resource.RLIM_INFINITY else min(memory, limits[1])
    before = signal.signal(signal.SIGPROF, _stop)
    try:
        resource.setrlimit(resource.RLIMIT_DATA, (least, limits[1]))
        signal.setitimer(signal.ITIMER_PROF, seconds)
        yield
    except _TooLong:
        more = f"{seconds:g} s of processor time"
        raise InputError(f"{what} takes more than {more}; give simpler shapes") from None
    except MemoryError:
        more = f"{memory / 1e9:g} GB of memory"
        raise InputError(f"{what} takes more than {more}; give simpler shapes") from None
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
        resource.setrlimit(resource.RLIMIT_DATA, limits)


def _stop(_signal: int, _frame: FrameType | None) -> NoReturn:
    raise _TooLong
