"""A program that drops a robot or a scene gets back all memory that belongs to them.

One robot is used in many scenes, or many robots in one scene, so nothing of the one may be cached
where it lives as long as the other.
"""

from __future__ import annotations

import gc
import weakref
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from tests.rooms import Everywhere, cabinet_room
from tests.urdf_parts import mobile_manipulator

from momapos.apps.cli.main import main
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.records.plans import PlacementPlan, Task
from momapos.model.robots.derive import write_robot
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.planning.keyword_forms import plan_base_placement
from momapos.verification.exact_check import PlanVerifier
from momapos.workflows.run import run_plan

TASK = Task("open", "cabinet", "hinge", 0.8)
BOX = (
    ', {"name": "box", "category": "box", "pose": {"xyz": [2.0, 0.5, 0.4], "wxyz": [1, 0, 0, 0]},'
    ' "box": [0.5, 0.5, 0.8]}'
)
KINDS = (Robot, Scene, SceneObject, Articulated)


def new_robot(folder: Path) -> Robot:
    """Write and load a robot of boxes."""
    folder.mkdir()
    text = mobile_manipulator().replace('effort="1"', 'effort="200"')
    (folder / "robot.urdf").write_text(text)
    return load_robot(write_robot(folder / "robot.urdf")[0])


def new_scene(folder: Path) -> Scene:
    """Write and load a room with a cabinet."""
    return cabinet_room(folder, extra=BOX)


def answered(scene: Scene, robot: Robot) -> PlacementPlan:
    """Plan a task, check the plan, and execute it in physics."""
    reach = Everywhere()
    plan = plan_base_placement(scene, robot, TASK, reach).plan
    assert plan.feasible, plan.status
    assert PlanVerifier(scene, robot, plan.task).check(plan.base_pose, plan.motion).valid
    assert run_plan(plan, scene, robot, reach, tries=1).success
    return plan


def parts(scene: Scene | None = None, robot: Robot | None = None) -> list[weakref.ref[Any]]:
    """Return references to a scene with its objects, to a robot, and to their models."""
    found: list[Any] = []
    if scene is not None:
        found += [scene, *scene.objects, *(item.model for item in scene.objects)]
    if robot is not None:
        found += [robot, robot.model, robot.chain, robot.ik, robot.spheres]
    return [weakref.ref(one) for one in found]


def alive(references: list[weakref.ref[Any]]) -> list[Any]:
    """Return which objects still exist."""
    gc.collect()
    return [one for one in (ref() for ref in references) if one is not None]


def test_scenes_are_dropped_while_their_robot_stays(tmp_path: Path) -> None:
    robot = new_robot(tmp_path / "robot")
    scene = new_scene(tmp_path / "scene")
    plan = answered(scene, robot)
    references = parts(scene)
    del scene, plan
    assert alive(references) == []


def test_robots_are_dropped_while_their_scene_stays(tmp_path: Path) -> None:
    scene = new_scene(tmp_path / "scene")
    robot = new_robot(tmp_path / "robot")
    plan = answered(scene, robot)
    references = parts(robot=robot)
    del robot, plan
    assert alive(references) == []


@pytest.mark.slow
def test_commands_leave_none_of_the_inputs_of_their_plan(tmp_path: Path) -> None:
    scene, robot = new_scene(tmp_path / "scene"), new_robot(tmp_path / "robot")
    file = tmp_path / "plan.json"
    write_plan(answered(scene, robot), file)
    del scene, robot

    def count() -> Counter[type]:
        gc.collect()
        kinds = Counter(type(one) for one in gc.get_objects())
        return Counter({kind: kinds[kind] for kind in KINDS})

    before = count()
    commands = [
        ["verify"],
        ["run", "--tries", "1"],
        ["export", "--to", "csv", "--out", str(tmp_path / "plan.csv")],
        ["view", "--static", str(tmp_path / "plan.html")],
    ]
    for name, *options in commands:
        assert main([name, str(file), *options]) == 0
        assert count() == before, name
