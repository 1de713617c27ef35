"""Decode color and depth images from JPEG and PNG, with checks and limits."""

from __future__ import annotations

import io
import math
import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from momapos.core import FileFormatError

if TYPE_CHECKING:
    from jaxtyping import Float, Float32, Num, UInt8

MAX_PIXELS = 40_000_000
_FORMATS = ("JPEG", "PNG")
_DEPTH_MODES = ("I", "I;16", "I;16B", "I;16L")
_UNMEASURED = 65_535
_BROKEN = (
    OSError,
    SyntaxError,
    ValueError,
    EOFError,
    struct.error,
    zlib.error,
    Image.DecompressionBombError,
)

Size = tuple[int, int]
"""Width and height of an image [px]."""


def image_size(source: Path | bytes, name: str | None = None) -> Size:
    """Read only the header of an image.

    Raises:
        FileFormatError: It is missing, damaged, or has more than `MAX_PIXELS`.
    """
    with _open(source, name) as image:
        return image.size


def read_color(source: Path | bytes, name: str | None = None) -> UInt8[np.ndarray, "h w 3"]:
    """Decode a color image.

    Args:
        source: A JPEG or PNG file, or its bytes.
        name: Name in errors; the path if None.

    Raises:
        FileFormatError: It is missing, damaged, or too large.
    """
    name = name or str(source)
    with _open(source, name) as image:
        try:
            return np.array(image.convert("RGB"))
        except _BROKEN as error:
            raise FileFormatError(f"{name}: damaged image ({_brief(error)})") from error


def read_small_gray(source: Path, width: int = 160) -> Float32[np.ndarray, "h w"]:
    """Decode an image small and gray, without decoding a JPEG in full.

    Raises:
        FileFormatError: It is missing, damaged, or too large.
    """
    with _open(source, None) as image:
        try:
            image.draft("L", (2 * width, 2 * width * image.height // max(image.width, 1)))
            gray = image.convert("L")
            return np.asarray(gray.reduce(max(1, gray.width // width)), np.float32)
        except _BROKEN as error:
            raise FileFormatError(f"{source}: damaged image ({_brief(error)})") from error


def read_depth(
    source: Path | bytes, scale: float, name: str | None = None
) -> Float32[np.ndarray, "h w"]:
    """Decode a depth image of 16-bit integers.

    Args:
        source: A PNG file, or its bytes.
        scale: Units per meter.
        name: Name in errors; the path if None.

    Returns:
        Depth [m], 0 where unmeasured (0 or 65535 in the file).

    Raises:
        FileFormatError: It is missing, damaged, too large, or does not have 16 bits.
    """
    name = name or str(source)
    with _open(source, name) as image:
        if image.mode not in _DEPTH_MODES:
            raise FileFormatError(
                f"{name}: has 8 bits per channel ({image.mode}); "
                "depth must be a PNG of one 16-bit channel, in millimeters"
            )
        try:
            raw = np.asarray(image)
        except _BROKEN as error:
            raise FileFormatError(f"{name}: damaged image ({_brief(error)})") from error
    return to_meters(raw, scale)


def to_meters(raw: Num[np.ndarray, "h w"], scale: float) -> Float32[np.ndarray, "h w"]:
    """Scale depth to meters; invalid values (65535 in integers, NaN, negative) become 0."""
    with np.errstate(over="ignore", invalid="ignore"):  # damaged floats count as unmeasured
        depth = raw.astype(np.float32) / np.float32(scale)
    seen = np.isfinite(depth) & (depth > 0)
    if np.issubdtype(raw.dtype, np.integer):
        seen &= raw != _UNMEASURED
    return np.where(seen, depth, np.float32(0))


def match_color(
    color: UInt8[np.ndarray, "h w 3"],
    K_color: Float[np.ndarray, "3 3"],
    K_depth: Float[np.ndarray, "3 3"],
    size: Size,
) -> UInt8[np.ndarray, "h2 w2 3"]:
    """Resample a color image to the rays of the depth camera.

    Both cameras must have the same pose. Rays outside the color image are black.

    Args:
        color: Image of the color camera.
        K_color, K_depth: Intrinsics of both cameras [px], without skew.
        size: Width and height of the depth image [px].

    Returns:
        An image of that size with the depth camera's intrinsics.

    Raises:
        ValueError: The color image covers less than half of the depth image's width or height.
    """
    height, width = color.shape[:2]
    # Intrinsics refer to the center of the first pixel, a region to its edge.
    corners = np.array([[-0.5, -0.5], np.array(size) - 0.5])
    focal, center = np.diag(K_depth)[:2], K_depth[:2, 2]
    corners = (corners - center) / focal * np.diag(K_color)[:2] + K_color[:2, 2] + 0.5
    limit = np.array([width, height], float)
    seen = np.clip(corners, 0, limit)
    if np.any(np.diff(seen, axis=0) < np.maximum(0.5 * np.diff(corners, axis=0), 1.0)):
        raise ValueError("the intrinsics of color and depth belong to different views")
    left, top = (max(0, math.ceil(-edge)) for edge in corners[0])
    right, bottom = (max(0, math.ceil(edge)) for edge in corners[1] - limit)
    if left or top or right or bottom:
        color = np.pad(color, ((top, bottom), (left, right), (0, 0)))
    # Rounding must not push the region out of the image.
    inside = np.array(color.shape[1::-1], float)
    (x0, y0), (x1, y1) = np.clip(corners + np.array([left, top]), 0, inside)
    image = Image.fromarray(color).resize(size, Image.Resampling.BILINEAR, box=(x0, y0, x1, y1))
    return np.asarray(image)


def scaled_intrinsics(K: Float[np.ndarray, "3 3"], old: Size, new: Size) -> np.ndarray:
    """Return the intrinsics (3, 3) of the same view in an image of another size [px]."""
    ratio = np.array(new) / np.array(old)
    K = K.copy()
    K[:2, 2] = (K[:2, 2] + 0.5) * ratio - 0.5
    K[:2, :2] *= ratio[:, None]
    return K


def _open(source: Path | bytes, name: str | None) -> Image.Image:
    name = name or str(source)
    if isinstance(source, Path) and not source.is_file():
        raise FileFormatError(f"{name}: no such file")
    try:
        image = Image.open(
            source if isinstance(source, Path) else io.BytesIO(source), formats=_FORMATS
        )
    except _BROKEN as error:
        raise FileFormatError(f"{name}: not a JPEG or PNG image ({_brief(error)})") from error
    width, height = image.size
    if width * height > MAX_PIXELS:
        image.close()
        raise FileFormatError(
            f"{name}: has {width} x {height} pixels; the limit is {MAX_PIXELS // 10**6} million"
        )
    return image


def _brief(error: BaseException) -> str:
    return " ".join(str(error).split())[:80] or type(error).__name__
