"""Other websites in the same browser cannot connect to the page."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import viser
from websockets.asyncio import server as sockets
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from momapos.apps.web import serve
from momapos.apps.web.serve import allowed, open_server
from momapos.core.errors import MissingExtraError

SPOKEN = [Subprotocol(f"viser-v{viser.__version__}")]


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    server = open_server("127.0.0.1", 0)
    yield server.get_port()
    server.stop()


def refused(port: int, origin: str | None, host: str | None = None) -> bool:
    """Return whether a websocket with an origin is refused."""
    own = None if origin is None else Origin(origin)
    try:
        with connect(
            f"ws://{host or '127.0.0.1'}:{port}", origin=own, subprotocols=SPOKEN,
            sock=None if host is None else _socket(port),
        ) as socket:  # fmt: skip
            socket.recv(timeout=10.0)
    except InvalidStatus as error:
        return error.response.status_code == 403
    return False


def _socket(port: int) -> object:
    import socket

    return socket.create_connection(("127.0.0.1", port))


def test_another_website_in_the_same_browser_is_refused(port: int) -> None:
    assert refused(port, "http://evil.example")
    assert refused(port, "null")  # a file, or a sandboxed page
    assert refused(port, f"http://127.0.0.1:{port + 1}")


def test_our_page_and_programs_without_an_origin_are_served(port: int) -> None:
    assert not refused(port, f"http://127.0.0.1:{port}")
    assert not refused(port, None)


def test_dns_rebinding_to_the_loopback_address_is_refused(port: int) -> None:
    assert refused(port, f"http://evil.example:{port}", host="evil.example")


def test_viser_is_not_left_patched() -> None:
    before = sockets.serve
    open_server("127.0.0.1", 0).stop()
    assert sockets.serve is before


@pytest.mark.parametrize(
    ("host", "origin", "loopback", "served"),
    [
        ("localhost:8080", "http://localhost:8080", True, True),
        ("[::1]:8080", "http://[::1]:8080", True, True),
        ("robot.lan:8080", "http://robot.lan:8080", False, True),
        ("robot.lan:8080", "https://robot.lan:8080", False, True),
        ("robot.lan:8080", "http://other.lan:8080", False, False),
        ("robot.lan:8080", "http://robot.lan:8080", True, False),
        ("[", "http://[", False, False),
    ],
)
def test_a_request_is_served_if_its_origin_is_the_requested_host(
    host: str, origin: str, loopback: bool, served: bool
) -> None:
    headers = Headers([("Host", host), ("Origin", origin)])
    assert allowed(headers, loopback=loopback) is served


def test_a_server_that_cannot_be_guarded_does_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """A viser that starts its server in another way must not serve without the guard."""
    stopped = []

    class Other:
        """A server that does not use the function that the guard replaces."""

        def __init__(self, **_: object) -> None: ...

        def stop(self) -> None:
            stopped.append(True)

    monkeypatch.setattr(serve, "Server", Other)
    with pytest.raises(MissingExtraError, match="cannot guard against other websites"):
        open_server("127.0.0.1", 0)
    assert stopped == [True]
