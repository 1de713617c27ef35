"""Sending what a user has set to all browsers once more, after the last change.

viser sends a change to all browsers except the one that made it. If two browsers change one control
at the same time, the later one receives the earlier change after its own, and would keep showing
it. viser has no function that sends a value the server has already.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from viser import _messages as messages

WAIT = 1.0
"""Time after the last change of a control until its value is sent again [s]."""


class Resender:
    """Sends values again, with a timer for each control and node."""

    def __init__(self, *, wait: float = WAIT) -> None:
        """Set the time to wait after the last change [s]."""
        self._wait = wait
        self._lock = threading.Lock()
        self._timers: dict[str, threading.Timer] = {}
        self._closed = False

    def control(self, handle: Any) -> None:
        """Send a control again that a user has changed."""
        self._soon(handle._impl.uuid, partial(send_value, handle))

    def node(self, node: Any) -> None:
        """Send a node again that a user has dragged."""
        self._soon(node.name, partial(send_pose, node))

    def close(self) -> None:
        """Cancel all timers."""
        with self._lock:
            self._closed = True
            for timer in self._timers.values():
                timer.cancel()

    def _soon(self, key: str, send: Callable[[], None]) -> None:
        with self._lock:
            if self._closed:
                return
            before = self._timers.pop(key, None)
            if before is not None:
                before.cancel()
            timer = self._timers[key] = threading.Timer(self._wait, self._now, (key, send))
            timer.daemon = True
            timer.start()

    def _now(self, key: str, send: Callable[[], None]) -> None:
        with self._lock:
            if self._closed or self._timers.get(key) is not threading.current_thread():
                return  # it has changed again
            del self._timers[key]
        send()


def send_value(handle: Any) -> None:
    """Send the value of a control to all browsers, unless it was removed."""
    own = handle._impl
    if not own.removed:
        own.gui_api._websock_interface.queue_message(
            messages.GuiUpdateMessage(own.uuid, {"value": own.value})
        )


def send_pose(node: Any) -> None:
    """Send the pose of a node to all browsers, unless it was removed."""
    own = node._impl
    if not own.removed:
        x, y, z = (float(v) for v in own.position)
        a, b, c, d = (float(v) for v in own.wxyz)
        own.api._queue_scene_message(messages.SetPositionMessage(own.name, (x, y, z)))
        own.api._queue_scene_message(messages.SetOrientationMessage(own.name, (a, b, c, d)))
