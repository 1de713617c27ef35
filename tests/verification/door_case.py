"""A toy arm opens the door of a cupboard, a case small enough to know the right answer.

The plan comes from closed-form inverse kinematics along the arc of the handle, without a planner.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from momapos.core.geometry.transforms import invert, pose, pose_planar, rotation_about
from momapos.model.kinematics.chain import build_chain
from momapos.model.kinematics.ik import build_ik, solve_ik
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf

JOINTS = ("pan", "lift", "elbow", "roll", "pitch", "twist")
BASE = (-0.7, 0.15, 0.3)
OPEN = 1.0
UP = np.array([0.0, 0.0, 1.0])
FINGER = '<box size="0.02 0.01 0.06"/>'
HINGE, HANDLE = (0.185, -0.29, 0.8), (-0.09, 0.54, 0.0)


def robot_urdf() -> str:
    """Return a six-axis arm with a spherical wrist on a box, and two fingers around the tool frame.

    They close along its y axis.
    """
    links = {
        "base": ("0 0 0.3", '<box size="0.4 0.4 0.5"/>'),
        "shoulder": ("0 0 0.03", '<sphere radius="0.06"/>'),
        "upper": ("0 0 0.2", '<cylinder radius="0.04" length="0.3"/>'),
        "fore": ("0 0 0.18", '<cylinder radius="0.035" length="0.26"/>'),
        "wrist": None,
        "knuckle": ("0 0 0", '<sphere radius="0.03"/>'),
        "palm": ("0 0 0.09", '<box size="0.08 0.06 0.06"/>'),
        "left": ("0 0.035 0.025", FINGER),
        "right": ("0 -0.035 0.025", FINGER),
    }
    joints = {
        "pan": ("base", "shoulder", "0 0 0.65", "0 0 1", 3.1),
        "lift": ("shoulder", "upper", "0 0 0.1", "0 1 0", 2.8),
        "elbow": ("upper", "fore", "0 0 0.4", "0 1 0", 2.8),
        "roll": ("fore", "wrist", "0 0 0.4", "0 0 1", 3.1),
        "pitch": ("wrist", "knuckle", "0 0 0", "0 1 0", 2.4),
        "twist": ("knuckle", "palm", "0 0 0", "0 0 1", 3.1),
    }
    text = ['<robot name="toy">', '<link name="tool"/>']
    for name, shape in links.items():
        body = ""
        if shape is not None:
            origin = f'<origin xyz="{shape[0]}"/>'
            body = f"<collision>{origin}<geometry>{shape[1]}</geometry></collision>"
        text.append(f'<link name="{name}">{body}</link>')
    for name, (parent, child, origin, axis, limit) in joints.items():
        text.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>'
            f'<limit lower="-{limit}" upper="{limit}" effort="300" velocity="1"/></joint>'
        )
    for name, side in (("left", -1), ("right", 1)):
        text.append(
            f'<joint name="{name}_slide" type="prismatic"><parent link="palm"/>'
            f'<child link="{name}"/><origin xyz="0 0 0.12"/><axis xyz="0 {side} 0"/>'
            '<limit lower="0" upper="0.03" effort="60" velocity="1"/></joint>'
        )
    text.append(
        '<joint name="mount" type="fixed"><parent link="palm"/><child link="tool"/>'
        '<origin xyz="0 0 0.16"/></joint></robot>'
    )
    return "\n".join(text)


def cupboard_urdf(*, handle: bool = True) -> str:
    """Return a closed box whose front door opens towards -x."""
    bar = '<collision><geometry><box size="0.02 0.02 0.12"/></geometry></collision>'
    return f"""<robot name="cupboard">
<link name="body"><collision><geometry><box size="0.4 0.6 0.8"/></geometry></collision></link>
<link name="door"><collision><origin xyz="0 0.29 0"/>
  <geometry><box size="0.02 0.58 0.78"/></geometry></collision></link>
<link name="handle">{bar if handle else ""}</link>
<joint name="hinge" type="revolute"><parent link="body"/><child link="door"/>
  <origin xyz="-0.215 -0.29 0"/><axis xyz="0 0 1"/>
  <limit lower="0" upper="1.2" effort="1" velocity="1"/></joint>
<joint name="bar" type="fixed"><parent link="door"/><child link="handle"/>
  <origin xyz="{HANDLE[0]} {HANDLE[1]} {HANDLE[2]}"/></joint>
</robot>"""


def scene_dict() -> dict[str, Any]:
    """Return a scene of the cupboard and a box away from all motion."""
    upright = [1.0, 0.0, 0.0, 0.0]
    return {
        "format": "momapos-scene",
        "version": 1,
        "name": "toy room",
        "floor": [[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]],
        "objects": [
            {
                "name": "cupboard", "category": "cabinet", "urdf": "cupboard.urdf",
                "pose": {"xyz": [0.4, 0.0, 0.8], "wxyz": upright}, "joints": {"hinge": 0.0},
            },
            {
                "name": "bin", "category": "bin", "box": [0.2, 0.2, 0.3],
                "pose": {"xyz": [-0.7, -1.5, 0.15], "wxyz": upright},
            },
        ],
    }  # fmt: skip


def tool_poses(values: np.ndarray, turns: np.ndarray | float = 0.0) -> np.ndarray:
    """Return tool poses at the handle for angles of the door, turned about the bar."""
    grip = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])  # approach along +x
    R_door, R_turn = rotation_about(UP, values), rotation_about(UP, turns + 0.0 * values)
    T_world_door = np.array([pose(HINGE, R) for R in R_door])
    return T_world_door @ np.array([pose(HANDLE, R @ grip) for R in R_turn])


@dataclass(frozen=True)
class Grip:
    """How the hand is off the middle of the bar, in the tool frame."""

    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Along the bar, between the fingers, and out of the hand [m]."""
    roll: float = 0.0
    """About the direction out of the hand [deg]."""

    @property
    def T(self) -> np.ndarray:
        """Return the pose of the tool in that of one in the middle of the bar."""
        return pose(self.shift, rotation_about(UP, np.array(np.radians(self.roll))))


MIDDLE = Grip()


@cache
def arm_path(turn: float = 0.0, grip: Grip = MIDDLE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the arm states of approach and arc, and the door's values along the arc.

    The hand turns about the bar by `turn` times the door's angle.
    """
    with TemporaryDirectory() as folder:
        (Path(folder) / "robot.urdf").write_text(robot_urdf())
        model = Articulated(read_urdf(Path(folder) / "robot.urdf"))
    chain, _ = build_chain(model, "base", "tool", JOINTS)
    values = np.linspace(0.0, OPEN, 41)
    held = tool_poses(values, turn * values) @ grip.T
    before = held[:1] @ np.array([pose((0.0, 0.0, z)) for z in np.linspace(-0.1, 0.0, 11)])
    Ts = invert(pose_planar(np.array(BASE))) @ np.concatenate([before, held])
    solutions, counts = solve_ik(chain, build_ik(chain), Ts)
    for first in range(counts[0]):
        path = [solutions[0, first]]
        for states, count in zip(solutions[1:], counts[1:], strict=True):
            if not count:
                break
            apart = np.abs(states[:count] - path[-1]).max(1)
            path.append(states[int(apart.argmin())])
        if len(path) == len(Ts) and np.abs(np.diff(path, axis=0)).max() < 0.2:
            return np.array(path[:11]), np.array(path[11:]), values
    raise AssertionError("the toy arm does not reach along the arc")


@dataclass
class Case:
    """The files of the case; tests change them before writing."""

    plan: dict[str, Any]
    scene: dict[str, Any]
    robot: str
    cupboard: str

    def write(self, folder: Path) -> Path:
        """Write the files into a folder; return the plan's path."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "robot.urdf").write_text(self.robot)
        (folder / "cupboard.urdf").write_text(self.cupboard)
        (folder / "scene.json").write_text(json.dumps(self.scene))
        (folder / "plan.json").write_text(json.dumps(self.plan))
        return folder / "plan.json"

    def q(self) -> list[list[float]]:
        """Return all states of the arm, approach first; the lists are the plan's own."""
        return [*self.plan["approach"], *self.plan["manipulation"]["q"]]

    def obstacle(self, size: list[float], xyz: list[float], name: str = "post") -> None:
        """Add a box to the scene."""
        upright = [1.0, 0.0, 0.0, 0.0]
        box = {"name": name, "box": size, "pose": {"xyz": xyz, "wxyz": upright}}
        self.scene["objects"].append(box)

    def set_door_values(self, values: np.ndarray) -> None:
        """Change the door's values without changing the arm states."""
        self.plan["manipulation"]["object_q"] = values.tolist()


def make_case(turn: float = 0.0, grip: Grip = MIDDLE) -> Case:
    """Build a plan and its files, valid if the grip is; see `arm_path` for `turn`."""
    approach, q, values = arm_path(turn, grip)
    plan = {
        "format": "momapos-plan",
        "version": 1,
        "scene": "scene.json",
        "robot": {"name": "toy", "urdf": "robot.urdf", "base_link": "base", "tool_link": "tool"},
        "task": {"verb": "open", "object": "cupboard", "joint": "hinge", "to": OPEN},
        "status": "solved",
        "base_pose": dict(zip(("x", "y", "yaw"), BASE, strict=True)),
        "joints": list(JOINTS),
        "approach": approach.tolist(),
        "manipulation": {
            "q": q.tolist(),
            "object_q": values.tolist(),
            "T_world_tool": (tool_poses(values, turn * values) @ grip.T).tolist(),
        },
        "navigation_cost": 1.5,
        "candidates": {"sampled": 8, "checked": 2, "rejections": {"no path": 1}},
        "timing": {"search": 0.25, "total": 0.5},
        "method": "by hand",
        "seed": 7,
        "versions": {"numpy": "2"},
    }
    return Case(plan, scene_dict(), robot_urdf(), cupboard_urdf())
