"""Read folders of images with one file of poses: TUM RGB-D and Open3D."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import FileFormatError, read_text_bounded

from .layouts import FrameFiles, Layout, image_names, list_names, read_intrinsics
from .validation import check_intrinsics

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


MAX_BYTES = 50_000_000
MAX_GAP = 0.1
"""Poses are interpolated over gaps up to this [s]."""
MAX_NORM_ERROR = 0.05
"""Deviation of a quaternion's length from 1 [-]."""


def read_rows(path: Path, columns: int) -> list[tuple[str, list[str]]]:
    """Return the rows of words of a text file, without comments, each with its place.

    Args:
        path: The file.
        columns: Number of words per row.

    Raises:
        FileFormatError: A row has another number, or there is none.
    """
    rows = []
    for number, line in enumerate(read_text_bounded(path, MAX_BYTES).splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if words and len(words) != columns:
            raise FileFormatError(f"{path}:{number}: must have {columns} columns, not {len(words)}")
        if words:
            rows.append((f"{path}:{number}", words))
    if not rows:
        raise FileFormatError(f"{path}: has no rows")
    return rows


def numbers_of(words: list[str], where: str) -> list[float]:
    """Convert words to finite numbers.

    Raises:
        FileFormatError: One is not a finite number.
    """
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise FileFormatError(f"{where}: {' '.join(words)[:60]!r} must be numbers") from error
    if not np.isfinite(values).all():
        raise FileFormatError(f"{where}: has a number that is not finite")
    return values


def read_tum(path: Path) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 4 4"]]:
    """Read rows of time [s], tx ty tz [m] and qx qy qz qw: from camera to world.

    Returns:
        Times, ascending, and poses.

    Raises:
        FileFormatError: It has something else, or nothing.
    """
    from scipy.spatial.transform import Rotation

    values = np.array([numbers_of(words, where) for where, words in read_rows(path, 8)])
    values = values[np.argsort(values[:, 0], kind="stable")]
    off = np.abs(np.linalg.norm(values[:, 4:], axis=1) - 1.0)
    if off.max() > MAX_NORM_ERROR:
        raise FileFormatError(f"{path}: has quaternions whose length is not 1")
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(values[:, 4:]).as_matrix()
    poses[:, :3, 3] = values[:, 1:4]
    return values[:, 0], poses


def read_log(path: Path) -> dict[int, Float[np.ndarray, "4 4"]]:
    """Read Open3D's .log: per frame a row of three integers, then four rows of a matrix.

    Returns:
        Matrices from camera to world by frame number, in file order.

    Raises:
        FileFormatError: It has something else, or a frame twice.
    """
    lines = [line for line in read_text_bounded(path, MAX_BYTES).splitlines() if line.strip()]
    if not lines or len(lines) % 5:
        raise FileFormatError(
            f"{path}: has {len(lines)} rows; a trajectory has five per frame, its number and "
            "a 4 x 4 matrix"
        )
    found: dict[int, Float[np.ndarray, "4 4"]] = {}
    for first in range(0, len(lines), 5):
        where = f"{path}: frame {first // 5}"
        head = numbers_of(lines[first].split(), where)
        rows = [numbers_of(line.split(), where) for line in lines[first + 1 : first + 5]]
        if {len(row) for row in rows} != {4} or not head or head[0] != int(head[0]):
            raise FileFormatError(f"{where}: must be a row of integers and a 4 x 4 matrix")
        if int(head[0]) in found:
            raise FileFormatError(f"{path}: has frame {int(head[0])} twice")
        found[int(head[0])] = np.array(rows)
    return found


def poses_at(
    times: Float[np.ndarray, " n"],
    poses: Float[np.ndarray, "n 4 4"],
    wanted: Float[np.ndarray, " m"],
    gap: float = MAX_GAP,
) -> tuple[Float[np.ndarray, "m 4 4"], Bool[np.ndarray, " m"]]:
    """Interpolate the poses of a camera at given times.

    Args:
        times: Times of the known poses, ascending [s].
        poses: From camera to world.
        wanted: Times to interpolate at [s].
        gap: Poses are not interpolated over longer gaps [s].

    Returns:
        The poses, and whether each is known.
    """
    from scipy.spatial.transform import Rotation

    after = np.clip(np.searchsorted(times, wanted), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    before = np.where(times[after] == wanted, after, before)
    span = times[after] - times[before]
    share = np.clip((wanted - times[before]) / np.maximum(span, 1e-9), 0.0, 1.0)
    away = np.maximum(times[before] - wanted, wanted - times[after])
    known = np.where(away > 0.0, away <= gap / 2, span <= gap)
    start = Rotation.from_matrix(poses[before, :3, :3])
    turn = (Rotation.from_matrix(poses[after, :3, :3]) * start.inv()).as_rotvec()
    found = np.tile(np.eye(4), (len(wanted), 1, 1))
    found[:, :3, :3] = (Rotation.from_rotvec(share[:, None] * turn) * start).as_matrix()
    found[:, :3, 3] = poses[before, :3, 3] + share[:, None] * (
        poses[after, :3, 3] - poses[before, :3, 3]
    )
    return found, known


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
