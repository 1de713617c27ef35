"""Refusing connections from other websites, and messages that a page does not send.

A browser lets any website open a websocket to any address, including the loopback address. The
request names the website as its origin. viser does not check it, and has no hook for a check. It
prints the version that a program names, and a traceback for what is no request.
"""

from __future__ import annotations

import http
import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import viser
from websockets.asyncio import server as sockets

from momapos.core import MissingExtraError

if TYPE_CHECKING:
    from websockets.datastructures import Headers
    from websockets.http11 import Request, Response

LOOPBACK = ("127.0.0.1", "localhost", "::1")
_SCHEMES = ("http", "https")
"""A TLS proxy in front of the page keeps the host name and changes the scheme."""
_REFUSED = "connections from other websites are refused\n"
_OTHER_VERSION = "this page needs another version; reload it\n"
_PATCHED = threading.Lock()
_PROTOCOL = f"viser-v{viser.__version__}"
LOG = logging.getLogger(__name__)
LOG.addFilter(lambda record: record.exc_info is None)  # what is no request has no use for us


def allowed(headers: Headers, *, loopback: bool) -> bool:
    """Return whether a request comes from our own page, or from a program that is no browser.

    Args:
        headers: Headers of the request; only browsers name an origin.
        loopback: Whether the page listens on the loopback address. The request must then use a
            name of it, which prevents DNS rebinding.
    """
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or len(origins) > 1:
        return False
    try:
        name = urlsplit(f"//{hosts[0]}").hostname
    except ValueError:
        return False
    if loopback and name not in LOOPBACK:
        return False
    return not origins or origins[0].lower() in (f"{s}://{hosts[0].lower()}" for s in _SCHEMES)


@contextmanager
def own_pages_only(host: str, admits: Callable[[object], bool] = lambda _: True) -> Iterator[None]:
    """Make servers that viser starts in the context refuse requests of other websites (403).

    viser passes no options to its websocket server, so the context replaces its constructor. A
    viser that starts its server in another way is refused.

    Args:
        host: Address that the server listens on.
        admits: Returns whether viser may read a message.

    Raises:
        MissingExtraError: No server was started that the context could guard.
    """
    loopback, started = host in LOOPBACK, list[bool]()

    def guarded(
        handler: Callable[..., Any], *args: Any, process_request: Callable[..., Any], **options: Any
    ) -> Any:
        def check(connection: Any, request: Request) -> Any:
            if not allowed(request.headers, loopback=loopback):
                return connection.respond(http.HTTPStatus.FORBIDDEN, _REFUSED)
            upgrade = request.headers.get("Upgrade") is not None
            if upgrade and request.headers.get("Sec-WebSocket-Protocol") != _PROTOCOL:
                return connection.respond(http.HTTPStatus.BAD_REQUEST, _OTHER_VERSION)
            answer: Response | None = process_request(connection, request)
            return answer

        async def handle(connection: Any) -> None:
            receive = connection.recv

            async def admitted() -> Any:
                while not admits(raw := await receive()):
                    pass
                return raw

            connection.recv = admitted
            await handler(connection)

        started.append(True)
        return serve(handle, *args, process_request=check, logger=LOG, **options)

    with _PATCHED:
        serve = sockets.serve
        sockets.serve = guarded  # type: ignore[assignment,misc]
        try:
            yield
        finally:
            sockets.serve = serve  # type: ignore[misc]
    if not started:
        raise MissingExtraError(
            f"viser {viser.__version__} starts its server in a way that momapos cannot guard "
            "against other websites; install another version: pip install 'viser>=1.1,<1.2'"
        )
