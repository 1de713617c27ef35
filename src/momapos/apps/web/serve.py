"""Serving the page, by default on the loopback address only."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import viser
from viser import _messages as messages

from momapos.core import Cache, InputError, MissingExtraError

from .incoming import Gate
from .opened import Opened, OpenedScan
from .origin import own_pages_only
from .page import Page
from .panel import set_theme


class Server(viser.ViserServer):  # type: ignore[misc]  # mypy does not read viser
    """A server that never opens a tunnel to the outside."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse to make the page public."""
        del verbose
        return None


@contextmanager
def served(
    *,
    host: str,
    port: int,
    scenes: Sequence[str],
    robots: Sequence[str],
    scene: str,
    robot: str,
    cache: Cache,
    folder: Path,
    opened: Opened | OpenedScan | None = None,
) -> Iterator[tuple[Page, str]]:
    """Serve the page while the context lasts.

    Args:
        host: Address to listen on.
        port: Port; 0 for a free one.
        scenes, robots, scene, robot, cache, folder, opened: As for `Page`.

    Yields:
        The page, and its URL.

    Raises:
        InputError: The port is in use, or the address does not belong to this machine.
    """
    server = open_server(host, port)
    page = Page(
        server, scenes=scenes, robots=robots, scene=scene, robot=robot, cache=cache,
        folder=folder, opened=opened,
    )  # fmt: skip
    try:
        yield page, f"http://{host}:{server.get_port()}"
    finally:
        page.close()
        with quiet():
            server.stop()


def open_server(host: str, port: int) -> Server:
    """Start a server on exactly this address and port; other websites cannot connect to it.

    Raises:
        InputError: The port is in use, or the address does not belong to this machine.
        MissingExtraError: The installed viser cannot be guarded.
    """
    check_free(host, port)
    gate = Gate()
    server = None
    try:
        with quiet(), own_pages_only(host, gate.admits):
            server = Server(host=host, port=port, label="momapos", verbose=False)
    except MissingExtraError:
        if server is not None:  # it runs without a guard
            server.stop()
        raise
    if port and server.get_port() != port:  # taken meanwhile; viser then uses another port
        with quiet():
            server.stop()
        raise _in_use(port)
    refuse_files(server)
    gate.server = server
    set_theme(server.gui)
    server.scene.world_axes.visible = False
    return server


def refuse_files(server: viser.ViserServer) -> None:
    """Refuse uploads: viser stores files of any size, even without an upload control."""
    for kind in (messages.FileTransferStartUpload, messages.FileTransferPart):
        server.gui._websock_interface.unregister_handler(kind)


def check_free(host: str, port: int) -> None:
    """Check that a port is free.

    Raises:
        InputError: The port is in use or not permitted, or the address is not usable.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"port must be 1 to 65535, or 0 for a free one, not {port}")
    try:
        address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(address[0], address[1]) as tried:
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind(address[4])
    except socket.gaierror as error:
        raise InputError(f"host {host}: unknown address ({error.strerror})") from error
    except PermissionError as error:
        raise InputError(f"port {port}: not permitted ({error.strerror})") from error
    except OSError as error:
        if error.errno == errno.EADDRNOTAVAIL:
            raise InputError(f"host {host}: not an address of this machine") from error
        raise _in_use(port) from error


def _in_use(port: int) -> InputError:
    return InputError(f"port {port} is in use; choose another one, or 0 for a free one")


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress viser's own messages in terminals and notebooks."""
    from rich import get_console  # viser prints with it

    console = get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
