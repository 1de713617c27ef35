"""Decode images in ROS messages: raw and compressed, color and depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import FileFormatError

from .images import MAX_PIXELS, read_color, read_depth, to_meters

if TYPE_CHECKING:
    from jaxtyping import Float32, UInt8

_CHANNELS = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1}
_DEPTHS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
_DEPTH_HEADER_BYTES = 12  # of image_transport's compressedDepth, before its PNG


def depth_of(message: Any, scale: float, where: str) -> Float32[np.ndarray, "h w"]:
    """Decode a depth message, raw or compressed.

    Args:
        message: A sensor_msgs Image or CompressedImage from rosbags.
        scale: Units of 16-bit depth per meter; 32-bit depth is in meters.
        where: Name in errors.

    Returns:
        Depth [m], 0 where unmeasured.

    Raises:
        FileFormatError: It is damaged or has another encoding.
    """
    if not hasattr(message, "encoding"):
        data = message.data.tobytes()
        if "compressedDepth" in message.format:
            if "32FC1" in message.format:
                raise FileFormatError(f"{where}: compressed depth must be 16UC1, not 32FC1")
            data = data[_DEPTH_HEADER_BYTES:]
        return read_depth(data, scale, where)
    if message.encoding not in _DEPTHS:
        raise FileFormatError(
            f"{where}: depth has encoding {message.encoding!r:.40}; expected {', '.join(_DEPTHS)}"
        )
    raw = _pixels(message, _DEPTHS[message.encoding], 1, where)[..., 0]
    return to_meters(raw, 1.0 if raw.dtype.kind == "f" else scale)


def color_of(message: Any, where: str) -> UInt8[np.ndarray, "h w 3"]:
    """Decode a color message, raw or compressed.

    Raises:
        FileFormatError: It is damaged or has another encoding.
    """
    if not hasattr(message, "encoding"):
        return read_color(message.data.tobytes(), where)
    if message.encoding not in _CHANNELS:
        raise FileFormatError(
            f"{where}: color has encoding {message.encoding!r:.40}; expected {', '.join(_CHANNELS)}"
        )
    raw = _pixels(message, "u1", _CHANNELS[message.encoding], where)
    if raw.shape[2] == 1:
        return np.repeat(raw, 3, axis=2)
    rgb = raw[..., 2::-1] if message.encoding.startswith("bgr") else raw[..., :3]
    return np.ascontiguousarray(rgb)


def _pixels(message: Any, kind: str, channels: int, where: str) -> np.ndarray:
    """Return the pixels (h, w, channels) of a raw image, without row padding."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    row = width * channels * dtype.itemsize
    data = np.asarray(message.data, np.uint8)
    if not 0 < height * width <= MAX_PIXELS or step < row or len(data) < height * step:
        raise FileFormatError(
            f"{where}: {width} x {height} pixels do not fit its {len(data)} bytes"
        )
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    return rows.view(dtype).reshape(height, width, channels)
