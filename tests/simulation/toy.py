"""The toy arm and its cupboard, ready to execute."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from tests.verification.door_case import BASE, JOINTS, OPEN, Case, make_case

from momapos.model.plan_files.plan_format import read_plan
from momapos.model.records.plans import Motion, Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf
from momapos.simulation.config import ExecutionConfig
from momapos.simulation.execute import attempt
from momapos.simulation.run_record import Execution


def execute(*args: Any, **options: Any) -> Execution:
    """Execute a motion once."""
    return attempt(*args, **options).execution


@dataclass
class Toy:
    """Inputs of a run."""

    scene: Scene
    robot: Robot
    motion: Motion
    task: Task = field(default_factory=lambda: Task("open", "cupboard", "hinge", OPEN))

    def run(self, **options: Any) -> Execution:
        """Execute the motion."""
        config = options.pop("config", ExecutionConfig())
        return execute(self.scene, self.robot, BASE, self.motion, self.task, config, **options)


def toy(folder: Path, case: Case | None = None) -> Toy:
    """Write and read the files of a case, with motors strong enough for its heavy links."""
    case = case or make_case()
    case.robot = case.robot.replace('effort="1"', 'effort="300"')
    plan = read_plan(case.write(folder))
    model = Articulated(read_urdf(folder / "robot.urdf"))
    robot = Robot(
        name="toy", path=folder / "robot.toml", model=model, base_link="base", tool_link="tool",
        arm_joints=JOINTS, gripper_links=("palm", "tool"), home=plan.motion.approach[0],
        footprint=np.array([[0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]]),
        drive="omni", max_speed=1.0, max_yaw_rate=1.0, max_acceleration=1.0,
        max_yaw_acceleration=1.0, approach_axis=np.array([0.0, 0.0, 1.0]),
        closing_axis=np.array([0.0, 1.0, 0.0]), opening=0.08, disabled=frozenset(),
    )  # fmt: skip
    return Toy(load_scene(folder / "scene.json"), robot, plan.motion)


def fingers(*, turning: bool = False) -> str:
    """Return the URDF of two sliding or coupled rotating fingers, with pads 8 cm apart."""
    text = []
    for name, side in (("left", 1), ("right", -1)):
        y = 0.046 * side
        text.append(
            f'<link name="{name}"><collision><origin xyz="0 {0 if turning else y} '
            f'{0.05 if turning else 0.14}"/><geometry><box size="0.02 0.012 '
            f'{0.1 if turning else 0.06}"/></geometry></collision></link>'
            f'<joint name="{name}_joint" type="{"revolute" if turning else "prismatic"}">'
            f'<parent link="palm"/><child link="{name}"/>'
            f'<origin xyz="0 {y if turning else 0} {0.08 if turning else 0}"/>'
            f'<axis xyz="{f"{side} 0 0" if turning else f"0 {-side} 0"}"/>'
            f'<limit lower="0" upper="{0.45 if turning else 0.04}" effort="50" velocity="1"/>'
        )
        follows = turning and side < 0
        text.append('<mimic joint="left_joint"/></joint>' if follows else "</joint>")
    return "".join(text)


def gripping(folder: Path, case: Case | None = None, *, turning: bool = False) -> Toy:
    """Return the toy with fingers of its own, in place of those of the case."""
    case = case or make_case()
    bare = re.sub(r'<joint name="(left|right)_slide".*?</joint>', "", case.robot, flags=re.DOTALL)
    bare = re.sub(r'<link name="(left|right)">.*?</link>', "", bare, flags=re.DOTALL)
    case.robot = bare.replace("</robot>", fingers(turning=turning) + "</robot>")
    plain = toy(folder, case)
    links = ("palm", "left", "right", "tool")
    return replace(plain, robot=replace(plain.robot, gripper_links=links))


def with_goal(toy: Toy, value: float) -> Toy:
    """Return the same motion, judged by another joint value."""
    return replace(toy, task=replace(toy.task, to=value))
