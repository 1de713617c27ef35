"""Read folders of posed images in the 7-Scenes, ScanNet and OpenMask3D layouts.

7-Scenes and 3DMatch have all files in one folder, `frame-000000.color.jpg` and so on. A ScanNet
export and OpenMask3D have a folder per kind, `color/0.jpg` and so on. All poses are from camera to
world, with OpenCV's camera axes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from momapos.core import FileFormatError, in_threads, read_bytes_bounded, resolved
from momapos.model.records import Frame

from .images import (
    Size,
    choose,
    image_size,
    match_color,
    read_color,
    read_depth,
    scaled_intrinsics,
    sharpness_of,
)
from .validation import (
    Skips,
    check_intrinsics,
    check_memory,
    keep_common_size,
    rigid_pose,
)

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_FILES = 2_000_000
"""Maximum number of files in the folder of a scan [-]."""
MAX_FRAMES_LISTED = 100_000
MAX_READERS = 32
"""Maximum number of threads that read images [-]."""
MAX_TEXT_BYTES = 10_000
MILLIMETERS = 1000.0
SEVEN_SCENES_INTRINSICS = np.array([[585.0, 0, 320], [0, 585.0, 240], [0, 0, 1]])
_In = TypeVar("_In")
_Out = TypeVar("_Out")
_IMAGES = (".jpg", ".jpeg", ".png")


@dataclass(frozen=True, eq=False)
class FrameFiles:
    """Files of one frame."""

    name: str
    color: Path
    depth: Path | None
    pose: Path | Float[np.ndarray, "4 4"]
    """Camera to world, or the file with it."""
    index: int = -1
    """Index among the frames of the folder; `read_frames` sets it."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Contents of a folder of frames, before any image is read."""

    folder: Path
    frames: tuple[FrameFiles, ...]
    K_color: Float[np.ndarray, "3 3"]
    K_depth: Float[np.ndarray, "3 3"] | None
    """None if one matrix is given for both; then it belongs to the color image."""
    warnings: tuple[str, ...] = ()
    depth_scale: float = MILLIMETERS
    """Default units of integer depth per meter [-]."""


def find_layout(folder: Path) -> Layout | None:
    """Recognize a folder of frames by its files.

    Returns:
        Its layout; None if it is not such a folder.

    Raises:
        FileFormatError: It is one, but lacks poses or intrinsics, or has too many files.
    """
    names = set(list_names(folder))
    if any(name.startswith("frame-") and ".color." in name for name in names):
        return _seven_scenes(folder, names)
    if "color" in names and names & {"depth", "pose", "intrinsic"}:
        return _export(folder)
    return None


def read_frames(
    layout: Layout, *, max_frames: int, depth_scale: float | None = None
) -> tuple[tuple[Frame, ...], tuple[str, ...]]:
    """Read the images of a layout.

    Frames without a usable pose are dropped before frames are chosen. Other images are not stored,
    so that a scan of any length takes the memory of `max_frames`.

    Args:
        layout: From `find_layout`.
        max_frames: Maximum number of frames, see `choose`.
        depth_scale: Units of a depth image per meter; the layout's default if None.

    Returns:
        The frames, and one line per kind of skipped frame.

    Raises:
        FileFormatError: No frame is usable, or sizes differ.
        InputError: They do not fit into memory.
    """
    where, scale = str(layout.folder), depth_scale or layout.depth_scale
    skips = Skips(len(layout.frames))
    listed = [replace(files, index=i) for i, files in enumerate(layout.frames)]
    posed = _with_poses(listed, skips)
    skips.refuse_none_left(len(posed), where)
    poses = np.array([T for _, T in posed]).reshape(-1, 4, 4)
    sharpness = sharpness_of([files.color for files, _ in posed])
    chosen = [posed[i] for i in choose(poses, max_frames, sharpness)]
    files = [files for files, _ in chosen]
    sizes = _collect(in_threads(_attempt(_sizes), files, MAX_READERS), skips)
    kept = keep_common_size(sizes, skips, where)
    skips.refuse_none_left(len(kept), where)
    color_size, depth_size = sizes[kept[0]]
    check_memory(len(kept), int(np.prod(np.maximum(color_size, depth_size or (0, 0)))), where)
    K = _common_intrinsics(layout, color_size, depth_size)

    def read(index: int) -> Frame:
        files, T_world_camera = chosen[index]
        return _read_frame(files, T_world_camera, layout.K_color, K, scale)

    frames = tuple(_collect(in_threads(_attempt(read), kept, MAX_READERS), skips).values())
    skips.refuse_none_left(len(frames), where)
    return frames, skips.warnings()


def _read_frame(
    files: FrameFiles,
    T_world_camera: Float[np.ndarray, "4 4"],
    K_color: Float[np.ndarray, "3 3"],
    K: Float[np.ndarray, "3 3"],
    depth_scale: float,
) -> Frame:
    color = read_color(files.color)
    depth = None if files.depth is None else read_depth(files.depth, depth_scale)
    if depth is not None and (color.shape[:2] != depth.shape or not np.allclose(K, K_color)):
        color = match_color(color, K_color, K, (depth.shape[1], depth.shape[0]))
    return Frame(files.name, color, depth, K, T_world_camera, files.index)


def _common_intrinsics(
    layout: Layout, color_size: Size, depth_size: Size | None
) -> Float[np.ndarray, "3 3"]:
    K, size = layout.K_color, color_size
    if depth_size is not None and layout.K_depth is not None:
        K, size = layout.K_depth, depth_size
    elif depth_size is not None and depth_size != color_size:
        ratios = np.array(depth_size) / np.array(color_size)
        if abs(ratios[0] / ratios[1] - 1) > 0.02:
            raise FileFormatError(
                f"{layout.folder}: color is {color_size} and depth {depth_size} pixels, which "
                "are different views; add intrinsic_color.txt and intrinsic_depth.txt"
            )
        K, size = scaled_intrinsics(K, color_size, depth_size), depth_size
    if not (0 < K[0, 2] < size[0] and 0 < K[1, 2] < size[1]):
        raise FileFormatError(
            f"{layout.folder}: the center of the intrinsics, ({K[0, 2]:.0f}, {K[1, 2]:.0f}), is "
            f"outside of the images of {size[0]} x {size[1]}; they belong to another image size"
        )
    if depth_size is not None and layout.K_depth is not None:
        try:
            match_color(np.zeros((*color_size[::-1], 3), np.uint8), layout.K_color, K, size)
        except ValueError as error:
            raise FileFormatError(f"{layout.folder}: {error}") from error
    return K


def _with_poses(
    frames: Sequence[FrameFiles], skips: Skips
) -> list[tuple[FrameFiles, Float[np.ndarray, "4 4"]]]:
    posed = []
    for files in frames:
        try:
            T = _numbers(files.pose) if isinstance(files.pose, Path) else files.pose
            posed.append((files, rigid_pose(T)))
        except FileFormatError as error:
            skips.add("pose", str(error))
        except ValueError as error:
            where = files.pose if isinstance(files.pose, Path) else files.name
            skips.add("pose", f"{where}: {error}")
    return posed


def _sizes(files: FrameFiles) -> tuple[Size, Size | None]:
    depth = None if files.depth is None else image_size(files.depth)
    return image_size(files.color), depth


def _attempt(read: Callable[[_In], _Out]) -> Callable[[_In], _Out | FileFormatError]:
    """Turn errors about one frame into values, so that the others are still read."""

    def attempt(item: _In) -> _Out | FileFormatError:
        try:
            return read(item)
        except FileFormatError as error:
            return error

    return attempt


def _collect(results: Iterable[_Out | FileFormatError], skips: Skips) -> dict[int, _Out]:
    good: dict[int, _Out] = {}
    for index, result in enumerate(results):
        if isinstance(result, FileFormatError):
            skips.add("images", str(result))
        else:
            good[index] = result
    return good


def _seven_scenes(folder: Path, names: set[str]) -> Layout:
    colors = {_stem(name): name for name in names if ".color." in name and _is_image(name)}
    stems = _in_order(stem for stem in colors if stem.startswith("frame-"))
    has_depth = any(name.endswith(".depth.png") for name in names)
    frames = tuple(
        FrameFiles(
            stem,
            folder / colors[stem],
            folder / f"{stem}.depth.png" if has_depth else None,
            folder / f"{stem}.pose.txt",
        )
        for stem in stems
    )
    # 3DMatch has the matrix next to its sequences.
    for file in (folder / "camera-intrinsics.txt", folder.parent / "camera-intrinsics.txt"):
        if file.is_file():
            K = read_intrinsics(file)
            return Layout(folder, frames, K, None)
    assumed = (
        f"{folder}: no camera-intrinsics.txt; assumed the Kinect of 7-Scenes, "
        "focal length 585, center (320, 240)"
    )
    return Layout(folder, frames, SEVEN_SCENES_INTRINSICS, None, (assumed,))


def read_intrinsics(file: Path) -> Float[np.ndarray, "3 3"]:
    """Read the 3 x 3 matrix of a pinhole camera.

    Raises:
        FileFormatError: The file is something else.
    """
    return check_intrinsics(_numbers(file), str(file))


def image_names(folder: Path) -> list[str]:
    """Return the names of the images in a folder, in order.

    Raises:
        FileFormatError: It has none, or too many, or is not readable.
    """
    found = {Path(name).stem: name for name in list_names(folder) if _is_image(name)}
    if not found:
        raise FileFormatError(f"{folder}: has no images such as 0.jpg")
    return [found[stem] for stem in _in_order(found)]


def _export(folder: Path) -> Layout:
    if not (folder / "pose").is_dir():
        raise FileFormatError(f"{folder}: has no poses; expected pose/0.txt, camera to world")
    colors = {_stem(name): name for name in list_names(folder / "color") if _is_image(name)}
    has_depth = (folder / "depth").is_dir()
    frames = tuple(
        FrameFiles(
            stem,
            folder / "color" / colors[stem],
            folder / "depth" / f"{stem}.png" if has_depth else None,
            folder / "pose" / f"{stem}.txt",
        )
        for stem in _in_order(colors)
    )
    if not frames:
        raise FileFormatError(f"{folder / 'color'}: has no images such as 0.jpg")
    K_color, K_depth = _export_intrinsics(folder)
    return Layout(folder, frames, K_color, K_depth)


def _export_intrinsics(
    folder: Path,
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"] | None]:
    inside = folder / "intrinsic"
    place = inside if inside.is_dir() else folder
    color, depth = place / "intrinsic_color.txt", place / "intrinsic_depth.txt"
    if color.is_file() and depth.is_file():
        return _matrix(color), _matrix(depth)
    only = [
        name
        for name in _in_order(list_names(place))
        if name.endswith(".txt") and name.startswith("intrinsic")
    ]
    if len(only) != 1:
        raise FileFormatError(
            f"{folder}: no intrinsics; expected intrinsic/intrinsic_color.txt, and "
            "intrinsic/intrinsic_depth.txt if depth has another size"
        )
    if only[0] == depth.name:
        # A single matrix applies to both, which is right if they are registered.
        return _matrix(depth), _matrix(depth)
    return _matrix(place / only[0]), None


def _matrix(file: Path) -> Float[np.ndarray, "3 3"]:
    return check_intrinsics(_numbers(file)[:3, :3], str(file))


def _numbers(file: Path) -> Float[np.ndarray, "n n"]:
    data = read_bytes_bounded(file, MAX_TEXT_BYTES)
    try:
        values = np.array(data.removeprefix(b"\xef\xbb\xbf").decode("ascii").split(), float)
    except ValueError as error:
        raise FileFormatError(f"{file}: must have only numbers") from error
    if len(values) not in (9, 16):
        raise FileFormatError(f"{file}: must be a 3 x 3 or 4 x 4 matrix, not {len(values)} numbers")
    side = 3 if len(values) == 9 else 4
    return values.reshape(side, side)


def refuse_links_out(root: Path) -> None:
    """Refuse a scan's folder with a symbolic link to a place outside of it.

    Raises:
        FileFormatError: There is one, or the folder has too many files.
    """
    inside, count = resolved(root), 0
    for folder, folders, files in os.walk(root):
        count += len(folders) + len(files)
        if count > MAX_FILES:
            raise FileFormatError(f"{root}: has more than {MAX_FILES} files; it is no single scan")
        for name in (*folders, *files):
            path = os.path.join(folder, name)
            if os.path.islink(path) and not resolved(Path(path)).is_relative_to(inside):
                raise FileFormatError(
                    f"{path}: is a symbolic link out of the scan's folder; copy what it names into "
                    f"{root}"
                )


def list_names(folder: Path) -> list[str]:
    """Return the names in a folder, with a limit on their number."""
    names = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                names.append(entry.name)
                if len(names) > 4 * MAX_FRAMES_LISTED:
                    raise FileFormatError(
                        f"{folder}: has more than {MAX_FRAMES_LISTED} frames; split it"
                    )
    except OSError as error:
        raise FileFormatError(f"{folder}: cannot be listed ({error.strerror})") from error
    return names


def _in_order(stems: Iterable[str]) -> list[str]:
    """Sort by number where names are numbers, as in 9.jpg before 10.jpg."""
    listed = sorted(stems, key=lambda stem: (len(stem), stem) if stem.isdigit() else (0, stem))
    if len(listed) > MAX_FRAMES_LISTED:
        raise FileFormatError(f"{listed[0]}: one of more than {MAX_FRAMES_LISTED} frames")
    return listed


def _stem(name: str) -> str:
    return name.partition(".")[0]


def _is_image(name: str) -> bool:
    return name.lower().endswith(_IMAGES)
