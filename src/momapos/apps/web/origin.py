"""Who may speak to the page: a page of somebody else's in the same browser may not.

A browser lets every page open a websocket to any address, the loopback one too, and says in the
request from which page it comes. viser does not look at that, and has no hook for it.
"""

from __future__ import annotations

import http
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from websockets.asyncio import server as sockets

if TYPE_CHECKING:
    from websockets.datastructures import Headers
    from websockets.http11 import Request, Response

LOOPBACK = ("127.0.0.1", "localhost", "::1")
_SCHEMES = ("http", "https")
"""An encrypting proxy before the page keeps the name and changes the scheme."""
_REFUSED = "this page speaks to its own server only\n"
_SWAPPED = threading.Lock()


def allowed(headers: Headers, *, loopback: bool) -> bool:
    """Whether a request comes from our own page, or from no page at all.

    Args:
        headers: Of the request. Programs that are no browsers name no origin.
        loopback: Whether the page is for this machine alone. Then it is asked for by a name of the
            loopback address; another name is one that was bent to lead here.
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
def own_pages_only(host: str) -> Iterator[None]:
    """Servers that viser starts within the context refuse requests of other pages (403).

    viser passes no options on to its websocket server; so that one's constructor is exchanged as
    long as the context lasts.

    Args:
        host: The address that is listened at.
    """
    loopback = host in LOOPBACK

    def guarded(*args: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        def check(connection: Any, request: Request) -> Any:
            if not allowed(request.headers, loopback=loopback):
                return connection.respond(http.HTTPStatus.FORBIDDEN, _REFUSED)
            answer: Response | None = process_request(connection, request)
            return answer

        return serve(*args, process_request=check, **options)

    with _SWAPPED:
        serve = sockets.serve
        sockets.serve = guarded  # type: ignore[assignment,misc]
        try:
            yield
        finally:
            sockets.serve = serve  # type: ignore[misc]
