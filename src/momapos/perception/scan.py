"""Reading a scan, whatever it was recorded as."""

from __future__ import annotations

from pathlib import Path

from momapos.errors import FileFormatError, InputError
from momapos.perception.layouts import find_layout, read_frames
from momapos.types import Scan

MILLIMETRES = 1000.0
ACCEPTED = (
    "a folder with frame-000000.color.jpg, .depth.png and .pose.txt (7-Scenes, 3DMatch), "
    "or with color/, depth/, pose/ and intrinsic/ (ScanNet export, OpenMask3D)"
)


def read_scan(path: Path, *, max_frames: int = 150, depth_scale: float = MILLIMETRES) -> Scan:
    """Read a scan; what it is, its content says.

    Args:
        path: Where the scan is.
        max_frames: How many frames to read at most; they are evenly spaced.
        depth_scale: How many units of integer depth are a metre; float depth is in metres.

    Returns:
        The frames in the order they were recorded, with what was skipped or assumed.

    Raises:
        FileFormatError: It is no scan, or a damaged one; one line says what is wrong and where.
        InputError: The frames do not fit into memory.
    """
    path = Path(path)
    if not 0 < depth_scale < float("inf"):
        raise InputError(f"depth_scale is {depth_scale}; it is the units of depth in a metre")
    if not path.is_dir():
        raise FileFormatError(f"{path}: no such scan; expected {ACCEPTED}")
    layout = find_layout(path)
    if layout is None:
        raise FileFormatError(f"{path}: is no scan; expected {ACCEPTED}")
    frames, skipped = read_frames(layout, max_frames=max_frames, depth_scale=depth_scale)
    return Scan(path.resolve().name, frames, warnings=(*layout.warnings, *skipped))
