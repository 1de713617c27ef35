"""Write a timeline as a ROS 2 bag in MCAP, for Foxglove, RViz and `ros2 bag play`.

Topics: /tf (frames of the robot and of the moved object), /joint_states, /robot_description,
/base_pose, /base_path, /trajectory (moveit_msgs/RobotTrajectory), /scene (markers of the shapes).
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import InputError, require
from momapos.core.geometry import invert, pose_planar
from momapos.model.robots import Robot
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Hull

from .phases import Samples
from .ros2 import stamp
from .timeline import Timeline

if TYPE_CHECKING:
    from jaxtyping import Float

RATE = 20.0
"""State messages per second [1/s]."""
ROBOT_TRAJECTORY = """trajectory_msgs/JointTrajectory joint_trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_joint_trajectory
"""
"""Definition of moveit_msgs/msg/RobotTrajectory, which is not in the type store."""
_TRIANGLES, _ADD = 11, 0


@dataclass(frozen=True)
class _Messages:
    """Constructors of ROS messages."""

    store: Any

    def make(self, kind: str, **members: Any) -> Any:
        """Make a message of a type, such as `geometry_msgs/msg/Pose`."""
        return self.store.types[kind](**members)

    def duration(self, seconds: float) -> Any:
        return self.make("builtin_interfaces/msg/Duration", **stamp(seconds))

    def header(self, seconds: float, frame: str) -> Any:
        time = self.make("builtin_interfaces/msg/Time", **stamp(seconds))
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame)

    def vector(self, values: Float[np.ndarray, "3"], kind: str = "Vector3") -> Any:
        """Make a `geometry_msgs` Vector3 or Point."""
        x, y, z = map(float, values)
        return self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def quaternion(self, R: Float[np.ndarray, "3 3"]) -> Any:
        x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, T: Float[np.ndarray, "4 4"]) -> Any:
        position, orientation = self.vector(T[:3, 3], "Point"), self.quaternion(T[:3, :3])
        return self.make("geometry_msgs/msg/Pose", position=position, orientation=orientation)

    def frames(self, seconds: float, parent: str, poses: dict[str, Any]) -> Any:
        """Make a TFMessage of frames with one parent."""
        transforms = [
            self.make(
                "geometry_msgs/msg/TransformStamped",
                header=self.header(seconds, parent), child_frame_id=name,
                transform=self.make(
                    "geometry_msgs/msg/Transform",
                    translation=self.vector(T[:3, 3]), rotation=self.quaternion(T[:3, :3]),
                ),
            )
            for name, T in poses.items()
        ]  # fmt: skip
        return self.make("tf2_msgs/msg/TFMessage", transforms=transforms)


def write_recording(
    timeline: Timeline, scene: Scene, robot: Robot, frame: str, folder: Path
) -> None:
    """Write a ROS 2 bag with MCAP storage: a folder with one `.mcap` file.

    Args:
        timeline: The motion.
        scene: The scene.
        robot: The robot.
        frame: Name of the world frame, such as "map".
        folder: The bag; it must not exist.

    Raises:
        MissingExtraError: rosbags is not installed.
        InputError: The folder exists, or can't be written.
    """
    with require("scan"):
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    if folder.exists():
        raise InputError(f"{folder}: already exists; remove it or write to another folder")
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(ROBOT_TRAJECTORY, "moveit_msgs/msg/RobotTrajectory"))
    try:
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".momapos-") as near:
            draft = Path(near) / folder.name
            with Writer(draft, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
                _fill(_Messages(store), _opener(writer, store), timeline, scene, robot, frame)
            os.rename(draft, folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from error


Send = Callable[[str, str, float, Any], None]
"""Writes a message; takes topic, type, time [s] and the message."""


def _opener(writer: Any, store: Any) -> Send:
    """Return a function that writes messages, and opens each topic at its first message."""
    topics: dict[str, Any] = {}

    def send(topic: str, kind: str, seconds: float, message: Any) -> None:
        if topic not in topics:
            topics[topic] = writer.add_connection(topic, kind, typestore=store)
        writer.write(topics[topic], round(seconds * 1e9), store.serialize_cdr(message, kind))

    return send


def _fill(
    make: _Messages, send: Send, timeline: Timeline, scene: Scene, robot: Robot, frame: str
) -> None:
    task, samples = timeline.task, timeline.samples
    target = scene.object(task.object)
    model = target.model
    moving = model.links if task.joint is None else model.moved_by(task.joint)
    text = robot.amended
    if text is None and robot.model.urdf.path is not None:
        text = robot.model.urdf.path.read_text(encoding="utf-8", errors="replace")
    if text is not None:
        kind = "std_msgs/msg/String"
        send("/robot_description", kind, 0.0, make.make(kind, data=text))
    _send_scene(make, send, scene, target, moving, frame)
    _send_path(make, send, timeline, frame)
    for stage, part in timeline.phases():
        if timeline.arm[stage]:
            kind = "moveit_msgs/msg/RobotTrajectory"
            began = float(samples.times[part.start])
            send("/trajectory", kind, began, _trajectory(make, samples, part, timeline.joints))
    for i in _at_rate(samples.times):
        _send_state(make, send, timeline, robot, frame, int(i))
        _send_part(make, send, timeline, target, moving, frame, int(i))


def _at_rate(times: Float[np.ndarray, " t"]) -> Any:
    """Return the indices of about `RATE` samples per second, with the first and the last."""
    wanted = np.append(np.arange(0.0, times[-1], 1.0 / RATE), times[-1])
    return np.unique(np.minimum(np.searchsorted(times, wanted), len(times) - 1))


def _send_state(
    make: _Messages, send: Send, timeline: Timeline, robot: Robot, frame: str, i: int
) -> None:
    samples, joints = timeline.samples, timeline.joints
    now, q, v = float(samples.times[i]), samples.positions[i], samples.velocities[i]
    kind = "sensor_msgs/msg/JointState"
    state = make.make(
        kind, header=make.header(now, ""), name=list(joints), position=q, velocity=v,
        effort=np.zeros(0),
    )  # fmt: skip
    send("/joint_states", kind, now, state)
    T_world_base = pose_planar(samples.base[i])
    kind = "geometry_msgs/msg/PoseStamped"
    header = make.header(now, frame)
    send("/base_pose", kind, now, make.make(kind, header=header, pose=make.pose(T_world_base)))
    poses = robot.model.link_poses(dict(zip(joints, q.tolist(), strict=True)))
    T_world_root = T_world_base @ np.linalg.inv(poses[robot.base_link])
    links = {name: T_world_root @ T for name, T in poses.items()}
    send("/tf", "tf2_msgs/msg/TFMessage", now, make.frames(now, frame, links))


def _send_part(
    make: _Messages,
    send: Send,
    timeline: Timeline,
    target: SceneObject,
    moving: tuple[str, ...],
    frame: str,
    i: int,
) -> None:
    samples, joint, Ts = timeline.samples, timeline.task.joint, timeline.Ts_world_object
    poses = target.link_poses({} if joint is None else {joint: float(samples.object_q[i])})
    if Ts is not None:
        T_now_rest = Ts[i] @ invert(poses[target.model.urdf.root])
        poses = {link: T_now_rest @ T for link, T in poses.items()}
    named = {f"{target.name}/{link}": poses[link] for link in moving}
    now = float(samples.times[i])
    send("/tf", "tf2_msgs/msg/TFMessage", now, make.frames(now, frame, named))


def _send_scene(
    make: _Messages,
    send: Send,
    scene: Scene,
    target: SceneObject,
    moving: tuple[str, ...],
    frame: str,
) -> None:
    """Send the hulls of all objects as markers; those of moving links in their own frames."""
    markers: list[Any] = []
    for item in scene.objects:
        for link, T in item.link_poses().items():
            own = item is target and link in moving
            where, pose = (f"{item.name}/{link}", np.eye(4)) if own else (frame, T)
            markers += [
                _marker(make, len(markers) + k, item.name, where, pose, hull, own)
                for k, hull in enumerate(item.model.hulls[link])
            ]
    kind = "visualization_msgs/msg/MarkerArray"
    send("/scene", kind, 0.0, make.make(kind, markers=markers))


def _marker(
    make: _Messages,
    number: int,
    name: str,
    frame: str,
    T: Float[np.ndarray, "4 4"],
    hull: Hull,
    moves: bool,
) -> Any:
    corners = hull.vertices[hull.faces].reshape(-1, 3)
    red, green, blue = (0.2, 0.5, 0.9) if moves else (0.7, 0.7, 0.7)
    image = make.make(
        "sensor_msgs/msg/CompressedImage", header=make.header(0.0, ""), format="",
        data=np.zeros(0, np.uint8),
    )  # fmt: skip
    return make.make(
        "visualization_msgs/msg/Marker",
        header=make.header(0.0, frame), ns=name, id=number, type=_TRIANGLES, action=_ADD,
        pose=make.pose(T), scale=make.vector(np.ones(3)),
        color=make.make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
        lifetime=make.duration(0.0), frame_locked=moves,
        points=[make.vector(corner, "Point") for corner in corners], colors=[],
        texture_resource="", texture=image, uv_coordinates=[], text="", mesh_resource="",
        mesh_file=make.make("visualization_msgs/msg/MeshFile", filename="",
                            data=np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )  # fmt: skip


def _send_path(make: _Messages, send: Send, timeline: Timeline, frame: str) -> None:
    if timeline.base_path is None:
        return
    header = make.header(0.0, frame)
    poses = [
        make.make("geometry_msgs/msg/PoseStamped", header=header, pose=make.pose(T))
        for T in pose_planar(timeline.base_path)
    ]
    kind = "nav_msgs/msg/Path"
    send("/base_path", kind, 0.0, make.make(kind, header=header, poses=poses))


def _trajectory(make: _Messages, samples: Samples, part: slice, joints: tuple[str, ...]) -> Any:
    """Make a `moveit_msgs/RobotTrajectory` of one phase; its times begin at 0."""
    times = samples.times[part] - samples.times[part.start]
    rows = zip(times, samples.positions[part], samples.velocities[part], strict=True)
    header, none = make.header(0.0, ""), np.zeros(0)
    points = [
        make.make(
            "trajectory_msgs/msg/JointTrajectoryPoint", positions=q, velocities=v,
            accelerations=none, effort=none, time_from_start=make.duration(float(t)),
        )
        for t, q, v in rows
    ]  # fmt: skip
    return make.make(
        "moveit_msgs/msg/RobotTrajectory",
        joint_trajectory=make.make(
            "trajectory_msgs/msg/JointTrajectory", header=header, joint_names=list(joints),
            points=points,
        ),
        multi_dof_joint_trajectory=make.make(
            "trajectory_msgs/msg/MultiDOFJointTrajectory", header=header, joint_names=[],
            points=[],
        ),
    )  # fmt: skip
