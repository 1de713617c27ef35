"""Write a plan as ROS 2 messages in JSON: goals for Nav2, an arm controller and a gripper.

The members have the names of the messages' fields, so that a node can copy them. A plan whose base
moves with the arm is version 2, which has a goal for both.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import write_atomic
from momapos.model.records import PlacementPlan
from momapos.model.robots import Robot, opened_as

from .phases import Phase, PhaseKind

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
