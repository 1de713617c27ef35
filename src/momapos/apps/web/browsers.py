"""Counting the connected browsers, so that work stops without any."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from viser import ViserServer

GRACE_PERIOD = 5.0
"""Time after the last browser disconnects until work stops; a reload takes less [s]."""


class Browsers:
    """Counts the connected browsers, and reports when none is left."""

    def __init__(self, server: ViserServer, on_empty: Callable[[], None]) -> None:
        """Start to count.

        Args:
            server: The server of the page.
            on_empty: Called after the grace period without any browser.
        """
        self._on_empty = on_empty
        self._lock = threading.Lock()
        self._connected: set[int] = set()
        self._timer: threading.Timer | None = None
        server.on_client_connect(self._add)
        server.on_client_disconnect(self._remove)

    def close(self) -> None:
        """Cancel the timer."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()

    def _add(self, client: Any) -> None:
        with self._lock:
            self._connected.add(client.client_id)

    def _remove(self, client: Any) -> None:
        with self._lock:
            self._connected.discard(client.client_id)
            if self._timer is not None:
                self._timer.cancel()
            self._timer = threading.Timer(GRACE_PERIOD, self._report)
            self._timer.daemon = True
            self._timer.start()

    def _report(self) -> None:
        with self._lock:
            empty = not self._connected
        if empty:
            self._on_empty()
