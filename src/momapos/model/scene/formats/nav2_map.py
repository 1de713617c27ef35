"""Read maps of Nav2 and ROS's map_server: a YAML file and an image of free and occupied cells.

Source: `nav2_map_server/map_io.cpp`. An occupancy from 0 to 1 is the darkness of a pixel.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from momapos.core import FileFormatError, parse_yaml, read_bytes_bounded, read_text_bounded
from momapos.core.geometry import pose_planar

from .imported_room import Message, find_inside

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MAX_YAML_BYTES = 1_000_000
MAX_IMAGE_BYTES = 100_000_000
MAX_PIXELS = 16_000_000
"""Maximum number of pixels: 200 x 200 m in cells of 5 cm [-]."""
MIN_RESOLUTION, MAX_RESOLUTION = 1e-3, 10.0
"""Bounds of the edge of a cell [m]."""
MAX_ORIGIN = 1e4
"""Maximum distance of the map from the world's origin [m]."""
_FORMATS = ("PPM", "PNG", "BMP")
"""Image formats by Pillow's names; PPM includes PGM, in text and binary."""
_KEYS = {
    "image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode", "nodata",
}  # fmt: skip

_HEAD = re.compile(r"(?![\s\ufeff]*[{\[<])(?=.*^image\s*:)(?=.*^resolution\s*:)", re.M | re.S)
"""A text with both keys at the start of a line."""

Mode: TypeAlias = Literal["trinary", "scale", "raw"]
_MODES: tuple[Mode, ...] = ("trinary", "scale", "raw")


@dataclass(frozen=True, eq=False)
class MapGrid:
    """The cells of a map; rows count up from the map's origin."""

    free: Bool[np.ndarray, "rows columns"]
    occupied: Bool[np.ndarray, "rows columns"]
    """Cells that are neither are unknown."""
    resolution: float
    """Edge of a cell [m]."""
    origin: Float[np.ndarray, "3"]
    """Pose of the corner of cell (0, 0): x [m], y [m], yaw [rad]."""
    notes: tuple[str, ...] = ()

    def to_world(self, cells: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Return the world position of points in cells (column, row) from the corner [m]."""
        T = pose_planar(self.origin)
        return np.asarray(np.asarray(cells, float) * self.resolution @ T[:2, :2].T + T[:2, 3])

    def to_cells(self, xy: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Return world positions in cells (column, row) from the corner [-]."""
        T = pose_planar(self.origin)
        return np.asarray((np.asarray(xy, float) - T[:2, 3]) @ T[:2, :2] / self.resolution)


def is_map(text: str) -> bool:
    """Return whether a text is the YAML file of a map."""
    return _HEAD.match(text) is not None


def read_map(path: Path, root: Path) -> MapGrid:
    """Read a map.

    Args:
        path: The YAML file.
        root: Folder that must contain the image.

    Raises:
        FileFormatError: The file or its image is invalid; one line says what is wrong.
    """
    data = Message(parse_yaml(read_text_bounded(path, MAX_YAML_BYTES), path), f"{path}")
    missing = [key for key in ("image", "resolution", "origin") if key not in data]
    if missing:
        raise data.error(f"a map needs {' and '.join(missing)}")
    resolution = _number(data, "resolution", 0.0)
    if not MIN_RESOLUTION <= resolution <= MAX_RESOLUTION:
        raise data.error(
            f"resolution must be from {MIN_RESOLUTION:g} to {MAX_RESOLUTION:g} m per pixel, not "
            f"{resolution:g}"
        )
    origin = data.numbers("origin", 3)
    if np.abs(origin[:2]).max() > MAX_ORIGIN:
        raise data.error("origin is more than 10 km away")
    mode, notes = _mode(data), [f"{path}: {key!r} is not known" for key in set(data.value) - _KEYS]
    occupied, free = _number(data, "occupied_thresh", 0.65), _number(data, "free_thresh", 0.25)
    if not 0.0 <= free <= occupied <= 1.0:
        raise data.error(
            "free_thresh and occupied_thresh must be from 0 to 1, and free_thresh the smaller, "
            f"not {free:g} and {occupied:g}"
        )
    image = find_inside(data.text("image"), [path.parent / data.text("image")], root, path)
    shade, alpha = _pixels(image)
    cells = _cells(shade, alpha, mode, _negate(data), occupied, free)
    return MapGrid(cells[0][::-1], cells[1][::-1], resolution, origin, tuple(sorted(notes)))


def _number(data: Message, key: str, default: float) -> float:
    value = data.value.get(key)
    if value is None:
        return default
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
        raise data.error(f"{key} must be a number, not {value!r:.60}")
    return float(value)


def _mode(data: Message) -> Mode:
    word = data.text("mode").strip().lower() or "trinary"
    for mode in _MODES:
        if word == mode:
            return mode
    raise data.error(f"mode must be one of {', '.join(_MODES)}, not {word!r:.60}")


def _negate(data: Message) -> bool:
    value: Any = data.value.get("negate", 0)
    if value not in (0, 1):
        raise data.error(f"negate must be 0 or 1, not {value!r:.60}")
    return bool(value)


def _cells(
    shade: Float[np.ndarray, "rows columns"],
    alpha: Float[np.ndarray, "rows columns"] | None,
    mode: Mode,
    negate: bool,
    occupied_thresh: float,
    free_thresh: float,
) -> tuple[Bool[np.ndarray, "rows columns"], Bool[np.ndarray, "rows columns"]]:
    """Return which cells are free, and which are occupied, as map_server decides.

    Args:
        shade: Brightness of each pixel, from 0 to 1.
        alpha: Opacity, from 0 to 1; None if all are opaque and the image has no such channel.
        mode: How pixels are read.
        negate: Whether bright pixels are occupied.
        occupied_thresh: Cells above are occupied [-].
        free_thresh: Cells below are free [-].
    """
    if mode == "raw":  # the pixels are occupancies in percent, and unknown above 100
        value = np.round(shade * 255)
        percent = np.where(value <= 100, value / 100, np.nan)
        return percent <= free_thresh, percent >= occupied_thresh
    if mode == "trinary" and alpha is not None:
        shade = (3 * shade + alpha) / 4  # map_server averages the opacity with the colors
    occupancy = shade if negate else 1.0 - shade
    occupied, free = occupancy > occupied_thresh, occupancy < free_thresh
    if mode == "scale" and alpha is not None:  # transparent pixels are unknown
        opaque = alpha >= 1.0
        occupied, free = occupied & opaque, free & opaque
    return free & ~occupied, occupied


def _pixels(
    path: Path,
) -> tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, "rows columns"] | None]:
    """Return the brightness and, if the image has it, the opacity of each pixel, from 0 to 1."""
    from PIL import Image, UnidentifiedImageError

    data = read_bytes_bounded(path, MAX_IMAGE_BYTES)
    try:
        with Image.open(io.BytesIO(data), formats=_FORMATS) as image:
            if image.width * image.height > MAX_PIXELS:
                raise FileFormatError(
                    f"{path}: the image has {image.width} x {image.height} pixels; at most "
                    f"{MAX_PIXELS:,} are supported; crop it or use larger cells"
                )
            deep = image.mode.startswith("I")  # 16 bits
            if not deep:
                clear = "transparency" in image.info or image.mode in ("LA", "PA", "RGBA")
                image = image.convert("RGBA" if clear else "RGB")
            values = np.array(image, np.float32)
    except UnidentifiedImageError as error:
        raise FileFormatError(f"{path}: not an image in PGM, PNG or BMP") from error
    except Image.DecompressionBombError as error:
        raise FileFormatError(
            f"{path}: the image has more than {MAX_PIXELS:,} pixels; crop it or use larger cells"
        ) from error
    except (OSError, ValueError, SyntaxError, EOFError) as error:
        raise FileFormatError(f"{path}: a damaged image ({error})") from error
    if deep:
        return values / 65535, None
    colors = values[..., :3].mean(-1) / 255
    return colors, values[..., 3] / 255 if values.shape[-1] == 4 else None
