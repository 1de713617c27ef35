"""Decode color and depth images with checks and limits, and choose the frames to keep."""

from __future__ import annotations

import io
import math
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from momapos.core import FileFormatError, in_threads, whole_number

from .validation import evenly_spaced

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


STEP, TURN = 0.15, np.radians(10.0)
"""A camera that moved or turned by this sees something else [m], [rad]."""
FRAMES_PER_STEP = 4
"""Frames per such motion: several images of a place improve depth [-]."""
MIN_FRAMES = 30
"""Frames of a camera that hardly moves [-]."""
TIME_SHARE = 0.1
"""Share of the frames that are spread over time instead of motion [-]."""
CANDIDATES = 4
"""Neighboring frames whose sharpness is compared [-]."""


def choose(
    poses: Float[np.ndarray, "n 4 4"],
    limit: int,
    sharpness: Callable[[int], float] | None = None,
) -> list[int]:
    """Choose frames of a recording.

    If there are more than `limit`, the recording is divided into stretches of equal motion, and the
    sharpest frame of each is chosen: at 30 Hz, neighbors differ only in blur.

    Args:
        poses: Poses of all frames in recording order, camera to world.
        limit: Maximum number of frames.
        sharpness: Sharpness of a frame, called by several threads. If None, the middle frame of
            each stretch is chosen, and the first and the last frame at the ends.

    Raises:
        InputError: The limit is below 1.
    """
    whole_number("max_frames", limit, 1)
    if len(poses) <= limit:
        return list(range(len(poses)))
    stretches, middles = _stretches(poses, limit)
    if sharpness is None:
        return middles
    few = [[one[k] for k in evenly_spaced(len(one), CANDIDATES)] for one in stretches]
    among = [index for stretch in few for index in stretch]
    sharp = dict(zip(among, in_threads(sharpness, among), strict=True))
    return [max(stretch, key=lambda index: sharp[index]) for stretch in few]


def _stretches(poses: Float[np.ndarray, "n 4 4"], limit: int) -> tuple[list[list[int]], list[int]]:
    """Return the frames of stretches of equal motion, in order, and the middle frame of each.

    Empty stretches are dropped; the first starts and the last ends in its middle.
    """
    moved = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    turned = np.einsum("nij,nij->n", poses[1:, :3, :3], poses[:-1, :3, :3])
    angles = np.arccos(np.clip((turned - 1) / 2, -1, 1))
    motion = np.minimum(moved / STEP + angles / TURN, 1.0)  # a jump counts as one new place
    whole = float(motion.sum())
    count = int(np.clip(np.ceil(FRAMES_PER_STEP * whole), min(MIN_FRAMES, limit), limit))
    steps = (1 - TIME_SHARE) * motion / max(whole, 1e-9) + TIME_SHARE / len(motion)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    place = path / path[-1] * (count - 1)
    stretch = np.round(place).astype(int)
    members = [np.flatnonzero(stretch == k) for k in np.unique(stretch)]
    off = np.abs(place - stretch)
    return [one.tolist() for one in members], [int(one[np.argmin(off[one])]) for one in members]


def sharpness_of(colors: Sequence[Path]) -> Callable[[int], float]:
    """Return a function that measures the sharpness of images by their index."""

    def sharpness(index: int) -> float:
        try:
            gray = read_small_gray(colors[index])
        except FileFormatError:  # reported when it is read
            return -np.inf
        return laplacian_variance(gray)

    return sharpness


def laplacian_variance(gray: Float[np.ndarray, "h w"]) -> float:
    """Return the variance of the Laplacian of an image, which is small if it is blurred."""
    if min(gray.shape) < 3:
        return 0.0
    middle = gray[1:-1, 1:-1]
    around = gray[:-2, 1:-1] + gray[2:, 1:-1] + gray[1:-1, :-2] + gray[1:-1, 2:]
    return float((around - 4 * middle).var())
