"""Read posed images from ROS 1 bags, ROS 2 bags (SQLite, MCAP), and MCAP files.

Depth and color must be registered, like `aligned_depth_to_color` or `depth_registered`; this module
does not register them. Poses come from `/tf` and `/tf_static`, interpolated at the depth's time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from momapos.core import FileFormatError, MomaposError, open_regular, require
from momapos.model.records import Frame

from .images import MAX_PIXELS, choose, read_color, read_depth, to_meters
from .layouts import list_names
from .validation import Skips, check_intrinsics, check_memory, keep_common_size, rigid_pose

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, Int, UInt8


_CHANNELS = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1}
_DEPTHS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
_DEPTH_HEADER_BYTES = 12  # of image_transport's compressedDepth, before its PNG


def depth_of(message: Any, scale: float, where: str) -> Float32[np.ndarray, "h w"]:
    """Decode a depth message, raw or compressed.

    Args:
        message: A sensor_msgs Image or CompressedImage from rosbags.
        scale: Units of 16-bit depth per meter; 32-bit depth is in meters.
        where: Name in errors.

    Returns:
        Depth [m], 0 where unmeasured.

    Raises:
        FileFormatError: It is damaged or has another encoding.
    """
    if not hasattr(message, "encoding"):
        data = message.data.tobytes()
        if "compressedDepth" in message.format:
            if "32FC1" in message.format:
                raise FileFormatError(f"{where}: compressed depth must be 16UC1, not 32FC1")
            data = data[_DEPTH_HEADER_BYTES:]
        return read_depth(data, scale, where)
    if message.encoding not in _DEPTHS:
        raise FileFormatError(
            f"{where}: depth has encoding {message.encoding!r:.40}; expected {', '.join(_DEPTHS)}"
        )
    raw = _pixels(message, _DEPTHS[message.encoding], 1, where)[..., 0]
    return to_meters(raw, 1.0 if raw.dtype.kind == "f" else scale)


def color_of(message: Any, where: str) -> UInt8[np.ndarray, "h w 3"]:
    """Decode a color message, raw or compressed.

    Raises:
        FileFormatError: It is damaged or has another encoding.
    """
    if not hasattr(message, "encoding"):
        return read_color(message.data.tobytes(), where)
    if message.encoding not in _CHANNELS:
        raise FileFormatError(
            f"{where}: color has encoding {message.encoding!r:.40}; expected {', '.join(_CHANNELS)}"
        )
    raw = _pixels(message, "u1", _CHANNELS[message.encoding], where)
    if raw.shape[2] == 1:
        return np.repeat(raw, 3, axis=2)
    rgb = raw[..., 2::-1] if message.encoding.startswith("bgr") else raw[..., :3]
    return np.ascontiguousarray(rgb)


def _pixels(message: Any, kind: str, channels: int, where: str) -> np.ndarray:
    """Return the pixels (h, w, channels) of a raw image, without row padding."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    row = width * channels * dtype.itemsize
    data = np.asarray(message.data, np.uint8)
    if not 0 < height * width <= MAX_PIXELS or step < row or len(data) < height * step:
        raise FileFormatError(
            f"{where}: {width} x {height} pixels do not fit its {len(data)} bytes"
        )
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    return rows.view(dtype).reshape(height, width, channels)


TOLERANCE = 0.1
"""A transform is extrapolated by this much before its first and after its last sample [s]."""
MAX_DEPTH = 100


@dataclass
class TransformTree:
    """Transforms by child frame."""

    parents: dict[str, Counter[str]] = field(default_factory=dict)
    samples: dict[tuple[str, str], list[tuple[int, tuple[float, ...]]]] = field(
        default_factory=dict
    )
    """Of each (parent, child): time [ns], and x, y, z [m], qx, qy, qz, qw."""
    static: set[tuple[str, str]] = field(default_factory=set)

    def add(
        self, stamp: int, parent: str, child: str, values: tuple[float, ...], fixed: bool
    ) -> None:
        """Add one transform, unless it is not finite or has no rotation."""
        if not np.isfinite(values).all() or not 0.5 < np.linalg.norm(values[3:]) < 2:
            return
        edge = (parent.lstrip("/"), child.lstrip("/"))
        self.parents.setdefault(edge[1], Counter())[edge[0]] += 1
        self.samples.setdefault(edge, []).append((stamp, values))
        if fixed:
            self.static.add(edge)

    def frames(self) -> list[str]:
        """Return the names of all frames."""
        return sorted({name for edge in self.samples for name in edge})

    def chain(self, frame: str, fixed_frame: str | None) -> list[tuple[str, str]]:
        """Return the transforms from a frame upward.

        Args:
            frame: Start.
            fixed_frame: End; the root if None.

        Returns:
            Pairs of (parent, child), the frame's own first; empty without a parent.

        Raises:
            ValueError: There is no path, or the frames form a cycle.
        """
        edges: list[tuple[str, str]] = []
        here = frame.lstrip("/")
        end = None if fixed_frame is None else fixed_frame.lstrip("/")
        while here != end and here in self.parents:
            # Two sources may give a frame different parents; the more frequent one is the odometry.
            parent = self.parents[here].most_common(1)[0][0]
            edges.append((parent, here))
            here = parent
            if len(edges) > MAX_DEPTH:
                raise ValueError(f"the frames above {frame!r} form a cycle")
        if end is not None and here != end:
            raise ValueError(f"no path from {end!r} to {frame!r}; {here!r} has no parent")
        return edges

    def poses(
        self, edges: Iterable[tuple[str, str]], stamps: Int[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 4 4"], Bool[np.ndarray, " n"]]:
        """Compose a chain at given times.

        Args:
            edges: From `chain`.
            stamps: Times [ns].

        Returns:
            Transforms from the frame to the end of the chain, and at which times all of them are
            known.
        """
        Ts = np.tile(np.eye(4), (len(stamps), 1, 1))
        known = np.ones(len(stamps), bool)
        for edge in edges:
            Ts_parent_child, there = self._at(edge, stamps)
            Ts = Ts_parent_child @ Ts
            known &= there
        return Ts, known

    def _at(
        self, edge: tuple[str, str], stamps: Int[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 4 4"], Bool[np.ndarray, " n"]]:
        samples = self.samples[edge]
        times, first = np.unique([stamp for stamp, _ in samples], return_index=True)
        values = np.array([samples[i][1] for i in first])
        Ts = np.tile(np.eye(4), (len(stamps), 1, 1))
        if edge in self.static or len(times) == 1:
            Ts[:, :3, 3] = values[-1, :3]
            Ts[:, :3, :3] = Rotation.from_quat(values[-1, 3:]).as_matrix()
            near = np.abs(stamps - times[-1]) <= TOLERANCE * 1e9
            return Ts, near | (edge in self.static)
        # Nanoseconds since 1970 do not fit into a float; those since the first sample do.
        seconds, wanted = (times - times[0]) * 1e-9, (stamps - times[0]) * 1e-9
        known = (wanted >= -TOLERANCE) & (wanted <= seconds[-1] + TOLERANCE)
        wanted = np.clip(wanted, 0.0, seconds[-1])
        Ts[:, :3, 3] = np.stack([np.interp(wanted, seconds, axis) for axis in values[:, :3].T], 1)
        Ts[:, :3, :3] = Slerp(seconds, Rotation.from_quat(values[:, 3:]))(wanted).as_matrix()
        return Ts, known


MAX_IMAGES = 100_000
MAX_TRANSFORMS = 2_000_000
MAX_TIME_DIFFERENCE = 0.05
"""Between depth and color [s]."""
_UNREGISTERED = "so they are not registered; record aligned_depth_to_color or depth_registered"
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


@dataclass(frozen=True)
class BagTopics:
    """Topics and frames of a recording; None: found by type and name."""

    depth: str | None = None
    """Depth images, registered to color."""
    color: str | None = None
    """Color images."""
    info: str | None = None
    """Camera info of both."""
    fixed_frame: str | None = None
    """A frame that does not move; the root of tf if None."""


@dataclass(frozen=True, eq=False)
class _Shot:
    """Indices of a depth and a color image that belong together, in their topics."""

    name: str
    depth: int
    color: int
    T_world_camera: Float[np.ndarray, "4 4"]


@dataclass
class _Index:
    """Result of the first pass over the recording; images by index in their topic."""

    depth: list[tuple[int, str]] = field(default_factory=list)
    """Time [ns] and frame."""
    color: list[tuple[int, str]] = field(default_factory=list)
    info: Any = None
    tree: TransformTree = field(default_factory=TransformTree)
    transforms: int = 0


def read_bag(
    path: Path, *, max_frames: int, depth_scale: float, topics: BagTopics | None = None
) -> tuple[tuple[Frame, ...], tuple[str, ...]]:
    """Read the posed images of a recording.

    Args:
        path: A `.bag` or `.mcap` file, or the folder of a ROS 2 bag.
        max_frames: Maximum number of frames, spread over the motion of those with a pose.
        depth_scale: Units of 16-bit depth per meter; 32-bit depth is in meters.
        topics: Topics to use, where names are ambiguous.

    Returns:
        The frames, and one line per skipped kind of frame or assumption.

    Raises:
        FileFormatError: It is damaged, or lacks a topic, poses, or registered depth.
        InputError: The frames do not fit into memory.
        MissingExtraError: rosbags is not installed.
    """
    with _opened(path) as reader:
        chosen = _find_topics(reader, topics or BagTopics(), path)
        index = _first_pass(reader, chosen, path)
        K, warnings = _intrinsics(index, chosen, path)
        skips = Skips(len(index.depth))
        shots, notes = _shots(index, chosen.fixed_frame, skips, path)
        poses = np.array([shot.T_world_camera for shot in shots]).reshape(-1, 4, 4)
        shots = [shots[i] for i in choose(poses, max_frames)]
        size = (int(index.info.width), int(index.info.height))
        check_memory(len(shots), size[0] * size[1], str(path))
        images = _second_pass(reader, chosen, shots)
        frames = _frames(images, shots, K, depth_scale, skips, path)
    _check_size(frames, size, path)
    return frames, (*warnings, *notes, *skips.warnings())


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    with require("scan"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    _check_regular(path)
    try:
        # Older SQLite bags have no message definitions.
        store = get_typestore(Stores.ROS2_HUMBLE)
        with AnyReader([path], default_typestore=store) as reader:
            yield reader
    except MomaposError:
        raise
    except Exception as error:  # parsers raise anything on damaged recordings
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise FileFormatError(f"{path}: damaged recording ({reason})") from error


def _check_regular(path: Path) -> None:
    """Refuse FIFOs and devices, also in the folder of a recording: rosbags would block on them."""
    files = [path / name for name in list_names(path)] if path.is_dir() else [path]
    for file in files:
        if not file.is_dir():
            open_regular(file).close()


def _find_topics(reader: Any, given: BagTopics, path: Path) -> BagTopics:
    types = {c.topic: c.msgtype for c in reader.connections}
    images = [name for name, kind in types.items() if kind in (IMAGE, COMPRESSED)]
    depth = given.depth or _best(
        [name for name in images if "depth" in name],
        ("aligned", "registered", "/image_raw", "/image_rect_raw"),
    )
    others = [n for n in images if not any(word in n for word in ("depth", "infra", "/ir/"))]
    named = [name for name in others if any(word in name for word in ("color", "colour", "rgb"))]
    color = given.color or _best(named or others, ("image_rect", "/image_raw"))
    infos = [name for name, kind in types.items() if kind == INFO]
    info = given.info or _nearest_name(infos, depth, color)
    wanted = {"depth": depth, "color": color, "camera info": info}
    lacks = [kind for kind, name in wanted.items() if name is None or name not in types]
    if not any(kind in TRANSFORMS for kind in types.values()):
        lacks.append("/tf")
    if lacks:
        listed = ", ".join(f"{name} ({kind})" for name, kind in sorted(types.items())[:40])
        raise FileFormatError(
            f"{path}: has no topic for {', '.join(lacks)}; it has {listed or 'none'}"
        )
    return BagTopics(depth, color, info, given.fixed_frame)


def _best(names: Sequence[str], signs: Sequence[str]) -> str | None:
    """Return the name with the most important signs (earlier is more); ties: the shorter one."""

    def rank(name: str) -> tuple[list[bool], int, str]:
        return [sign not in name for sign in signs], len(name), name

    return min(names, key=rank, default=None)


def _nearest_name(infos: Sequence[str], *topics: str | None) -> str | None:
    for topic in topics:
        # Works for /camera/color/image_raw and /camera/color/image_raw/compressed.
        folders = [] if topic is None else [topic.rsplit("/", k)[0] for k in (1, 2)]
        for folder in folders:
            if f"{folder}/camera_info" in infos:
                return f"{folder}/camera_info"
    return infos[0] if len(infos) == 1 else None


def _messages(reader: Any, topics: set[str | None]) -> Iterator[tuple[Any, int, bytes]]:
    chosen = [c for c in reader.connections if c.topic in topics]
    yield from reader.messages(connections=chosen)


def _first_pass(reader: Any, topics: BagTopics, path: Path) -> _Index:
    index = _Index()
    moving = {c.topic for c in reader.connections if c.msgtype in TRANSFORMS}
    for connection, _, raw in _messages(reader, {topics.depth, topics.color, topics.info, *moving}):
        topic = connection.topic
        if topic == topics.info and index.info is not None:
            continue
        message = reader.deserialize(raw, connection.msgtype)
        if topic in (topics.depth, topics.color):
            listed = index.depth if topic == topics.depth else index.color
            listed.append((_nanoseconds(message.header.stamp), message.header.frame_id))
        elif topic == topics.info:
            index.info = message
        else:
            index.transforms += len(message.transforms)
            _add_transforms(index.tree, message, topic.endswith("static"))
        if max(len(index.depth), len(index.color)) > MAX_IMAGES:
            raise FileFormatError(f"{path}: has more than {MAX_IMAGES} images; split it")
        if index.transforms > MAX_TRANSFORMS:
            raise FileFormatError(f"{path}: has more than {MAX_TRANSFORMS} transforms; split it")
    for kind, found in (("depth", index.depth), ("color", index.color), ("info", index.info)):
        if not found:
            raise FileFormatError(f"{path}: its topic {getattr(topics, kind)} has no messages")
    return index


def _add_transforms(tree: TransformTree, message: Any, fixed: bool) -> None:
    for item in message.transforms:
        t, q = item.transform.translation, item.transform.rotation
        values = (t.x, t.y, t.z, q.x, q.y, q.z, q.w)
        stamp = _nanoseconds(item.header.stamp)
        tree.add(stamp, item.header.frame_id, item.child_frame_id, values, fixed)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _intrinsics(
    index: _Index, topics: BagTopics, path: Path
) -> tuple[Float[np.ndarray, "3 3"], list[str]]:
    message = index.info
    # ROS 1 spells these two in capitals.
    raw = message.k if hasattr(message, "k") else message.K
    distortion = np.asarray(message.d if hasattr(message, "d") else message.D, float)
    K = check_intrinsics(np.asarray(raw, float).reshape(3, 3), f"{path}: {topics.info}")
    warnings = []
    if np.any(np.abs(distortion) > 1e-2) and "rect" not in str(topics.color):
        warnings.append(f"{path}: {topics.info} has lens distortion, which is ignored")
    return K, warnings


def _shots(
    index: _Index, fixed_frame: str | None, skips: Skips, path: Path
) -> tuple[list[_Shot], list[str]]:
    """Pair depth with the color nearest in time, and look up the camera's pose."""
    stamps, color_stamps = (
        np.array([stamp for stamp, _ in listed], np.int64) for listed in (index.depth, index.color)
    )
    frame = _common_frame(index, path)
    try:
        edges = index.tree.chain(frame, fixed_frame)
    except ValueError as error:
        raise FileFormatError(f"{path}: {error}") from error
    Ts, known = index.tree.poses(edges, stamps)
    partner = _nearest(color_stamps, stamps)
    apart = np.abs(color_stamps[partner] - stamps) * 1e-9
    shots = []
    for i, stamp in enumerate(stamps):
        name = _seconds(int(stamp))
        if not known[i]:
            skips.add("pose", f"tf has no pose of {frame!r} at {name}")
        elif apart[i] > MAX_TIME_DIFFERENCE:
            skips.add("color", f"the nearest image to depth at {name} is {apart[i]:.2f} s away")
        else:
            shots.append(_Shot(name, i, int(partner[i]), rigid_pose(Ts[i])))
    skips.refuse_none_left(len(shots), str(path))
    return shots, _notes(index.tree, edges, frame, path)


def _common_frame(index: _Index, path: Path) -> str:
    """Return the frame of depth and color, which must be the same and be in tf."""
    frame, color_frame = (listed[0][1].lstrip("/") for listed in (index.depth, index.color))
    if frame != color_frame:
        raise FileFormatError(
            f"{path}: depth is in frame {frame!r} and color in {color_frame!r}, {_UNREGISTERED}"
        )
    if frame not in index.tree.parents:
        raise FileFormatError(
            f"{path}: tf has no frame {frame!r}; it has "
            f"{', '.join(index.tree.frames()[:20]) or 'no frames'}"
        )
    return frame


def _notes(tree: TransformTree, edges: list[tuple[str, str]], frame: str, path: Path) -> list[str]:
    notes = []
    if "optical" not in frame:
        notes.append(f"{path}: assumed that {frame!r} is optical: x right, y down, z forward")
    if all(edge in tree.static for edge in edges):
        notes.append(f"{path}: no transform in tf moves {frame!r}; its root is {edges[-1][0]!r}")
    return notes


def _nearest(times: Int[np.ndarray, " n"], wanted: Int[np.ndarray, " m"]) -> np.ndarray:
    """Return the index of the time nearest to each wanted one; times in any order."""
    order = np.argsort(times, kind="stable")
    ordered = times[order]
    after = np.clip(np.searchsorted(ordered, wanted), 1, max(1, len(times) - 1))
    after = np.minimum(after, len(times) - 1)
    before = np.maximum(after - 1, 0)
    closer = wanted - ordered[before] <= ordered[after] - wanted
    return order[np.where(closer, before, after)]


def _second_pass(
    reader: Any, topics: BagTopics, shots: Sequence[_Shot]
) -> dict[tuple[str, int], Any]:
    wanted = {(topics.depth, shot.depth) for shot in shots}
    wanted |= {(topics.color, shot.color) for shot in shots}
    seen = {topics.depth: -1, topics.color: -1}
    found = {}
    for connection, _, raw in _messages(reader, {topics.depth, topics.color}):
        seen[connection.topic] += 1
        key = (connection.topic, seen[connection.topic])
        if key in wanted:
            kind = "depth" if connection.topic == topics.depth else "color"
            found[kind, key[1]] = reader.deserialize(raw, connection.msgtype)
    return found


def _frames(
    images: dict[tuple[str, int], Any],
    shots: Sequence[_Shot],
    K: Float[np.ndarray, "3 3"],
    depth_scale: float,
    skips: Skips,
    path: Path,
) -> tuple[Frame, ...]:
    frames: dict[int, Frame] = {}
    for number, shot in enumerate(shots):
        where = f"{path}: image at {shot.name}"
        try:
            depth = depth_of(images["depth", shot.depth], depth_scale, where)
            color = color_of(images["color", shot.color], where)
        except FileFormatError as error:
            skips.add("images", str(error))
            continue
        if color.shape[:2] != depth.shape:
            raise FileFormatError(
                f"{where}: color is {color.shape[1::-1]} and depth {depth.shape[::-1]} pixels, "
                f"{_UNREGISTERED}"
            )
        frames[number] = Frame(
            shot.name, color, depth, K, shot.T_world_camera, shot.color
        )  # fmt: skip
    sizes = {number: frame.color.shape[1::-1] for number, frame in frames.items()}
    kept = keep_common_size(sizes, skips, str(path))
    skips.refuse_none_left(len(kept), str(path))
    return tuple(frames[number] for number in kept)


def _check_size(frames: Sequence[Frame], size: tuple[int, int], path: Path) -> None:
    found = frames[0].color.shape[1::-1]
    if found != size:
        raise FileFormatError(f"{path}: camera info is for images of {size}, but they have {found}")


def _seconds(stamp: int) -> str:
    return f"{stamp // 10**9}.{stamp % 10**9:09d}"
