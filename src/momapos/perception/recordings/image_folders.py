"""Read folders of images with one file of poses: TUM RGB-D and Open3D."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import FileFormatError, read_text_bounded

from .layouts import FrameFiles, Layout, image_names, list_names, read_intrinsics
from .pose_files import numbers_of, poses_at, read_log, read_rows, read_tum
from .validation import check_intrinsics

if TYPE_CHECKING:
    from jaxtyping import Float, Int

TUM_POSES = ("groundtruth.txt", "trajectory.txt", "CameraTrajectory.txt", "KeyFrameTrajectory.txt")
"""File names of trajectories: recorded ones, and those from SLAM programs."""
TUM_DEPTH = 5000.0
"""Units of TUM's depth images per meter [-]."""
TUM_CAMERAS = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3),
    "freiburg2": (520.9, 521.0, 325.1, 249.7),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
"""Focal lengths and centers of the benchmark's cameras, by folder name [px]."""
DEFAULT_CAMERA = (525.0, 525.0, 319.5, 239.5)
"""Focal lengths and center of an unknown sensor of this type [px]."""
MAX_TIME_DIFFERENCE = 0.02
"""Between a color and a depth image of one frame [s]."""
O3D_COLOR = ("color", "rgb", "image")
O3D_POSES = ("trajectory.log", "scene/trajectory.log", "odometry.log")
O3D_CAMERAS = ("camera_intrinsic.json", "intrinsic.json", "camera.json", "intrinsics.json")
MAX_JSON = 100_000


def find_walk(folder: Path) -> Layout | None:
    """Recognize a folder of images with one file of poses.

    Returns:
        Its layout; None if it is not such a folder.

    Raises:
        FileFormatError: It is one, but lacks something, or a file is not usable.
    """
    names = set(list_names(folder))
    if {"rgb.txt", "depth.txt"} <= names:
        return _tum(folder, names)
    log = next((folder / name for name in O3D_POSES if (folder / name).is_file()), None)
    color = next((name for name in O3D_COLOR if name in names), None)
    if log is not None and color is not None and "depth" in names and "pose" not in names:
        return _open3d(folder, log, color)
    return None


def _tum(folder: Path, names: set[str]) -> Layout:
    """Pair color and depth by the nearest times, and interpolate poses of the trajectory."""
    file = next((folder / name for name in TUM_POSES if name in names), None)
    if file is None:
        raise FileFormatError(f"{folder}: has no poses; expected {' or '.join(TUM_POSES)}")
    color_times, colors = _listed(folder, "rgb.txt")
    depth_times, depths = _listed(folder, "depth.txt")
    pairs = _paired(color_times, depth_times)
    if not len(pairs):
        raise FileFormatError(
            f"{folder}: no image of rgb.txt is within {MAX_TIME_DIFFERENCE:g} s of one of "
            "depth.txt; their times must be from one clock"
        )
    found, known = poses_at(*read_tum(file), depth_times[pairs[:, 1]])
    if not known.any():
        raise FileFormatError(
            f"{file}: has no pose at the time of any image; the times must be from one clock"
        )
    frames = tuple(
        FrameFiles(colors[a].stem, colors[a], depths[b], T)
        for (a, b), T, good in zip(pairs.tolist(), found, known, strict=True)
        if good
    )
    left = len(color_times) - len(frames)
    warnings = (f"{folder}: {left} of {len(color_times)} color images have no depth or pose at "
                "their time",) if left else ()  # fmt: skip
    known_camera = next((v for name, v in TUM_CAMERAS.items() if name in folder.name), None)
    K, assumed = _camera(folder, known_camera)
    return Layout(folder, frames, K, None, (*assumed, *warnings), TUM_DEPTH)


def _listed(folder: Path, name: str) -> tuple[Float[np.ndarray, " n"], list[Path]]:
    """Return the times [s], ascending, and files of a list of images, which must be inside the
    folder."""
    rows = read_rows(folder / name, 2)
    times = np.array([numbers_of(words[:1], where)[0] for where, words in rows])
    for where, (_, file) in rows:
        if Path(file).is_absolute() or ".." in Path(file).parts:
            raise FileFormatError(f"{where}: {file!r:.80} is not inside the folder of the scan")
    order = np.argsort(times, kind="stable")
    return times[order], [folder / rows[k][1][1] for k in order]


def _paired(one: Float[np.ndarray, " n"], other: Float[np.ndarray, " m"]) -> Int[np.ndarray, "k 2"]:
    """Return the indices of times that are mutually nearest, within `MAX_TIME_DIFFERENCE`."""
    near, back = _nearest(one, other), _nearest(other, one)
    mutual = back[near] == np.arange(len(one))
    close = np.abs(one - other[near]) <= MAX_TIME_DIFFERENCE
    return np.column_stack([np.arange(len(one)), near])[mutual & close]


def _nearest(one: Float[np.ndarray, " n"], other: Float[np.ndarray, " m"]) -> Int[np.ndarray, " n"]:
    after = np.clip(np.searchsorted(other, one), 1, max(len(other) - 1, 1))
    before = np.minimum(after - 1, len(other) - 1)
    after = np.minimum(after, len(other) - 1)
    return np.where(np.abs(other[before] - one) <= np.abs(other[after] - one), before, after)


def _open3d(folder: Path, log: Path, color: str) -> Layout:
    """Pair color and depth in the order of their names, with poses by frame number."""
    colors, depths = image_names(folder / color), image_names(folder / "depth")
    if len(colors) != len(depths):
        raise FileFormatError(
            f"{folder}: has {len(colors)} images in {color} but {len(depths)} in depth; they are "
            "paired in the order of their names"
        )
    poses = read_log(log)
    beyond = [number for number in poses if not 0 <= number < len(colors)]
    if beyond:
        raise FileFormatError(
            f"{log}: has a pose of frame {beyond[0]}, but there are {len(colors)} images, counted "
            "from 0"
        )
    frames = tuple(
        FrameFiles(Path(colors[k]).stem, folder / color / colors[k], folder / "depth" / depths[k],
                   poses[k])
        for k in sorted(poses)
    )  # fmt: skip
    left = len(colors) - len(frames)
    warnings = (
        (f"{folder}: {left} of {len(colors)} frames have no pose in {log.name}",) if left else ()
    )
    camera = next((folder / name for name in O3D_CAMERAS if (folder / name).is_file()), None)
    if camera is not None:
        return Layout(folder, frames, _pinhole(camera), None, warnings)
    K, assumed = _camera(folder, None)
    return Layout(folder, frames, K, None, (*assumed, *warnings))


def _pinhole(file: Path) -> Float[np.ndarray, "3 3"]:
    try:
        data = json.loads(read_text_bounded(file, MAX_JSON))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{file}: damaged JSON ({error})") from error
    values = data.get("intrinsic_matrix") if isinstance(data, dict) else None
    if not isinstance(values, list) or len(values) != 9:
        raise FileFormatError(f"{file}: intrinsic_matrix must be a list of 9 numbers")
    numbers = numbers_of([str(value) for value in values], str(file))
    return check_intrinsics(np.array(numbers).reshape(3, 3).T, str(file))


def _camera(
    folder: Path, known: Sequence[float] | None
) -> tuple[Float[np.ndarray, "3 3"], tuple[str, ...]]:
    file = folder / "camera-intrinsics.txt"
    if file.is_file():
        return read_intrinsics(file), ()
    fx, fy, cx, cy = known or DEFAULT_CAMERA
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    text = (
        f"{folder}: no camera-intrinsics.txt; assumed focal length {fx:g}, center ({cx:g}, {cy:g})"
    )
    return K, (text,)
