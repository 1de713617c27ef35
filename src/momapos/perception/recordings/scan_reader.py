"""Read a scan of any supported format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from momapos.core import (
    FileFormatError,
    as_path,
    finite_number,
    open_regular,
    whole_number,
)
from momapos.model.records import Scan

from .bags import BagTopics, read_bag
from .clouds import read_cloud
from .image_folders import find_walk
from .layouts import MILLIMETERS, find_layout, list_names, read_frames, refuse_links_out
from .pose_check import MAX_DRIFT, check_poses

ACCEPTED = (
    "a folder with frame-000000.color.jpg, .depth.png and .pose.txt (7-Scenes, 3DMatch), or with "
    "color/, depth/, pose/ and intrinsic/ (ScanNet export, OpenMask3D), or with rgb.txt, depth.txt "
    "and groundtruth.txt (TUM), or with color/, depth/ and trajectory.log (Open3D); a cloud (.ply, "
    ".pcd); or a recording (.bag, .mcap, the folder of a ROS 2 bag)"
)
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
) -> Scan:
    """Read a scan; the format is detected from the content.

    Args:
        path: A folder of posed images, a cloud, or a ROS recording.
        max_frames: Maximum number of frames. If there are more, sharp frames are chosen that are
            spread over the camera's path.
        depth_scale: Units of integer depth per meter; float depth is in meters. If None, 5000 in
            TUM's folders and 1000 elsewhere.
        topics: Topics of a recording to use, if their names are ambiguous.

    Returns:
        The frames in recording order, the cloud if there is one, and warnings about skipped frames
        and assumptions.

    Raises:
        FileFormatError: It is not a scan or is damaged; one line says what is wrong and where.
        InputError: The frames do not fit into memory, or an argument is out of range.
        MissingExtraError: A recording is given, and rosbags is not installed.
    """
    path = as_path("path", path)
    if depth_scale is not None:
        depth_scale = finite_number("depth_scale", depth_scale, 1e-9)
    max_frames = whole_number("max_frames", max_frames, 1)
    if path.is_dir():
        return _read_folder(path, max_frames, depth_scale, topics)
    if not path.is_file():
        raise FileFormatError(f"{path}: no such scan; expected {ACCEPTED}")
    kind = _kind(path)
    if kind == "cloud":
        cloud, warnings = read_cloud(path)
        return Scan(path.stem, (), cloud, warnings)
    if kind == "recording":
        frames, warnings = read_bag(
            path, max_frames=max_frames, depth_scale=depth_scale or MILLIMETERS, topics=topics
        )
        return _checked(Scan(path.stem, frames, None, warnings))
    raise FileFormatError(f"{path}: not a scan; expected {ACCEPTED}")


def _read_folder(
    path: Path, max_frames: int, depth_scale: float | None, topics: BagTopics | None
) -> Scan:
    refuse_links_out(path)
    name = path.resolve().name
    layout = find_walk(path) or find_layout(path)
    if layout is None:
        inside = path if (path / "metadata.yaml").is_file() else _only_file(path)
        if inside == path:
            frames, warnings = read_bag(
                path, max_frames=max_frames, depth_scale=depth_scale or MILLIMETERS, topics=topics
            )
            return _checked(Scan(name, frames, None, warnings))
        scan = read_scan(inside, max_frames=max_frames, depth_scale=depth_scale, topics=topics)
        return replace(scan, name=name)
    frames, skipped = read_frames(layout, max_frames=max_frames, depth_scale=depth_scale)
    warnings = (*layout.warnings, *skipped)
    file = _cloud_in(path)
    if file is None:
        if frames[0].depth is None:
            raise FileFormatError(f"{path}: has neither depth images nor a cloud (scene.ply)")
        return _checked(Scan(name, frames, None, warnings))
    cloud, notes = read_cloud(file, np.array([frame.T_world_camera[:3, 3] for frame in frames]))
    return Scan(name, frames, cloud, (*warnings, *notes))


def _checked(scan: Scan) -> Scan:
    """Check poses against depth: drop frames with wrong poses, and warn about drift."""
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
    frames = tuple(frame for k, frame in enumerate(scan.frames) if k not in check.lost)
    return replace(scan, frames=frames, warnings=tuple(warnings), notes=(check.text(),))


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
