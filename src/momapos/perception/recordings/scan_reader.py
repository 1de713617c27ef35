"""Read a scan of any supported format, such as folders of images with one file of poses."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core import (
    FileFormatError,
    as_path,
    finite_number,
    open_regular,
    read_text_bounded,
    resolved,
    whole_number,
)
from momapos.model.records import Frame, Scan

from .bags import BagTopics, read_bag
from .clouds import read_cloud
from .conventions import (
    MAX_DRIFT,
    CameraAxes,
    PoseCheck,
    PoseDirection,
    Stated,
    check_poses,
    with_conventions,
)
from .layouts import (
    MILLIMETERS,
    FrameFiles,
    Layout,
    find_layout,
    image_names,
    list_names,
    read_frames,
    read_intrinsics,
    refuse_links_out,
)
from .ply import FAR
from .validation import check_depth_unit, check_intrinsics

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


ACCEPTED = (
    "a folder with frame-000000.color.jpg, .depth.png and .pose.txt (7-Scenes, 3DMatch), or with "
    "color/, depth/, pose/ and intrinsic/ (ScanNet export, OpenMask3D), or with rgb.txt, depth.txt "
    "and groundtruth.txt (TUM), or with color/, depth/ and trajectory.log (Open3D); a cloud (.ply, "
    ".pcd); or a recording (.bag, .mcap, the folder of a ROS 2 bag)"
)
UpAxis = Literal["x", "-x", "y", "-y", "z", "-z"]
UP_AXES: Mapping[UpAxis, tuple[float, float, float]] = {
    "x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0),
    "z": (0.0, 0.0, 1.0), "-z": (0.0, 0.0, -1.0),
}  # fmt: skip
_CLOUDS = (".ply", ".pcd")
_RECORDINGS = (".bag", ".mcap")
_HEADS = (
    (b"ply", "cloud"),
    (b"# .PCD", "cloud"),
    (b"VERSION", "cloud"),
    (b"#ROSBAG V2.0", "recording"),
    (b"\x89MCAP0\r\n", "recording"),
    (b"SQLite format 3", "recording"),
)


def read_scan(
    path: Path,
    *,
    max_frames: int = 150,
    depth_scale: float | None = None,
    topics: BagTopics | None = None,
    poses: PoseDirection | None = None,
    axes: CameraAxes | None = None,
    up: UpAxis | None = None,
) -> Scan:
    """Read a scan; the format is detected from the content.

    Args:
        path: A folder of posed images, a cloud, or a ROS recording.
        max_frames: Maximum number of frames. If there are more, sharp frames are chosen that are
            spread over the camera's path.
        depth_scale: Units of integer depth per meter; float depth is in meters. If None, 5000 in
            TUM's folders and 1000 elsewhere, unless surfaces agree better by far with another.
        topics: Topics of a recording to use, if their names are ambiguous.
        poses: Direction of the poses. If None, from camera to world, unless surfaces agree better
            by far if they are inverted.
        axes: Camera axes. If None, OpenCV's, unless surfaces agree better by far with OpenGL's.
        up: Axis of the scan's frame that points up. If None, it is found.

    Returns:
        The frames in recording order, the cloud if there is one, and warnings about skipped frames
        and assumptions.

    Raises:
        FileFormatError: It is not a scan or is damaged; one line says what is wrong and where.
        InputError: The frames do not fit into memory, an argument is out of range, or surfaces
            agree under no conventions.
        MissingExtraError: A recording is given, and rosbags is not installed.
    """
    path = as_path("path", path)
    if depth_scale is not None:
        depth_scale = finite_number("depth_scale", depth_scale, 1e-9)
    max_frames = whole_number("max_frames", max_frames, 1)
    stated = Stated(poses, axes, depth_scale)
    scan = _read(path, max_frames, stated, topics)
    return replace(scan, up=None if up is None else np.array(UP_AXES[up]))


def _read(path: Path, max_frames: int, stated: Stated, topics: BagTopics | None) -> Scan:
    if path.is_dir():
        return _read_folder(path, max_frames, stated, topics)
    if not path.is_file():
        raise FileFormatError(f"{path}: no such scan; expected {ACCEPTED}")
    kind = _kind(path)
    if kind == "cloud":
        cloud, warnings = read_cloud(path)
        return Scan(path.stem, (), cloud, warnings, origin=cloud.origin)
    if kind == "recording":
        return _read_recording(path, path.stem, max_frames, stated, topics)
    raise FileFormatError(f"{path}: not a scan; expected {ACCEPTED}")


def _read_recording(
    path: Path, name: str, max_frames: int, stated: Stated, topics: BagTopics | None
) -> Scan:
    scale = stated.scale or MILLIMETERS
    frames, warnings = read_bag(path, max_frames=max_frames, depth_scale=scale, topics=topics)
    frames, empty = _with_depth(frames, path)
    frames, said = with_conventions(frames, scale, stated, str(path))
    check_depth_unit(frames, scale, str(path))
    return _checked(Scan(name, frames, None, (*warnings, *empty, *said)))


def _read_folder(path: Path, max_frames: int, stated: Stated, topics: BagTopics | None) -> Scan:
    refuse_links_out(path)
    name = resolved(path).name
    layout = find_walk(path) or find_layout(path)
    if layout is None:
        inside = path if (path / "metadata.yaml").is_file() else _only_file(path)
        if inside == path:
            return _read_recording(path, name, max_frames, stated, topics)
        return replace(_read(inside, max_frames, stated, topics), name=name)
    scale = stated.scale or layout.depth_scale
    frames, skipped = read_frames(layout, max_frames=max_frames, depth_scale=scale)
    frames, empty = _with_depth(frames, path)
    frames, said = with_conventions(frames, scale, stated, str(path))
    check_depth_unit(frames, scale, str(path))
    warnings = (*layout.warnings, *skipped, *empty, *said)
    file = _cloud_in(path)
    if file is None:
        if frames[0].depth is None:
            raise FileFormatError(f"{path}: has neither depth images nor a cloud (scene.ply)")
        return _checked(Scan(name, frames, None, warnings))
    cloud, notes = read_cloud(file, np.array([frame.T_world_camera[:3, 3] for frame in frames]))
    scan = Scan(name, frames, cloud, (*warnings, *notes))
    return scan if cloud.origin is None else _moved(scan, cloud.origin)


def _with_depth(frames: Sequence[Frame], path: Path) -> tuple[tuple[Frame, ...], tuple[str, ...]]:
    """Leave out frames whose depth images measure nothing; the warning names them.

    A covered lens or a lost connection gives such images; recordings without depth keep all frames.

    Raises:
        FileFormatError: No frame is left.
    """
    empty = [f.name for f in frames if f.depth is not None and not (f.depth > 0).any()]
    if not empty:
        return tuple(frames), ()
    if len(empty) == len(frames):
        raise FileFormatError(f"{path}: no depth image has a measured pixel")
    left = tuple(frame for frame in frames if frame.depth is None or (frame.depth > 0).any())
    names = ", ".join(empty[:3])
    text = f"left out {len(empty)} of {len(frames)} frames whose depth images are empty ({names})"
    return left, (text,)


def _moved(scan: Scan, origin: Float[np.ndarray, "3"]) -> Scan:
    """Return a scan whose frames are seen from another origin."""
    T = np.eye(4)
    T[:3, 3] = -origin
    frames = tuple(replace(f, T_world_camera=T @ f.T_world_camera) for f in scan.frames)
    return replace(scan, frames=frames, origin=origin)


def _checked(scan: Scan) -> Scan:
    """Check poses against depth: drop frames with wrong poses, and warn about drift."""
    middle = np.round(np.median([frame.T_world_camera[:3, 3] for frame in scan.frames], axis=0))
    if np.abs(middle).max() > FAR:
        scan = _moved(scan, middle)
    check = check_poses(scan.frames)
    if check is None:
        return scan
    warnings = list(scan.warnings)
    if check.lost:
        names = ", ".join(scan.frames[k].name for k in check.lost[:3])
        warnings.append(
            f"dropped {len(check.lost)} of {len(scan.frames)} frames whose poses do not agree with "
            f"the depth of the frames before and after ({names})"
        )
    if check.drift is not None and check.drift > MAX_DRIFT:
        warnings.append(
            f"the poses drifted by {100 * check.drift:.0f} cm between visits of the same place, so "
            "objects appear blurred or twice; scan in one slow round, or align the poses"
        )
    first, last = _longest(len(scan.frames), check)
    if check.jumps:
        names = ", ".join(scan.frames[k].name for k in check.jumps[:3])
        warnings.append(
            f"the poses jump at {len(check.jumps)} frames ({names}), so the scan is split there; "
            f"its longest part is used, {scan.frames[first].name} to {scan.frames[last - 1].name} "
            f"({last - first} of {len(scan.frames)} frames)"
        )
    frames = tuple(
        frame for k, frame in enumerate(scan.frames)
        if first <= k < last and k not in check.lost
    )  # fmt: skip
    return replace(scan, frames=frames, warnings=tuple(warnings), notes=(check.text(),))


def _longest(count: int, check: PoseCheck) -> tuple[int, int]:
    """Return the start and the end of the part between jumps with the most frames."""
    edges = (0, *check.jumps, count)
    return max(pairwise(edges), key=lambda part: part[1] - part[0])


def _kind(path: Path) -> str | None:
    with open_regular(path) as file:
        head = file.read(64)
    return next((kind for start, kind in _HEADS if head.startswith(start)), None)


def _only_file(folder: Path) -> Path:
    names = [n for n in list_names(folder) if n.lower().endswith((*_CLOUDS, *_RECORDINGS))]
    if len(names) != 1:
        found = f"has {', '.join(sorted(names)[:5])}; give one of them" if names else "not a scan"
        raise FileFormatError(f"{folder}: {found}; expected {ACCEPTED}")
    return folder / names[0]


def _cloud_in(folder: Path) -> Path | None:
    """Return the cloud in a folder of frames: scene.ply, or the only one."""
    names = sorted(n for n in list_names(folder) if n.lower().endswith(_CLOUDS))
    if "scene.ply" in names:
        return folder / "scene.ply"
    if len(names) > 1:
        raise FileFormatError(
            f"{folder}: has several clouds ({', '.join(names[:5])}); name the right one scene.ply"
        )
    return folder / names[0] if names else None
