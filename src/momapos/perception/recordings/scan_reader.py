"""Read a scan of any supported format."""

from __future__ import annotations

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
from .image_folders import find_walk
from .layouts import MILLIMETERS, find_layout, list_names, read_frames, refuse_links_out
from .ply import FAR
from .validation import check_depth_unit

if TYPE_CHECKING:
    from jaxtyping import Float

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
