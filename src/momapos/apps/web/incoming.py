"""Checks of what browsers send, before viser or the page reads it.

viser sets any property of a control to any value that a message names, also for all other browsers,
and a message that it cannot decode ends in a traceback. Here each message must have a type that the
page uses, with fields of the right types and ranges. A control takes only values that its user
could choose: a listed option, a number within the range, a text of bounded length.
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import msgspec
import viser
from msgspec import Meta

from .settled import send_pose, send_value

if TYPE_CHECKING:
    from collections.abc import Callable

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


class Gate:
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
