"""Serving the page: on the loopback address by default, and nothing that other sites send.

A browser lets any website open a websocket to any address, including the loopback address. The
request names the website as its origin. viser does not check it, and has no hook for a check. It
prints the version that a program names, and a traceback for what is no request.

viser sets any property of a control to any value that a message names, also for all other browsers,
and a message that it cannot decode ends in a traceback. Here each message must have a type that the
page uses, with fields of the right types and ranges. A control takes only values that its user
could choose: a listed option, a number within the range, a text of bounded length.
"""

from __future__ import annotations

import errno
import http
import logging
import math
import socket
import struct
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias
from urllib.parse import urlsplit

import msgspec
import viser
from msgspec import Meta
from viser import _messages as messages
from websockets.asyncio import server as sockets

from momapos.core import Cache, InputError, MissingExtraError

from .opened import Opened, OpenedScan
from .page import Page
from .panel import send_pose, send_value, set_theme

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


MAX_BYTES = 8192
"""Size of a message that is no image [B]; those of the page have less than 1,000."""
MAX_TEXT = 200
"""Length of a text [-]."""
MAX_PIXELS = 4096
"""Width and height of an image [px]."""
MAX_LENGTH = 1e4
"""Coordinates [m]."""
UPRIGHT = 1e-3
"""Height [m] and tilt [-] that a dragged base may have by rounding."""
PNG = b"\x89PNG\r\n\x1a\n"

Number: TypeAlias = Annotated[float, Meta(ge=-1e12, le=1e12)]
Length: TypeAlias = Annotated[float, Meta(ge=-MAX_LENGTH, le=MAX_LENGTH)]
Unit: TypeAlias = Annotated[float, Meta(ge=-1.01, le=1.01)]
Pixels: TypeAlias = Annotated[int, Meta(ge=0, le=4 * MAX_PIXELS)]
Name: TypeAlias = Annotated[str, Meta(max_length=MAX_TEXT)]
Point: TypeAlias = tuple[Length, Length, Length]
Direction: TypeAlias = tuple[Unit, Unit, Unit]
Rotation: TypeAlias = tuple[Unit, Unit, Unit, Unit]
Modifier: TypeAlias = (
    Literal["cmd/ctrl", "alt", "shift", "cmd/ctrl+alt", "cmd/ctrl+shift", "alt+shift",
            "cmd/ctrl+alt+shift"]
    | None
)  # fmt: skip
Owner: TypeAlias = Literal[""]
"""The page draws the same for all browsers; only drawings for one of them have an owner."""


class Sent(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    """A message of a browser."""


class Camera(Sent, tag="ViewerCameraMessage"):
    """The camera has moved."""

    wxyz: Rotation
    position: Point
    fov: Annotated[float, Meta(gt=0.0, lt=math.pi)]
    near: Number
    far: Number
    image_height: Pixels
    image_width: Pixels
    look_at: Point
    up_direction: Direction


class Update(Sent, tag="GuiUpdateMessage"):
    """A user has changed a control."""

    uuid: Name
    updates: dict[Literal["value"], bool | float | Name]


class Command(Sent, tag="CommandTriggerMessage"):
    """A user has pressed a key."""

    uuid: Name


class Click(Sent, tag="SceneNodeClickMessage"):
    """A user has clicked a node."""

    name: Name
    instance_index: Annotated[int, Meta(ge=0, le=10**6)] | None
    ray_origin: Point
    ray_direction: Direction
    screen_pos: tuple[Number, Number]
    modifier: Modifier
    owner: Owner = ""


class Pointer(Sent, tag="ScenePointerMessage"):
    """A user has clicked anywhere."""

    event_type: Literal["click"]
    ray_origin: Point
    ray_direction: Direction
    screen_pos: Annotated[tuple[tuple[Number, Number], ...], Meta(min_length=1, max_length=1)]
    modifier: Modifier


class Drag(Sent, tag="TransformControlsUpdateMessage"):
    """A user drags the base."""

    name: Name
    wxyz: Rotation
    position: Point
    owner: Owner = ""


class DragStart(Sent, tag="TransformControlsDragStartMessage"):
    """A drag begins."""

    name: Name
    owner: Owner = ""


class DragEnd(Sent, tag="TransformControlsDragEndMessage"):
    """A drag ends."""

    name: Name
    owner: Owner = ""


class Image(Sent, tag="GetRenderResponseMessage"):
    """An image of the view that the page has requested."""

    payload: bytes
    render_uuid: Name


Known: TypeAlias = Camera | Update | Command | Click | Pointer | Drag | DragStart | DragEnd | Image
DECODER = msgspec.msgpack.Decoder(Known)
IMAGE = Image.__struct_config__.tag
"""Tag of the only large message."""


class MessageGate:
    """Decides which messages reach the page."""

    def __init__(self) -> None:
        """Let nothing pass until the server is known."""
        self.server: viser.ViserServer | None = None
        self.refused = 0
        """Number of messages that were refused [-]."""

    def admits(self, raw: object) -> bool:
        """Return whether a message may be read.

        All browsers are sent the value again that a refused one would have replaced.
        """
        correct = self._correction(raw)
        if correct is None:
            return True
        self.refused += 1
        correct()
        return False

    def _correction(self, raw: object) -> Callable[[], None] | None:
        """Return what corrects the browsers after a message; None if the message is right."""
        if self.server is None or not isinstance(raw, bytes):
            return _nothing
        if len(raw) > MAX_BYTES and str(IMAGE).encode() not in raw[:MAX_BYTES] + raw[-MAX_BYTES:]:
            return _nothing
        try:
            message: Known = DECODER.decode(raw)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            return _nothing
        match message:
            case Update():
                return self._update(message)
            case Drag() | DragStart() | DragEnd():
                return self._drag(message)
            case Command():
                return (
                    None if message.uuid in self.server.gui._command_handle_from_uuid else _nothing
                )
            case Click():
                known = message.name in self.server.scene._handle_from_node_name
                return None if known and _finite(message) else _nothing
            case Image():
                return None if small_png(message.payload) else _nothing
            case _:
                return None if _finite(message) else _nothing

    def _update(self, message: Update) -> Callable[[], None] | None:
        assert self.server is not None
        handle: Any = self.server.gui._gui_input_handle_from_uuid.get(message.uuid)
        if handle is None or len(message.updates) != 1:
            return _nothing
        if accepts(handle, message.updates["value"]):
            return None
        button = isinstance(handle, viser.GuiButtonHandle | viser.GuiButtonGroupHandle)
        return _nothing if button else lambda: send_value(handle)

    def _drag(self, message: Drag | DragStart | DragEnd) -> Callable[[], None] | None:
        assert self.server is not None
        handle: Any = self.server.scene._handle_from_transform_controls_name.get(message.name)
        if handle is None:
            return _nothing
        if isinstance(message, Drag) and not _on_the_floor(message):
            return lambda: send_pose(handle)
        return None


def accepts(handle: Any, value: bool | float | str) -> bool:
    """Return whether a user could set a control to a value.

    Args:
        handle: The control.
        value: The value that a browser sends.
    """
    if not handle.visible or handle.disabled:
        return False
    match handle:
        case viser.GuiCheckboxHandle() | viser.GuiButtonHandle():
            return isinstance(value, bool)
        case viser.GuiDropdownHandle() | viser.GuiButtonGroupHandle():
            return value in handle.options
        case viser.GuiTextHandle():
            return isinstance(value, str) and value.isprintable()
        case viser.GuiSliderHandle() | viser.GuiNumberHandle():
            return _within(handle, value)
        case _:
            return False


def _within(handle: Any, value: bool | float | str) -> bool:
    """Return whether a number is in the range of its control; NaN is in none."""
    if isinstance(value, bool | str) or not math.isfinite(value):
        return False
    if isinstance(handle.value, int) and value != int(value):
        return False
    low = -math.inf if handle.min is None else handle.min
    high = math.inf if handle.max is None else handle.max
    return bool(low <= value <= high)


def _finite(message: Sent) -> bool:
    """Return whether all numbers are finite, and directions are not zero."""
    for name in message.__struct_fields__:
        value = getattr(message, name)
        values = value if isinstance(value, tuple) else (value,)
        numbers = [one for one in values if isinstance(one, float)]
        if not all(math.isfinite(one) for one in numbers):
            return False
        if name in ("ray_direction", "up_direction", "wxyz") and math.hypot(*numbers) < 0.5:
            return False
    return True


def _on_the_floor(message: Drag) -> bool:
    """Return whether a dragged pose is one of a base: on the floor and upright."""
    _, a, b, _ = message.wxyz
    return _finite(message) and max(abs(message.position[2]), abs(a), abs(b)) <= UPRIGHT


def small_png(content: bytes) -> bool:
    """Return whether content begins as a PNG whose size is bounded; its decoder checks the rest."""
    if len(content) < 24 or not content.startswith(PNG) or content[12:16] != b"IHDR":
        return False
    width, height = struct.unpack(">II", content[16:24])
    return 0 < width <= MAX_PIXELS and 0 < height <= MAX_PIXELS


def _nothing() -> None:
    """Correct nothing."""


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
    gate = MessageGate()
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
