"""Coarse drawing while the view moves, for browsers that draw slowly.

While its camera moves, a browser sends its pose with each frame, so that the interval between these
messages is the frame time. A fast browser draws all points of a scan at all times. A slow one draws
few of them until its camera rests, and until a drag or a motion ends. It has both already: a few
bytes tell it which ones to show.
"""

from __future__ import annotations

import asyncio
import itertools
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from viser import _messages as messages

if TYPE_CHECKING:
    from viser import CameraHandle, ClientHandle, ViserServer

SLOW_FRAME_TIME = 0.12
"""A browser whose frames take longer is slow [s]."""
FRAME_GAPS = 2
"""Intervals of which the shortest counts as the frame time: longer ones may be pauses of the hand
[-]."""
SAME_FRAME_TIME, NEW_MOVEMENT_TIME = 0.03, 5.0
"""Messages that are closer together belong to one frame; after a longer interval a new movement
begins [s]."""
SLOW_FRAMES = 100.0
"""A browser counts as slow for this many frame times; measuring again then costs about 1 % of the
time [-]."""
REST_TIME = 0.4
"""A camera rests when it has sent nothing for this time, or for two frames [s]."""


class FrameTimer:
    """Measures how fast a browser draws while its camera moves."""

    def __init__(self) -> None:
        self._seen: deque[float] = deque(maxlen=FRAME_GAPS + 1)
        self._until = 0.0
        self.gap = 0.0
        """Last known frame time [s]."""

    def camera_moved(self, now: float) -> bool:
        """Record a camera message at a time [s]; return whether the browser is slow."""
        since = now - self._seen[-1] if self._seen else NEW_MOVEMENT_TIME
        if since > NEW_MOVEMENT_TIME:
            self._seen.clear()
        if since >= SAME_FRAME_TIME:
            self._seen.append(now)
            if len(self._seen) > FRAME_GAPS:
                self.gap = min(b - a for a, b in itertools.pairwise(self._seen))
                if self.gap > SLOW_FRAME_TIME:
                    self._until = now + SLOW_FRAMES * self.gap
        return self.slow(now)

    def slow(self, now: float) -> bool:
        """Return whether the browser counts as slow at a time [s]."""
        return now < self._until


class BrowserDetail:
    """Switches one browser between fine and coarse; called by the server's own thread only."""

    def __init__(self, switch: Callable[[bool], None], wanted: Callable[[], bool]) -> None:
        """Begin with fine.

        Args:
            switch: Makes the browser show coarse (True) or fine (False).
            wanted: Returns whether there is anything to draw coarsely.
        """
        self._switch, self._wanted = switch, wanted
        self._timer = FrameTimer()
        self._rest: asyncio.TimerHandle | None = None
        self.coarse = False

    def camera_moved(self, loop: asyncio.AbstractEventLoop) -> None:
        """Handle a message of the camera in the running loop."""
        self._moved(loop, slow=self._timer.camera_moved(loop.time()))

    def scene_moved(self, loop: asyncio.AbstractEventLoop) -> None:
        """Handle a movement in the scene, after which a browser sends no message."""
        self._moved(loop, slow=self._timer.slow(loop.time()))

    def _moved(self, loop: asyncio.AbstractEventLoop, *, slow: bool) -> None:
        if slow and self._wanted():
            self._show(coarse=True)
        self.close()
        if self.coarse:
            rest = max(REST_TIME, 2 * self._timer.gap)
            self._rest = loop.call_later(rest, lambda: self._show(coarse=False))

    def close(self) -> None:
        """Cancel the timer."""
        if self._rest is not None:
            self._rest.cancel()
            self._rest = None

    def _show(self, *, coarse: bool) -> None:
        if coarse != self.coarse:
            self.coarse = coarse
            self._switch(coarse)


class DetailControl:
    """Watches the cameras of all browsers."""

    def __init__(
        self, server: ViserServer, *, fine: str, coarse: str, wanted: Callable[[], bool]
    ) -> None:
        """Start to watch.

        Args:
            server: The server of the page.
            fine: The node that is shown at rest; nothing else may set its visibility.
            coarse: The node that replaces it in slow browsers; hidden at first.
            wanted: Returns whether there is anything to draw coarsely.
        """
        self._fine, self._coarse, self._wanted = fine, coarse, wanted
        self._browsers: dict[int, BrowserDetail] = {}
        self._loop = server.get_event_loop()
        server.on_client_connect(self._connected)
        server.on_client_disconnect(self._disconnected)

    def scene_moved(self) -> None:
        """Report a movement that all browsers draw, such as a dragged base; for any thread."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._scene_moved)

    def _scene_moved(self) -> None:
        for browser in self._browsers.values():
            browser.scene_moved(self._loop)

    async def _connected(self, client: ClientHandle) -> None:
        browser = BrowserDetail(lambda coarse: self._switch(client, coarse=coarse), self._wanted)
        self._browsers[client.client_id] = browser

        async def moved(_: CameraHandle) -> None:
            browser.camera_moved(asyncio.get_running_loop())

        client.camera.on_update(moved)

    async def _disconnected(self, client: ClientHandle) -> None:
        browser = self._browsers.pop(client.client_id, None)
        if browser is not None:
            browser.close()

    def _switch(self, client: ClientHandle, *, coarse: bool) -> None:
        """Set the visibility of shared nodes in one browser, for which viser has no function."""
        with client.atomic():
            for node, visible in ((self._fine, not coarse), (self._coarse, coarse)):
                client._websock_connection.queue_message(
                    messages.SetSceneNodeVisibilityMessage(node, visible)
                )
