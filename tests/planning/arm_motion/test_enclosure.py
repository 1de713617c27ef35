"""What encloses an object keeps the arm out, before any base pose is tried."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import DOOR, HINGE, carcass, furniture_room
from tests.rooms import Everywhere

from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.arm_motion.hand_clearance import MAX_NAMES
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.task_setup import prepare

SIZE, WALL = np.array([0.7, 0.6, 0.8]), 0.02


def case_around_a_mug(*, gap: float, yaw: float = 0.0, leave_out: str = "") -> Scene:
    """Return six panels around a mug, the front one a gap away from the sides."""
    center = np.array([0.3, 0.2, 0.9])
    panels = {
        f"{name}_{'low' if side < 0 else 'high'}": (axis, side)
        for axis, name in enumerate(("front", "side", "cover"))
        for side in (-1, 1)
    }
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    items = []
    for name, (axis, side) in panels.items():
        size, offset = SIZE.copy(), np.zeros(3)
        size[axis] = WALL
        offset[axis] = side * (SIZE[axis] / 2 + WALL / 2 + (gap if name == "front_low" else 0.0))
        if name != leave_out:
            place = (center + turn @ offset).tolist()
            items.append(SceneObject.box(name, size.tolist(), place, yaw=yaw))
    x, y, z = center.tolist()
    mug = SceneObject.box("mug", (0.07, 0.07, 0.1), (x, y, z - SIZE[2] / 2 + 0.05))
    return Scene("case", (*items, mug), start=np.array([-2.0, 0.0, 0.0]))


def reason(scene: Scene, robot: Robot) -> str:
    task = make_task(scene, "pick", "mug")
    return prepare(scene, robot, task, PipelineConfig(), clearance=0.0).infeasible_reason


@pytest.mark.parametrize("yaw", [0.0, 0.6])
@pytest.mark.parametrize("gap", [0.0, 0.008])
def test_closed_panels_enclose_the_hand_and_are_named(gap: float, yaw: float, fetch: Robot) -> None:
    found = reason(case_around_a_mug(gap=gap, yaw=yaw), fetch)
    assert found.endswith(" enclose the hand in every grasp")
    sides = {"front_low", "front_high", "side_low", "side_high", "cover_low", "cover_high"}
    assert len({name for name in sides if f"{name}/box" in found}) == MAX_NAMES


@pytest.mark.parametrize("name", ["front_low", "side_high", "cover_high"])
def test_a_missing_panel_lets_the_hand_in(name: str, fetch: Robot) -> None:
    assert reason(case_around_a_mug(gap=0.0, leave_out=name), fetch) == ""


@pytest.mark.parametrize("yaw", [0.0, 0.6])
def test_a_gap_that_an_arm_may_fit_through_counts_as_open(yaw: float, fetch: Robot) -> None:
    assert reason(case_around_a_mug(gap=0.08, yaw=yaw), fetch) == ""


@pytest.mark.parametrize(("angle", "enclosed"), [(0.0, True), (1.4, False)])
def test_the_content_of_a_cupboard_is_enclosed_until_its_door_is_open(
    tmp_path: Path, angle: float, enclosed: bool, fetch: Robot
) -> None:
    scene = furniture_room(tmp_path, [carcass(), DOOR, HINGE]).with_joint(
        "cupboard", "hinge", angle
    )
    mug = SceneObject.box("mug", (0.07, 0.07, 0.1), (0.8, 0.0, 0.35))
    scene = Scene("room", (*scene.objects, mug), start=np.array([-1.5, 0.0, 0.0]))
    found = reason(scene, fetch)
    assert (found == "cupboard/body and cupboard/door enclose the hand in every grasp") == enclosed


def test_no_arm_is_checked_for_an_enclosed_object(fetch: Robot) -> None:
    scene = case_around_a_mug(gap=0.0)
    task = make_task(scene, "pick", "mug")
    plan = plan_base_placement(scene, fetch, task, Everywhere()).plan
    assert plan.status == "infeasible"
    assert plan.candidates.checked == 0
    assert "enclose the hand" in next(iter(plan.candidates.rejections))
