"""A worker thread that runs the newest request and can cancel the running one."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from momapos.core import Clock, MomaposError

LOG = logging.getLogger(__name__)


class Stopped(Exception):
    """Raised by the clock of canceled work."""


@dataclass
class StopSignal:
    """Cancels work through the clock that the work calls."""

    sent: threading.Event = field(default_factory=threading.Event)

    def clock(self) -> float:
        """Return the time [s].

        Raises:
            Stopped: The work is canceled.
        """
        if self.sent.is_set():
            raise Stopped
        return time.perf_counter()


class LatestWorker:
    """Runs one request at a time; of the waiting ones only the newest runs."""

    def __init__(self, name: str, report: Callable[[str], None]) -> None:
        """Start the thread.

        Args:
            name: Name of the thread.
            report: Called with one line if a request fails.
        """
        self._report = report
        self._changed = threading.Condition()
        self._next: Callable[[Clock], None] | None = None
        self._running: StopSignal | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, work: Callable[[Clock], None], *, stop_running: bool = False) -> None:
        """Run a piece of work next, in place of a waiting one.

        Args:
            work: Gets a clock, which it should call regularly.
            stop_running: Whether to cancel the running work.
        """
        with self._changed:
            self._next = work
            if stop_running and self._running is not None:
                self._running.sent.set()
            self._changed.notify_all()

    def stop(self) -> None:
        """Cancel the running and the waiting work."""
        with self._changed:
            self._next = None
            if self._running is not None:
                self._running.sent.set()

    @property
    def busy(self) -> bool:
        """Whether work runs or waits."""
        with self._changed:
            return self._running is not None or self._next is not None

    @property
    def waiting(self) -> bool:
        """Whether a newer request waits."""
        with self._changed:
            return self._next is not None

    def wait(self, timeout: float) -> bool:
        """Wait until no work runs or waits; return whether that was in time [s]."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self._running is None and self._next is None, timeout
            )

    def close(self, timeout: float = 5.0) -> None:
        """Cancel all work and end the thread; wait for it at most this long [s]."""
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
                self._running = StopSignal()
                clock = self._running.clock
            assert work is not None
            try:
                work(clock)
            except Stopped:
                LOG.debug("work canceled")
            except (MomaposError, OSError) as error:
                self._report(str(error))
            except Exception as error:  # the page survives a bug, and reports it
                LOG.exception("a request of the page failed")
                self._report(f"bug in momapos: {type(error).__name__}: {error}")
            finally:
                with self._changed:
                    self._running = None
                    self._changed.notify_all()
