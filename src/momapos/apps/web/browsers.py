"""Who looks at the page: work for nobody ends."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from viser import ViserServer

GRACE = 5.0
"""Work goes on for so long after the last browser has gone, as one that is reloaded does [s]."""


class Browsers:
    """Counts the browsers, and says when none is left."""

    def __init__(
        self, server: ViserServer, alone: Callable[[], None], *, grace: float = GRACE
    ) -> None:
        """Start to count.

        Args:
            server: Serves the page.
            alone: Is called when the last browser has been gone for a while.
            grace: For how long [s].
        """
        self._alone, self._grace = alone, grace
        self._lock = threading.Lock()
        self._there: set[int] = set()
        self._timer: threading.Timer | None = None
        server.on_client_connect(self._came)
        server.on_client_disconnect(self._went)

    @property
    def count(self) -> int:
        """How many there are."""
        with self._lock:
            return len(self._there)

    def close(self) -> None:
        """Wait for nobody any more."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()

    def _came(self, client: Any) -> None:
        with self._lock:
            self._there.add(client.client_id)

    def _went(self, client: Any) -> None:
        with self._lock:
            self._there.discard(client.client_id)
            if self._timer is not None:
                self._timer.cancel()
            self._timer = threading.Timer(self._grace, self._if_alone)
            self._timer.daemon = True
            self._timer.start()

    def _if_alone(self) -> None:
        if not self.count:
            self._alone()
