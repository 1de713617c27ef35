"""Work in a thread of its own: the newest request wins, and what runs can be stopped."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from momapos.core import Clock, MomaposError

LOG = logging.getLogger(__name__)


class Stopped(Exception):
    """Raised by the clock of work that nobody waits for any more."""


@dataclass
class Stop:
    """Whether a piece of work is to stop; its clock says so wherever the work looks at it."""

    asked: threading.Event = field(default_factory=threading.Event)

    def clock(self) -> float:
        """The time [s].

        Raises:
            Stopped: The work is to stop.
        """
        if self.asked.is_set():
            raise Stopped
        return time.perf_counter()


class Latest:
    """Runs one request at a time; of those that wait only the newest is run."""

    def __init__(self, name: str, tell: Callable[[str], None]) -> None:
        """Start the thread.

        Args:
            name: Of the thread.
            tell: Is told in one line why a request failed.
        """
        self._tell = tell
        self._changed = threading.Condition()
        self._next: Callable[[Clock], None] | None = None
        self._running: Stop | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, work: Callable[[Clock], None], *, stop_running: bool = False) -> None:
        """Run a piece of work next, instead of whatever else waits.

        Args:
            work: Is given a clock, which it should look at now and then.
            stop_running: Whether what runs now is stopped for it.
        """
        with self._changed:
            self._next = work
            if stop_running and self._running is not None:
                self._running.asked.set()
            self._changed.notify_all()

    def stop(self) -> None:
        """Stop what runs, and forget what waits."""
        with self._changed:
            self._next = None
            if self._running is not None:
                self._running.asked.set()

    @property
    def busy(self) -> bool:
        """Whether anything runs or waits."""
        with self._changed:
            return self._running is not None or self._next is not None

    @property
    def waiting(self) -> bool:
        """Whether a newer request waits for the one that runs."""
        with self._changed:
            return self._next is not None

    def wait(self, timeout: float) -> bool:
        """Wait until nothing runs or waits; whether that came true in time [s]."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self._running is None and self._next is None, timeout
            )

    def close(self, timeout: float = 5.0) -> None:
        """Stop everything and end the thread; waits for it so long at most [s]."""
        with self._changed:
            self._closed = True
        self.stop()
        with self._changed:
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._next is not None)
                if self._closed:
                    return
                work, self._next = self._next, None
                self._running = Stop()
                clock = self._running.clock
            assert work is not None
            try:
                work(clock)
            except Stopped:
                LOG.debug("stopped on request")
            except (MomaposError, OSError) as error:
                self._tell(str(error))
            except Exception as error:  # the page outlives a defect, and says that there is one
                LOG.exception("a request of the page failed")
                self._tell(f"momapos has a defect here: {type(error).__name__}: {error}")
            finally:
                with self._changed:
                    self._running = None
                    self._changed.notify_all()
