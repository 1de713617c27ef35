"""Write a plan as ROS 2 messages in JSON, and a scene for MoveIt.

The members have the names of the messages' fields, so that a node can copy them. A plan whose base
moves with the arm is version 2, which has a goal for both.

MoveIt's `PlanningScene::saveGeometryToStream` writes the text format of a planning scene, and
RViz's motion planning panel imports it: the pose of an object, its shapes with their poses and
colors, its subframes. It has only objects of the world, so the object in the hand is a message of
its own.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import write_atomic
from momapos.core.geometry import invert
from momapos.model.records import PlacementPlan
from momapos.model.robots import Robot, disable_lines, opened_as
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Geometry, Hull

from .timeline import Phase, PhaseKind

if TYPE_CHECKING:
    from jaxtyping import Float


FORMAT, VERSION, MOVING_VERSION = "momapos-ros2", 1, 2
BASE_JOINT = "base"
"""Name of the planar joint between the world's frame and the base."""


def stamp(seconds: float) -> dict[str, int]:
    """Return a `builtin_interfaces` Time or Duration."""
    whole, rest = divmod(round(seconds * 1e9), 1_000_000_000)
    return {"sec": whole, "nanosec": rest}


def pose_stamped(pose: Sequence[float], frame: str) -> dict[str, Any]:
    """Return a `geometry_msgs/PoseStamped` on the floor for x [m], y [m] and yaw [rad]."""
    x, y, yaw = pose
    return {
        "header": {"stamp": stamp(0.0), "frame_id": frame},
        "pose": {
            "position": {"x": x, "y": y, "z": 0.0},
            "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)},
        },
    }


def joint_trajectory(phase: Phase, joints: tuple[str, ...]) -> dict[str, Any]:
    """Return a `trajectory_msgs/JointTrajectory`."""
    rows = zip(
        phase.times.tolist(), phase.positions.tolist(), phase.velocities.tolist(), strict=True
    )
    points = [
        {
            "positions": q, "velocities": v, "accelerations": [], "effort": [],
            "time_from_start": stamp(t),
        }
        for t, q, v in rows
    ]  # fmt: skip
    header = {"stamp": stamp(0.0), "frame_id": ""}
    return {"header": header, "joint_names": list(joints), "points": points}


def base_trajectory(phase: Phase, frame: str) -> dict[str, Any]:
    """Return a `trajectory_msgs/MultiDOFJointTrajectory` of the base, at the times of the arm.

    Its velocities are twists in the frame of the base, as a base controller takes them.
    """
    change = np.gradient(phase.base, phase.times, axis=0)
    change[[0, -1]] = 0.0
    c, s = np.cos(phase.base[:, 2]), np.sin(phase.base[:, 2])
    ahead, left = c * change[:, 0] + s * change[:, 1], c * change[:, 1] - s * change[:, 0]
    rows = zip(
        phase.times.tolist(), phase.base.tolist(),
        np.column_stack([ahead, left, change[:, 2]]).tolist(), strict=True,
    )  # fmt: skip
    points = []
    for time, base, (x, y, turn) in rows:
        pose = pose_stamped(base, frame)["pose"]
        twist = {
            "linear": {"x": x, "y": y, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": turn}
        }  # fmt: skip
        transform = {"translation": pose["position"], "rotation": pose["orientation"]}
        points.append(
            {
                "transforms": [transform], "velocities": [twist], "accelerations": [],
                "time_from_start": stamp(time),
            }
        )  # fmt: skip
    header = {"stamp": stamp(0.0), "frame_id": frame}
    return {"header": header, "joint_names": [BASE_JOINT], "points": points}


def messages(
    plan: PlacementPlan, phases: tuple[Phase, ...], robot: Robot, frame: str
) -> dict[str, Any]:
    """Return all that a node needs to execute the plan, in order."""
    assert plan.base_pose is not None
    opening = opened_as(robot, plan.robot_rest).opening
    goal = pose_stamped(plan.base_pose, frame)
    steps: list[dict[str, Any]] = []
    for phase in phases:
        if phase.kind is PhaseKind.DRIVE:
            assert phase.base_path is not None
            poses = [pose_stamped(row, frame) for row in phase.base_path.tolist()]
            header = {"stamp": stamp(0.0), "frame_id": frame}
            steps.append(
                {
                    "action": "nav2_msgs/action/NavigateToPose",
                    "goal": {"pose": poses[-1], "behavior_tree": ""},
                    "path": {"header": header, "poses": poses},
                }
            )
        elif phase.kind is PhaseKind.ARM:
            trajectory = joint_trajectory(phase, plan.joints)
            action = "control_msgs/action/FollowJointTrajectory"
            steps.append({"action": action, "goal": {"trajectory": trajectory}})
        elif phase.kind is PhaseKind.DRIVE_AND_ARM:
            both = {
                "joint_trajectory": joint_trajectory(phase, plan.joints),
                "multi_dof_joint_trajectory": base_trajectory(phase, frame),
            }
            action = "moveit_msgs/action/ExecuteTrajectory"
            steps.append({"action": action, "goal": {"trajectory": both}})
        else:
            position = opening if phase.kind is PhaseKind.OPEN else 0.0
            command = {"position": position, "max_effort": robot.grip_force}
            action = "control_msgs/action/GripperCommand"
            steps.append({"action": action, "goal": {"command": command}})
    return {
        "format": FORMAT,
        "version": MOVING_VERSION if plan.moves_base else VERSION,
        "robot": plan.robot_name,
        "base_pose": goal,
        "steps": steps,
    }


def write_ros2(
    plan: PlacementPlan, phases: tuple[Phase, ...], robot: Robot, frame: str, path: Path
) -> None:
    """Write `messages` as JSON."""
    text = json.dumps(messages(plan, phases, robot, frame), indent=1) + "\n"
    write_atomic(path, text.encode())


PRIMITIVES = {"box": 1, "sphere": 2, "cylinder": 3}
"""Types of `shape_msgs/SolidPrimitive`."""


def carries_object(plan: PlacementPlan) -> bool:
    """Check that the plan picks or places a movable object."""
    return plan.task.joint is None and plan.motion is not None


def attached_object(plan: PlacementPlan, scene: Scene, robot: Robot) -> dict[str, Any]:
    """Return the members of the message: the object in the frame of the tool.

    The object is attached after the grasp of a pick, or before the release of a place.

    Args:
        plan: A solved plan that carries an object, see `carries_object`.
        scene: Scene of the plan.
        robot: Robot of the plan.
    """
    item, motion = scene.object(plan.task.object), plan.motion
    assert motion is not None
    T_tool_object = invert(motion.Ts_world_tool[0]) @ item.T_world_object
    primitives, poses, meshes, mesh_poses = [], [], [], []
    for link, T_world_link in item.link_poses().items():
        T = invert(item.T_world_object) @ T_world_link
        shapes = item.model.urdf.links[link].collisions
        for shape, hull in zip(shapes, item.model.hulls[link], strict=True):
            if shape.kind == "mesh":
                meshes.append({
                    "triangles": [{"vertex_indices": face} for face in hull.faces.tolist()],
                    "vertices": [dict(zip("xyz", v, strict=True)) for v in hull.vertices.tolist()],
                })  # fmt: skip
                mesh_poses.append(_pose_message(T))
            else:
                # The message lists a cylinder's height, then its radius.
                sizes = shape.size[::-1] if shape.kind == "cylinder" else shape.size
                primitives.append({"type": PRIMITIVES[shape.kind], "dimensions": list(sizes)})
                poses.append(_pose_message(T @ shape.T_link_geometry))
    return {
        "link_name": robot.tool_link,
        "object": {
            "header": {"stamp": stamp(0.0), "frame_id": robot.tool_link},
            "pose": _pose_message(T_tool_object),
            "id": item.name,
            "primitives": primitives,
            "primitive_poses": poses,
            "meshes": meshes,
            "mesh_poses": mesh_poses,
            "operation": 0,
        },
        "touch_links": list(robot.gripper_links),
    }


def write_attached(plan: PlacementPlan, scene: Scene, robot: Robot, path: Path) -> None:
    """Write `attached_object` as JSON."""
    text = json.dumps(attached_object(plan, scene, robot), indent=1) + "\n"
    write_atomic(path, text.encode())


def _pose_message(T: Float[np.ndarray, "4 4"]) -> dict[str, dict[str, float]]:
    position, turn = T[:3, 3].tolist(), Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
    return {
        "position": dict(zip("xyz", position, strict=True)),
        "orientation": dict(zip("xyzw", turn, strict=True)),
    }


COLOR = "0.7 0.7 0.7 1"


def write_scene(
    scene: Scene,
    T_frame_world: Float[np.ndarray, "4 4"],
    path: Path,
    *,
    absent: Collection[str] = (),
) -> None:
    """Write a planning scene, with one object per link of articulated furniture.

    Args:
        scene: The scene.
        T_frame_world: Pose of the world in the planning frame, by default the robot's base frame
            in MoveIt.
        path: The file.
        absent: Objects to omit.
    """
    lines = [scene.name.replace("\n", " ")]
    for item in scene.objects:
        if item.name in absent:
            continue
        for link, T in item.link_poses().items():
            lines += _object(item, link, T_frame_world @ T)
    write_atomic(path, "\n".join([*lines, ".", ""]).encode())


def _object(item: SceneObject, link: str, T: Float[np.ndarray, "4 4"]) -> Iterator[str]:
    """Yield the lines of a link; none if it has no shape."""
    shapes = item.model.urdf.links[link].collisions
    if not shapes:
        return
    alone = sum(bool(other.collisions) for other in item.model.urdf.links.values()) == 1
    yield f"* {item.name if alone else f'{item.name}/{link}'}"
    yield from _pose_lines(T)
    elements = item.model.static_elements[link]
    yield str(sum(len(element.hulls) for element in elements))
    for shape, element in zip(shapes, elements, strict=True):
        for hull in element.hulls:
            yield from _shape(shape, hull)
    yield "0"


def _shape(shape: Geometry, hull: Hull) -> Iterator[str]:
    if shape.kind == "mesh":
        yield "mesh"
        yield f"{len(hull.vertices)} {len(hull.faces)}"
        yield from (_numbers(vertex) for vertex in hull.vertices)
        yield from (" ".join(map(str, face)) for face in hull.faces.tolist())
        yield from _pose_lines(np.eye(4))
    else:
        yield shape.kind
        yield _numbers(np.array(shape.size))
        yield from _pose_lines(shape.T_link_geometry)
    yield COLOR


def _pose_lines(T: Float[np.ndarray, "4 4"]) -> tuple[str, str]:
    """Return two lines: position, and orientation as a quaternion x y z w."""
    return _numbers(T[:3, 3]), _numbers(Rotation.from_matrix(T[:3, :3]).as_quat())


def _numbers(values: Float[np.ndarray, " n"]) -> str:
    return " ".join(f"{value:.9g}" for value in (np.asarray(values) + 0.0).tolist())


def write_srdf(robot: Robot, path: Path) -> None:
    """Write an SRDF: the arm as a group with its home, the hand, and the disabled pairs."""
    hand = [name for name in robot.gripper_links if name in robot.model.urdf.links]
    pairs = sorted((min(pair), max(pair)) for pair in robot.disabled if len(pair) == 2)
    base, tool = quoteattr(robot.base_link), quoteattr(robot.tool_link)
    values = robot.chain.joint_values(robot.home).tolist()
    lines = [
        '<?xml version="1.0"?>',
        f"<robot name={quoteattr(robot.model.urdf.name)}>",
        '  <group name="arm">',
        f"    <chain base_link={base} tip_link={tool}/>",
        "  </group>",
        '  <group name="gripper">',
        *(f"    <link name={quoteattr(name)}/>" for name in hand),
        "  </group>",
        '  <group_state name="home" group="arm">',
        *(
            f'    <joint name={quoteattr(name)} value="{value:.9g}"/>'
            for name, value in zip(robot.moved_joints, values, strict=True)
        ),
        "  </group_state>",
        f'  <end_effector name="hand" group="gripper" parent_link={tool}/>',
        *disable_lines(dict.fromkeys(pairs, "User")),
        "</robot>",
        "",
    ]
    write_atomic(path, "\n".join(lines).encode())
