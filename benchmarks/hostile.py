"""What browsers send to a page, and what hostile programs could send."""

from __future__ import annotations

import math
import random
from typing import Any

import msgspec

CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (3.0, 3.0, 3.0),
    "fov": 1.0, "near": 0.01, "far": 100.0, "image_height": 720, "image_width": 1280,
    "look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip
SPECIAL: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63 - 1, -(2**63), 1e20, 12345678901234567890, -1e300,
    math.nan, math.inf, 0.1, 59.5, "", "x", "fetch", "/etc/passwd", "../../x.json", "a" * 5000,
    "<img src=x onerror=alert(1)>", "\x00\x1b[2J", b"", b"\x89PNG" + b"\x00" * 40, [], [1, 2, 3],
    [[[[[]]]]], {}, {"value": 1}, {"__binary_index": 0, "dtype": "<f4"}, "open", "max", "evict",
)  # fmt: skip
"""Values that replace right ones."""
PROPERTIES = ("value", "visible", "disabled", "label", "options", "update_cb", "uuid", "gui_api",
              "props", "__class__", "min", "content")  # fmt: skip


def right_message(rng: random.Random, ids: list[str], names: list[str]) -> dict[str, Any]:
    """Return a message as a browser sends it, with an id or a name at random."""
    uuid, name = rng.choice(ids), rng.choice(names)
    ray = {"ray_origin": [3.0, -3.0, 2.0], "ray_direction": [-0.6, 0.6, -0.53]}
    messages: tuple[dict[str, Any], ...] = (
        {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": rng.choice(SPECIAL)}},
        {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": True}},
        {"type": "CommandTriggerMessage", "uuid": uuid},
        {"type": "TransformControlsUpdateMessage", "name": "/robot", "owner": "",
         "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [rng.uniform(0, 3), rng.uniform(-3, -1), 0.0]},
        {"type": "TransformControlsDragStartMessage", "name": "/robot", "owner": ""},
        {"type": "TransformControlsDragEndMessage", "name": "/robot", "owner": ""},
        {"type": "SceneNodeClickMessage", "name": name, "instance_index": rng.choice([None, 3]),
         "screen_pos": [0.5, 0.5], "modifier": None, "owner": "", **ray},
        {"type": "ScenePointerMessage", "event_type": "click", "screen_pos": [[0.5, 0.5]],
         "modifier": None, **ray},
        {"type": "GetRenderResponseMessage", "payload": b"\x89PNG", "render_uuid": uuid},
        {"type": "SceneNodeDragMessage", "name": name, "phase": "start"},
        {"type": "FileTransferStartUpload", "source_component_uuid": uuid, "transfer_uuid": "t",
         "filename": "a", "mime_type": "", "part_count": 2, "size_bytes": 10**12},
        {"type": "FileTransferPart", "source_component_uuid": uuid, "transfer_uuid": "t",
         "part_index": 0, "content": b"x" * 1000},
        {"type": "ShareUrlRequest"}, {"type": "GuiFormSubmitMessage", "uuid": uuid},
        {"type": "RunJavascriptMessage", "source": "alert(1)"}, dict(CAMERA),
    )  # fmt: skip
    return dict(rng.choice(messages))


def hostile_frame(rng: random.Random, ids: list[str], names: list[str]) -> bytes | str:
    """Return what a hostile program could send."""
    kind = rng.random()
    if kind < 0.04:
        return rng.randbytes(rng.randrange(200))
    if kind < 0.06:
        return "text"
    message = right_message(rng, ids, names)
    for _ in range(rng.randrange(3)):
        key = rng.choice([*message])
        if rng.random() < 0.2:
            message.pop(key)
        elif key == "updates" and rng.random() < 0.6:
            message[key] = {rng.choice(PROPERTIES): rng.choice(SPECIAL)}
        elif isinstance(message.get(key), list) and message[key] and rng.random() < 0.6:
            values = list(message[key])
            values[rng.randrange(len(values))] = rng.choice(SPECIAL)
            message[key] = values
        else:
            message[key] = rng.choice(SPECIAL)
        if not message:
            break
    frame = msgspec.msgpack.encode(message)
    return frame[: rng.randrange(len(frame))] if rng.random() < 0.03 else frame
