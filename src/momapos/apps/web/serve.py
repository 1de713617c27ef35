"""Serving the page, on this machine alone unless somebody says otherwise."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import viser
from viser import _messages as messages

from momapos.core import Cache, InputError

from .opened import Opened, OpenedScan
from .origin import own_pages_only
from .page import Page
from .panel import set_theme


class Server(viser.ViserServer):  # type: ignore[misc]  # mypy does not read viser
    """A server that never opens a tunnel to the outside, whoever asks."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: a page would otherwise be reachable by everybody."""
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
    """Serve the page as long as the context lasts.

    Args:
        host: The address on which it listens.
        port: Its port; 0 for any that is free.
        scenes, robots, scene, robot, cache, folder, opened: As for `Page`.

    Yields:
        The page, and its address.

    Raises:
        InputError: The port is in use, or the address is none of this machine.
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
    """Listen at an address and a port, and nowhere else; pages of others are refused.

    Raises:
        InputError: The port is in use, or the address is none of this machine.
    """
    check_free(host, port)
    with quiet(), own_pages_only(host):
        server = Server(host=host, port=port, label="momapos", verbose=False)
    if port and server.get_port() != port:  # somebody took it meanwhile; viser tries others
        with quiet():
            server.stop()
        raise _in_use(port)
    refuse_files(server)
    set_theme(server.gui)
    server.scene.world_axes.visible = False
    return server


def refuse_files(server: viser.ViserServer) -> None:
    """Take no files: viser keeps what is sent, of any size, though no control asks for any."""
    for kind in (messages.FileTransferStartUpload, messages.FileTransferPart):
        server.gui._websock_interface.unregister_handler(kind)


def check_free(host: str, port: int) -> None:
    """Make sure that a port can be listened at.

    Raises:
        InputError: It cannot.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"--port {port} is none; ports go from 1 to 65535, 0 takes a free one")
    try:
        address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(address[0], address[1]) as tried:
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind(address[4])
    except socket.gaierror as error:
        raise InputError(f"--host {host}: no such address ({error.strerror})") from error
    except PermissionError as error:
        raise InputError(f"--port {port}: may not be used ({error.strerror})") from error
    except OSError as error:
        if error.errno == errno.EADDRNOTAVAIL:
            raise InputError(f"--host {host}: is no address of this machine") from error
        raise _in_use(port) from error


def _in_use(port: int) -> InputError:
    return InputError(f"--port {port} is in use; give another one, or 0 for any that is free")


@contextmanager
def quiet() -> Iterator[None]:
    """Keep a server's own remarks off the terminal and out of notebooks; ours say what matters."""
    from rich import get_console  # what viser speaks by

    console = get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
