"""Recordings written by rosbags are read in every container."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation
from tests.perception.recordings.recorded import HEIGHT, WIDTH, K, Shot, shots

from momapos.core.errors import FileFormatError, MissingExtraError
from momapos.perception.recordings.bags import BagTopics, TransformTree
from momapos.perception.recordings.scan_reader import read_scan

START = 1_700_000_000_000_000_000
STEP = 100_000_000
OPTICAL = "camera_color_optical_frame"
DEPTH = "/camera/aligned_depth_to_color/image_raw"
COLOR = "/camera/color/image_raw"
INFO = "/camera/color/camera_info"
CONTAINERS = ("ros1", "sqlite", "mcap", "mcap file")


@dataclass(frozen=True)
class Setting:
    """Contents and encoding of a recording."""

    depth_topic: str = DEPTH
    color_topic: str = COLOR
    depth_frame: str = OPTICAL
    depth_encoding: str = "16UC1"
    color_encoding: str = "rgb8"
    omit: frozenset[str] = frozenset()
    lag: int = 0
    """Delay of color after depth [ns]."""
    moving: tuple[int, int] = (-1, 2)
    """Steps before the first and after the last frame for which odometry is known."""


class Recorder:
    """Creates messages of a ROS version and writes them to a container."""

    def __init__(self, path: Path, container: str) -> None:
        self.ros1 = container == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:  # where tf2 is not among the common types
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        self.messages: list[tuple[int, str, str, Any]] = []
        self.path, self.container = path, container

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, stamp: int, frame: str) -> Any:
        time = self.make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        extra = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **extra)

    def add(self, topic: str, kind: str, stamp: int, **fields: Any) -> None:
        self.messages.append((stamp, topic, kind, self.make(kind, **fields)))

    def write(self) -> Path:
        name = f"{self.path}.bag" if self.ros1 else str(self.path)
        plugin = StoragePlugin.MCAP if "mcap" in self.container else StoragePlugin.SQLITE3
        opened = Writer1(name) if self.ros1 else Writer2(name, version=9, storage_plugin=plugin)
        with opened as writer:
            kinds = {topic: kind for _, topic, kind, _ in self.messages}
            connections = {
                topic: writer.add_connection(topic, kind, typestore=self.store)
                for topic, kind in kinds.items()
            }
            for stamp, topic, kind, message in sorted(self.messages, key=lambda item: item[0]):
                encode = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
                writer.write(connections[topic], stamp, encode(message, kind))
        if self.container == "mcap file":
            return next(Path(name).glob("*.mcap"))
        return Path(name)


def png(pixels: np.ndarray) -> np.ndarray:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return np.frombuffer(stream.getvalue(), np.uint8)


def add_image(
    recorder: Recorder, topic: str, stamp: int, frame: str, encoding: str, pixels: np.ndarray
) -> None:
    """Add a raw image with padded rows, or a compressed one, depending on the encoding."""
    header = recorder.header(stamp, frame)
    if " " in encoding:
        data = png(pixels)
        if "compressedDepth" in encoding:
            data = np.concatenate([np.zeros(12, np.uint8), data])
        kind = "sensor_msgs/msg/CompressedImage"
        recorder.add(topic, kind, stamp, header=header, format=encoding, data=data)
        return
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    padded = np.pad(rows, ((0, 0), (0, 4)), constant_values=9)
    recorder.add(
        topic,
        "sensor_msgs/msg/Image",
        stamp,
        header=header,
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=padded.shape[1],
        data=padded.ravel(),
    )


def add_transform(
    recorder: Recorder, topic: str, stamp: int, parent: str, child: str, T: np.ndarray
) -> None:
    xyz, quat = T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat()
    make = recorder.make
    transform = make(
        "geometry_msgs/msg/Transform",
        translation=make("geometry_msgs/msg/Vector3", **dict(zip("xyz", xyz, strict=True))),
        rotation=make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", quat, strict=True))),
    )
    stamped = make(
        "geometry_msgs/msg/TransformStamped",
        header=recorder.header(stamp, parent),
        child_frame_id=child,
        transform=transform,
    )
    recorder.add(topic, "tf2_msgs/msg/TFMessage", stamp, transforms=[stamped])


T_BASE_CAMERA = np.eye(4)
T_BASE_CAMERA[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
T_BASE_CAMERA[:3, 3] = [0.1, 0.0, 1.2]


def base_at(steps: float) -> np.ndarray:
    """Return the pose of a robot that drives 1 m along x and turns by 0.2 rad per step."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", 0.2 * steps).as_matrix()
    T[0, 3] = steps
    return T


def record(path: Path, container: str, taken: list[Shot], setting: Setting) -> Path:
    recorder = Recorder(path, container)
    encodings = {"bgr8": lambda c: c[..., ::-1], "mono8": lambda c: c[..., :1]}
    as_color = encodings.get(setting.color_encoding, lambda c: c)
    meters = setting.depth_encoding == "32FC1"
    for i, shot in enumerate(taken):
        stamp = START + i * STEP
        depth = (shot.depth / 1000).astype(np.float32) if meters else shot.depth
        if "depth" not in setting.omit:
            add_image(
                recorder,
                setting.depth_topic,
                stamp,
                setting.depth_frame,
                setting.depth_encoding,
                depth,
            )
        if "color" not in setting.omit:
            add_image(
                recorder, setting.color_topic, stamp + setting.lag, OPTICAL,
                setting.color_encoding, as_color(shot.color),
            )  # fmt: skip
        if "info" not in setting.omit:
            add_info(recorder, stamp)
    if "tf" not in setting.omit:
        add_transform(recorder, "/tf_static", START, "base_link", OPTICAL, T_BASE_CAMERA)
        first, after = setting.moving
        # Halfway between the images, so that every pose is interpolated.
        for step in np.arange(first, len(taken) - 1 + after) + 0.5:
            add_transform(
                recorder, "/tf", START + int(step * STEP), "odom", "base_link", base_at(step)
            )
    return recorder.write()


def add_info(recorder: Recorder, stamp: int) -> None:
    def named(**fields: Any) -> dict[str, Any]:
        return {k.upper() if recorder.ros1 else k: v for k, v in fields.items()}

    P = np.zeros((3, 4))
    P[:, :3] = K
    matrices = named(d=np.zeros(5), k=K.ravel(), r=np.eye(3).ravel(), p=P.ravel())
    roi = recorder.make(
        "sensor_msgs/msg/RegionOfInterest",
        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False,
    )  # fmt: skip
    recorder.add(
        INFO, "sensor_msgs/msg/CameraInfo", stamp, header=recorder.header(stamp, OPTICAL),
        height=HEIGHT, width=WIDTH, distortion_model="plumb_bob", binning_x=0, binning_y=0,
        roi=roi, **matrices,
    )  # fmt: skip


@pytest.mark.parametrize("container", CONTAINERS)
def test_every_container_gives_images_and_interpolated_poses(
    tmp_path: Path, container: str
) -> None:
    taken = shots(5)
    scan = read_scan(record(tmp_path / "drive", container, taken, Setting()))
    assert scan.warnings == ()
    assert len(scan.frames) == 5
    for i, (frame, shot) in enumerate(zip(scan.frames, taken, strict=True)):
        np.testing.assert_array_equal(frame.color, shot.color)
        np.testing.assert_allclose(frame.depth, shot.depth / 1000, atol=1e-6)
        np.testing.assert_allclose(frame.intrinsics, K)
        np.testing.assert_allclose(frame.T_world_camera, base_at(i) @ T_BASE_CAMERA, atol=1e-6)


ENCODINGS = [
    ("32FC1", "bgr8"),
    ("mono16", "rgb8; png compressed"),
    ("16UC1; compressedDepth png", "rgb8"),
    ("16UC1; png compressed", "rgb8"),
]


@pytest.mark.parametrize(("depth", "color"), ENCODINGS)
def test_every_encoding_gives_the_same_images(tmp_path: Path, depth: str, color: str) -> None:
    taken = shots(2)
    setting = Setting(depth_encoding=depth, color_encoding=color)
    scan = read_scan(record(tmp_path / "drive", "mcap", taken, setting))
    for frame, shot in zip(scan.frames, taken, strict=True):
        np.testing.assert_array_equal(frame.color, shot.color)
        np.testing.assert_allclose(frame.depth, shot.depth / 1000, atol=1e-6)


def test_chosen_frames_are_evenly_spaced_and_keep_their_color_images(tmp_path: Path) -> None:
    taken = shots(9)
    path = record(tmp_path / "drive", "sqlite", taken, Setting(lag=STEP // 4))
    scan = read_scan(path, max_frames=3)
    for frame, i in zip(scan.frames, (0, 4, 8), strict=True):
        np.testing.assert_array_equal(frame.color, taken[i].color)
        assert frame.name == f"1700000000.{i}00000000"


@pytest.mark.parametrize("missing", ["depth", "color", "info", "tf"])
@pytest.mark.parametrize("container", ["ros1", "mcap"])
def test_an_error_about_a_missing_topic_lists_the_topics(
    tmp_path: Path, container: str, missing: str
) -> None:
    path = record(tmp_path / "drive", container, shots(1), Setting(omit=frozenset({missing})))
    with pytest.raises(FileFormatError, match=missing) as caught:
        read_scan(path)
    others = {"depth": DEPTH, "color": COLOR, "info": INFO, "tf": "/tf_static"}
    for name, topic in others.items():
        assert (topic in str(caught.value)) == (name != missing)


def test_topics_with_ambiguous_names_can_be_given(tmp_path: Path) -> None:
    taken = shots(2)
    setting = Setting(depth_topic="/sensor/range", color_topic="/sensor/image")
    path = record(tmp_path / "drive", "mcap", taken, setting)
    with pytest.raises(FileFormatError, match="no topic for depth"):
        read_scan(path)
    scan = read_scan(path, topics=BagTopics(depth="/sensor/range", color="/sensor/image"))
    np.testing.assert_array_equal(scan.frames[1].color, taken[1].color)


def test_the_fixed_frame_can_be_given_and_must_exist(tmp_path: Path) -> None:
    path = record(tmp_path / "drive", "mcap", shots(2), Setting())
    scan = read_scan(path, topics=BagTopics(fixed_frame="base_link"))
    np.testing.assert_allclose(scan.frames[1].T_world_camera, T_BASE_CAMERA, atol=1e-6)
    assert "no transform in tf moves" in scan.warnings[0]
    with pytest.raises(FileFormatError, match="'map'"):
        read_scan(path, topics=BagTopics(fixed_frame="map"))


def test_depth_of_another_frame_or_size_is_not_registered(tmp_path: Path) -> None:
    setting = Setting(depth_frame="camera_depth_optical_frame")
    with pytest.raises(FileFormatError, match="not registered"):
        read_scan(record(tmp_path / "frame", "mcap", shots(1), setting))
    halved = [replace(shot, depth=shot.depth[::2, ::2].copy()) for shot in shots(1)]
    with pytest.raises(FileFormatError, match="not registered"):
        read_scan(record(tmp_path / "size", "mcap", halved, Setting()))


def test_images_outside_the_time_of_tf_are_skipped_and_counted(tmp_path: Path) -> None:
    path = record(tmp_path / "drive", "mcap", shots(6), Setting(moving=(2, 2)))
    scan = read_scan(path)
    assert [frame.name[11] for frame in scan.frames] == ["2", "3", "4", "5"]
    assert "skipped 2 of 6 frames because of their pose" in scan.warnings[0]
    np.testing.assert_allclose(scan.frames[1].T_world_camera, base_at(3) @ T_BASE_CAMERA, atol=1e-6)


def test_a_broken_image_of_many_is_skipped_and_all_of_another_encoding_is_an_error(
    tmp_path: Path,
) -> None:
    def spoil(recorder: Recorder) -> None:
        images = [m for _, topic, _, m in recorder.messages if topic == COLOR]
        images[1].height = 1000

    path = spoilt(tmp_path / "drive", spoil)
    scan = read_scan(path)
    assert len(scan.frames) == 3
    assert "skipped 1 of 4 frames because of their images" in scan.warnings[0]
    yuv = record(tmp_path / "yuv", "mcap", shots(2), Setting(color_encoding="yuv422"))
    with pytest.raises(FileFormatError, match="encoding 'yuv422'; expected rgb8"):
        read_scan(yuv)


def spoilt(path: Path, spoil: Callable[[Recorder], None]) -> Path:
    """Record four shots, with modified messages."""
    plain = Recorder.write

    def write(recorder: Recorder) -> Path:
        spoil(recorder)
        return plain(recorder)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Recorder, "write", write)
        return record(path, "mcap", shots(4), Setting())


@pytest.mark.parametrize("container", CONTAINERS)
def test_a_truncated_recording_is_refused_by_name(tmp_path: Path, container: str) -> None:
    path = record(tmp_path / "drive", container, shots(3), Setting())
    file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")
    data = file.read_bytes()
    for end in (len(data) // 2, 20):
        file.write_bytes(data[:end])
        with pytest.raises(FileFormatError, match="drive"):
            read_scan(path)


@pytest.mark.parametrize("container", ["sqlite", "mcap"])
def test_a_fifo_in_the_folder_of_a_recording_is_refused_without_blocking(
    tmp_path: Path, container: str
) -> None:
    path = record(tmp_path / "drive", container, shots(1), Setting())
    file = next(f for f in path.iterdir() if f.suffix != ".yaml")
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(FileFormatError, match="fifo"):
        read_scan(path)


def test_an_error_about_missing_rosbags_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = record(tmp_path / "drive", "mcap", shots(1), Setting())
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MissingExtraError, match="rosbags is not installed; pip install"):
        read_scan(path)


def test_frames_in_a_cycle_or_without_a_root_are_refused() -> None:
    tree = TransformTree()
    still = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    tree.add(0, "a", "b", still, True)
    tree.add(0, "b", "a", still, True)
    with pytest.raises(ValueError, match="cycle"):
        tree.chain("b", None)
    tree.add(0, "a", "c", (float("nan"), *still[1:]), True)
    tree.add(0, "a", "c", (*still[:6], 0.0), True)
    assert "c" not in tree.parents, "what is no transform is left out"
