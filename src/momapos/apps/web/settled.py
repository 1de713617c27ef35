"""What people set is told to all pages once more when it is quiet.

viser tells a change to all pages but the one that made it. Where two change the same control at
once, the page of the later one hears of the earlier change after its own, and would show it for
good. viser has no way to tell a page what the server knows already; here is one.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from viser import _messages as messages

WAIT = 1.0
"""A control is quiet when nobody has changed it for so long [s]."""


class Settled:
    """Waits until it is quiet, for each thing apart."""

    def __init__(self, *, wait: float = WAIT) -> None:
        """Wait for nothing yet; each time for so long [s]."""
        self._wait = wait
        self._lock = threading.Lock()
        self._timers: dict[str, threading.Timer] = {}
        self._closed = False

    def control(self, handle: Any) -> None:
        """A control was changed on a page."""
        self._soon(handle._impl.uuid, partial(tell_value, handle))

    def node(self, node: Any) -> None:
        """A node was dragged on a page."""
        self._soon(node.name, partial(tell_pose, node))

    def close(self) -> None:
        """Tell nothing any more."""
        with self._lock:
            self._closed = True
            for timer in self._timers.values():
                timer.cancel()

    def _soon(self, key: str, tell: Callable[[], None]) -> None:
        with self._lock:
            if self._closed:
                return
            before = self._timers.pop(key, None)
            if before is not None:
                before.cancel()
            timer = self._timers[key] = threading.Timer(self._wait, self._now, (key, tell))
            timer.daemon = True
            timer.start()

    def _now(self, key: str, tell: Callable[[], None]) -> None:
        with self._lock:
            if self._closed or self._timers.get(key) is not threading.current_thread():
                return  # it was changed again
            del self._timers[key]
        tell()


def tell_value(handle: Any) -> None:
    """Tell all pages what a control says, unless it is gone."""
    own = handle._impl
    if not own.removed:
        own.gui_api._websock_interface.queue_message(
            messages.GuiUpdateMessage(own.uuid, {"value": own.value})
        )


def tell_pose(node: Any) -> None:
    """Tell all pages where a node is, unless it is gone."""
    own = node._impl
    if not own.removed:
        x, y, z = (float(v) for v in own.position)
        a, b, c, d = (float(v) for v in own.wxyz)
        own.api._queue_scene_message(messages.SetPositionMessage(own.name, (x, y, z)))
        own.api._queue_scene_message(messages.SetOrientationMessage(own.name, (a, b, c, d)))
