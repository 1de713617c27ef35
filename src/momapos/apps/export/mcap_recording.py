"""Write a timeline as a ROS 2 bag in MCAP, for Foxglove, RViz and `ros2 bag play`.

Topics: /tf (frames of the robot and of the moved object), /joint_states, /robot_description,
/base_pose, /base_path, /trajectory (moveit_msgs/RobotTrajectory), /scene (markers of the shapes).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import InputError, require, temporary_folder
from momapos.core.geometry import invert, pose_planar
from momapos.model.robots import Robot
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Hull

from .ros2 import BASE_JOINT, stamp
from .timeline import Samples, Timeline

if TYPE_CHECKING:
    from jaxtyping import Float

RATE = 20.0
"""State messages per second [1/s]."""
ROBOT_TRAJECTORY = """trajectory_msgs/JointTrajectory joint_trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_joint_trajectory
"""
"""Definition of moveit_msgs/msg/RobotTrajectory, which is not in the type store."""
_TRIANGLES, _ADD = 11, 0


@dataclass(frozen=True, eq=False)
class _Bag:
    """An open bag: makes and writes ROS messages."""

    store: Any
    writer: Any
    frame: str
    """Name of the world frame."""
    topics: dict[str, Any] = field(default_factory=dict)

    def send(self, topic: str, kind: str, seconds: float, **members: Any) -> None:
        """Make and write a message of a type; the first one opens its topic."""
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        content = self.store.serialize_cdr(self.make(kind, **members), kind)
        self.writer.write(self.topics[topic], round(seconds * 1e9), content)

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

    def send_frames(self, seconds: float, poses: dict[str, Any]) -> None:
        """Write a TFMessage of frames in the world frame."""
        transforms = [
            self.make(
                "geometry_msgs/msg/TransformStamped",
                header=self.header(seconds, self.frame), child_frame_id=name,
                transform=self.make(
                    "geometry_msgs/msg/Transform",
                    translation=self.vector(T[:3, 3]), rotation=self.quaternion(T[:3, :3]),
                ),
            )
            for name, T in poses.items()
        ]  # fmt: skip
        self.send("/tf", "tf2_msgs/msg/TFMessage", seconds, transforms=transforms)


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
        with temporary_folder(folder.parent, folder.name) as near:
            draft = near / folder.name
            with Writer(draft, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
                _fill(_Bag(store, writer, frame), timeline, scene, robot)
            os.rename(draft, folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from error


def _fill(bag: _Bag, timeline: Timeline, scene: Scene, robot: Robot) -> None:
    task, samples = timeline.task, timeline.samples
    target = scene.object(task.object)
    model = target.model
    moving = model.links if task.joint is None else model.moved_by(task.joint)
    text = robot.amended
    if text is None and robot.model.urdf.path is not None:
        text = robot.model.urdf.path.read_text(encoding="utf-8", errors="replace")
    if text is not None:
        bag.send("/robot_description", "std_msgs/msg/String", 0.0, data=text)
    _send_scene(bag, scene, target, moving)
    _send_path(bag, timeline)
    for stage, part in timeline.phases():
        if timeline.arm[stage]:
            _send_trajectory(bag, samples, part, list(timeline.joints))
    for i in _at_rate(samples.times):
        _send_state(bag, timeline, robot, int(i))
        _send_part(bag, timeline, target, moving, int(i))


def _at_rate(times: Float[np.ndarray, " t"]) -> Any:
    """Return the indices of about `RATE` samples per second, with the first and the last."""
    wanted = np.append(np.arange(0.0, times[-1], 1.0 / RATE), times[-1])
    return np.unique(np.minimum(np.searchsorted(times, wanted), len(times) - 1))


def _send_state(bag: _Bag, timeline: Timeline, robot: Robot, i: int) -> None:
    samples, joints = timeline.samples, timeline.joints
    now, q, v = float(samples.times[i]), samples.positions[i], samples.velocities[i]
    bag.send(
        "/joint_states", "sensor_msgs/msg/JointState", now, header=bag.header(now, ""),
        name=list(joints), position=q, velocity=v, effort=np.zeros(0),
    )  # fmt: skip
    T_world_base = pose_planar(samples.base[i])
    bag.send(
        "/base_pose", "geometry_msgs/msg/PoseStamped", now, header=bag.header(now, bag.frame),
        pose=bag.pose(T_world_base),
    )  # fmt: skip
    poses = robot.model.link_poses(dict(zip(joints, q.tolist(), strict=True)))
    T_world_root = T_world_base @ np.linalg.inv(poses[robot.base_link])
    bag.send_frames(now, {name: T_world_root @ T for name, T in poses.items()})


def _send_part(
    bag: _Bag, timeline: Timeline, target: SceneObject, moving: tuple[str, ...], i: int
) -> None:
    samples, Ts = timeline.samples, timeline.Ts_world_object
    poses = target.link_poses(timeline.object_values(i))
    if Ts is not None:
        T_now_rest = Ts[i] @ invert(poses[target.model.urdf.root])
        poses = {link: T_now_rest @ T for link, T in poses.items()}
    named = {f"{target.name}/{link}": poses[link] for link in moving}
    bag.send_frames(float(samples.times[i]), named)


def _send_scene(bag: _Bag, scene: Scene, target: SceneObject, moving: tuple[str, ...]) -> None:
    """Send the hulls of all objects as markers; those of moving links in their own frames."""
    markers: list[Any] = []
    for item in scene.objects:
        for link, T in item.link_poses().items():
            own = item is target and link in moving
            where, pose = (f"{item.name}/{link}", np.eye(4)) if own else (bag.frame, T)
            markers += [
                _marker(bag, len(markers) + k, item.name, where, pose, hull, own)
                for k, hull in enumerate(item.model.hulls[link])
            ]
    bag.send("/scene", "visualization_msgs/msg/MarkerArray", 0.0, markers=markers)


def _marker(
    bag: _Bag,
    number: int,
    name: str,
    frame: str,
    T: Float[np.ndarray, "4 4"],
    hull: Hull,
    moves: bool,
) -> Any:
    corners = hull.vertices[hull.faces].reshape(-1, 3)
    red, green, blue = (0.2, 0.5, 0.9) if moves else (0.7, 0.7, 0.7)
    image = bag.make(
        "sensor_msgs/msg/CompressedImage", header=bag.header(0.0, ""), format="",
        data=np.zeros(0, np.uint8),
    )  # fmt: skip
    return bag.make(
        "visualization_msgs/msg/Marker",
        header=bag.header(0.0, frame), ns=name, id=number, type=_TRIANGLES, action=_ADD,
        pose=bag.pose(T), scale=bag.vector(np.ones(3)),
        color=bag.make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
        lifetime=bag.duration(0.0), frame_locked=moves,
        points=[bag.vector(corner, "Point") for corner in corners], colors=[],
        texture_resource="", texture=image, uv_coordinates=[], text="", mesh_resource="",
        mesh_file=bag.make("visualization_msgs/msg/MeshFile", filename="",
                            data=np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )  # fmt: skip


def _send_path(bag: _Bag, timeline: Timeline) -> None:
    if timeline.base_path is None:
        return
    header = bag.header(0.0, bag.frame)
    poses = [
        bag.make("geometry_msgs/msg/PoseStamped", header=header, pose=bag.pose(T))
        for T in pose_planar(timeline.base_path)
    ]
    bag.send("/base_path", "nav_msgs/msg/Path", 0.0, header=header, poses=poses)


def _base_point(bag: _Bag, samples: Samples, i: int, began: float) -> Any:
    """Make the point of a base's trajectory at a sample."""
    T = pose_planar(samples.base[i])
    transform = bag.make(
        "geometry_msgs/msg/Transform",
        translation=bag.vector(T[:3, 3]), rotation=bag.quaternion(T[:3, :3]),
    )  # fmt: skip
    return bag.make(
        "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint", transforms=[transform], velocities=[],
        accelerations=[], time_from_start=bag.duration(float(samples.times[i] - began)),
    )  # fmt: skip


def _send_trajectory(bag: _Bag, samples: Samples, part: slice, joints: list[str]) -> None:
    """Send the `moveit_msgs/RobotTrajectory` of one phase; its times begin at 0."""
    began, header, none = samples.times[part.start], bag.header(0.0, ""), np.zeros(0)
    points = [
        bag.make(
            "trajectory_msgs/msg/JointTrajectoryPoint", positions=q, velocities=v,
            accelerations=none, effort=none, time_from_start=bag.duration(float(t)),
        )
        for t, q, v in zip(
            samples.times[part] - began, samples.positions[part], samples.velocities[part],
            strict=True,
        )
    ]  # fmt: skip
    arm = bag.make(
        "trajectory_msgs/msg/JointTrajectory", header=header, joint_names=joints, points=points
    )
    moves = bool(np.ptp(samples.base[part], axis=0).max() > 0.0)
    rows = range(*part.indices(len(samples.times)))
    base = bag.make(
        "trajectory_msgs/msg/MultiDOFJointTrajectory", header=bag.header(0.0, bag.frame),
        joint_names=[BASE_JOINT] if moves else [],
        points=[_base_point(bag, samples, i, began) for i in rows] if moves else [],
    )  # fmt: skip
    bag.send(
        "/trajectory", "moveit_msgs/msg/RobotTrajectory", float(began), joint_trajectory=arm,
        multi_dof_joint_trajectory=base,
    )  # fmt: skip
