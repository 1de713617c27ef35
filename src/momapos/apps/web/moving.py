"""What takes long to draw is drawn coarsely while things move, at browsers that are slow.

A browser tells where it looks from with each picture that it draws while its camera moves, so that
how often it tells is how quickly it draws. One with a graphics card draws all points of a scan all
the time; one without draws few of them until its camera rests, and until what is dragged or played
does. Both are at the browser already: it is told by a few bytes which of them it shows, and other
browsers are told nothing.
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

SLOW = 0.12
"""Pictures that come farther apart than this are slow [s]."""
GAPS = 2
"""So many times between pictures are looked at, of which the shortest counts: the others may be
pauses of the hand [-]."""
TOGETHER, APART = 0.03, 5.0
"""What is told within so short a time is of one picture; what is told after so long a time is of
another movement [s]."""
TRUST = 100.0
"""A browser counts as slow for so many times longer than a picture took: to find it out again then
costs few hundredths of the time [-]."""
REST = 0.4
"""A camera rests when nothing was told for so long, or for two pictures [s]."""


class Pace:
    """How quickly a browser draws while its camera moves."""

    def __init__(self) -> None:
        self._seen: deque[float] = deque(maxlen=GAPS + 1)
        self._until = 0.0
        self.gap = 0.0
        """Time between pictures, as it was last known [s]."""

    def moved(self, now: float) -> bool:
        """Take in that the camera was told of at a time [s]; whether the browser is slow."""
        since = now - self._seen[-1] if self._seen else APART
        if since > APART:
            self._seen.clear()
        if since >= TOGETHER:
            self._seen.append(now)
            if len(self._seen) > GAPS:
                times = list(self._seen)
                self.gap = min(b - a for a, b in itertools.pairwise(times))
                if self.gap > SLOW:
                    self._until = now + TRUST * self.gap
        return self.slow(now)

    def slow(self, now: float) -> bool:
        """Whether the browser counts as slow at a time [s]."""
        return now < self._until


class Look:
    """One browser: whether it shows what is fine, or what is coarse.

    Called by the server's own thread alone.
    """

    def __init__(self, tell: Callable[[bool], None], wanted: Callable[[], bool]) -> None:
        """Begin with what is fine.

        Args:
            tell: Has the browser show what is coarse, or what is fine.
            wanted: Whether there is anything to be drawn coarsely.
        """
        self._tell, self._wanted = tell, wanted
        self._pace = Pace()
        self._rest: asyncio.TimerHandle | None = None
        self.coarse = False

    def moved(self, loop: asyncio.AbstractEventLoop) -> None:
        """The camera has moved; the loop is the one that this is called in."""
        self._stir(loop, slow=self._pace.moved(loop.time()))

    def stirred(self, loop: asyncio.AbstractEventLoop) -> None:
        """Something else has moved, of which a browser does not tell when it has drawn it."""
        self._stir(loop, slow=self._pace.slow(loop.time()))

    def _stir(self, loop: asyncio.AbstractEventLoop, *, slow: bool) -> None:
        if slow and self._wanted():
            self._show(coarse=True)
        self.close()
        if self.coarse:
            self._rest = loop.call_later(max(REST, 2 * self._pace.gap), self._rests)

    def close(self) -> None:
        """Wait for rest no more."""
        if self._rest is not None:
            self._rest.cancel()
            self._rest = None

    def _rests(self) -> None:
        self._show(coarse=False)

    def _show(self, *, coarse: bool) -> None:
        if coarse != self.coarse:
            self.coarse = coarse
            self._tell(coarse)


class Moving:
    """Watches the cameras of all browsers."""

    def __init__(
        self, server: ViserServer, *, fine: str, coarse: str, wanted: Callable[[], bool]
    ) -> None:
        """Start to watch.

        Args:
            server: Whose browsers.
            fine: The node that is shown at rest; whether it is visible nobody else says.
            coarse: The node that is shown instead where the camera of a slow browser moves; it is
                hidden from all at first.
            wanted: Whether there is anything in them.
        """
        self._fine, self._coarse, self._wanted = fine, coarse, wanted
        self._looks: dict[int, Look] = {}
        self._loop = server.get_event_loop()
        server.on_client_connect(self._came)
        server.on_client_disconnect(self._went)

    def stirred(self) -> None:
        """Something moves in all browsers, as the base that is dragged; any thread may say so."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._stirred)

    def _stirred(self) -> None:
        for look in self._looks.values():
            look.stirred(self._loop)

    async def _came(self, client: ClientHandle) -> None:
        look = Look(lambda coarse: self._tell(client, coarse=coarse), self._wanted)
        self._looks[client.client_id] = look

        async def moved(_: CameraHandle) -> None:
            look.moved(asyncio.get_running_loop())

        client.camera.on_update(moved)

    async def _went(self, client: ClientHandle) -> None:
        look = self._looks.pop(client.client_id, None)
        if look is not None:
            look.close()

    def _tell(self, client: ClientHandle, *, coarse: bool) -> None:
        """Show nodes of all browsers to this one, or hide them; viser has no way to say so."""
        with client.atomic():
            for node, visible in ((self._fine, not coarse), (self._coarse, coarse)):
                client._websock_connection.queue_message(
                    messages.SetSceneNodeVisibilityMessage(node, visible)
                )
