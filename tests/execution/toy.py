"""The toy arm and its cupboard, ready to be executed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from tests.verification.door_case import BASE, JOINTS, OPEN, Case, make_case

from momapos.execution.config import ExecutionConfig
from momapos.execution.record import Execution
from momapos.execution.run import execute
from momapos.kinematics.articulated import Articulated
from momapos.kinematics.urdf import read_urdf
from momapos.plans import read_plan
from momapos.robots.robot import Robot
from momapos.scene.files import load_scene
from momapos.scene.scene import Scene
from momapos.types import Motion, Task


@dataclass
class Toy:
    """All that a run takes."""

    scene: Scene
    robot: Robot
    motion: Motion
    task: Task = field(default_factory=lambda: Task("open", "cupboard", "hinge", OPEN))

    def run(self, **options: Any) -> Execution:
        """Execute it."""
        config = options.pop("config", ExecutionConfig())
        return execute(self.scene, self.robot, BASE, self.motion, self.task, config, **options)


def toy(folder: Path, case: Case | None = None) -> Toy:
    """Write the files of a case and read them; motors are strong enough for its heavy links."""
    case = case or make_case()
    case.robot = case.robot.replace('effort="1"', 'effort="300"')
    plan = read_plan(case.write(folder))
    assert plan.motion is not None
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


def asked(toy: Toy, value: float) -> Toy:
    """The same motion, judged by another value of the joint."""
    return replace(toy, task=replace(toy.task, to=value))
