"""The planner avoids what motors and base do not bear, and says so when nothing else is left."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.model.robots.test_load_limits import with_urdf

from momapos.core.errors import InputError, SceneError
from momapos.model.records.plans import JointResistance
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.robots.robot_names import LIBRARY
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import check_base_pose, plan_base_placement
from momapos.planning.placement.config import PlaceConfig

Robots = Callable[[str], Robot]
QUICK = PipelineConfig(timeout=20.0)


def test_an_object_beyond_the_payload_is_refused_in_words(kitchen: Scene, robots: Robots) -> None:
    robot, heavy = robots("mobile_panda"), kitchen.with_mass("apple", 5.0)
    plan = plan_base_placement(heavy, robot, make_task(heavy, "pick", "apple")).plan
    assert plan.status == "infeasible"
    assert "apple weighs 5 kg, and mobile_panda carries 2.24 kg" in plan.candidates.rejections


def test_a_heavier_object_within_the_payload_is_in_the_plan(kitchen: Scene, fetch: Robot) -> None:
    heavy = kitchen.with_mass("apple", 2.0)
    plan = plan_base_placement(heavy, fetch, make_task(heavy, "pick", "apple")).plan
    assert plan.status == "solved"
    assert plan.loads.payload == 2.0
    assert "2 kg in the hand" in str(plan.loads)


def test_a_motor_too_weak_for_the_pull_is_named(
    kitchen: Scene, tmp_path: Path, segway: Robot
) -> None:
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    plan = plan_base_placement(kitchen, segway, task).plan
    weak = with_urdf(tmp_path, ('effort="150"', 'effort="40"'))
    attempt = check_base_pose(kitchen, weak, task, plan.base_pose)
    assert attempt.motion is None
    assert "shoulder_lift_joint needs" in attempt.reason
    assert "of 40 Nm" in attempt.reason


def test_the_answer_says_which_efforts_are_unknown(kitchen: Scene, tmp_path: Path) -> None:
    robot = with_urdf(tmp_path, ('effort="28"', 'effort="0"'))
    task = make_task(kitchen, "open", "cabinet_left", "drawer_slide")
    loads = plan_base_placement(kitchen, robot, task).plan.loads
    assert set(loads.efforts) == {"shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"}
    (note,) = loads.notes
    assert note.startswith("no effort limit is known for wrist_1_joint, ")
    assert note in str(loads)


def test_a_home_that_a_motor_cannot_hold_is_the_reason(kitchen: Scene, tmp_path: Path) -> None:
    weak = with_urdf(tmp_path, ('effort="150"', 'effort="9"'))
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    plan = plan_base_placement(kitchen, weak, task, config=QUICK).plan
    assert plan.status == "infeasible"
    (reason,) = [words for words in plan.candidates.rejections if "needs" in words]
    assert reason.startswith("elbow_joint needs 18.5 of 9 Nm at home; if springs bear the weight")


def test_a_part_that_tips_the_robot_over_is_left_closed(kitchen: Scene, stretch: Robot) -> None:
    stiff = {"cabinet_left": {"drawer_slide": JointResistance(seal_force=14.0)}}
    scene = kitchen.with_resistance(stiff)
    task = make_task(scene, "open", "cabinet_left", "drawer_slide")
    assert plan_base_placement(kitchen, stretch, task).plan.status == "solved"
    config = PipelineConfig(place=PlaceConfig(rounds=1, grid=False), base="fixed")
    plan = plan_base_placement(scene, stretch, task, config=config).plan
    assert plan.status == "infeasible"
    assert plan.candidates.nearest.reason.startswith("stretch would tip over at ")
    assert "stretch would tip over" in plan.candidates.rejections


def test_a_scene_file_holds_the_mass_of_an_object(tmp_path: Path) -> None:
    objects = (
        SceneObject.box("crate", [0.1] * 3, [0, 0, 1]),
        SceneObject.box("top", [1] * 3, [0, 0, 0.4]),
    )
    save_scene(Scene("room", objects).with_mass("crate", 0.2), tmp_path / "room.json")
    again = load_scene(tmp_path / "room.json")
    assert again.object("crate").mass == 0.2
    assert again.object("top").mass is None


@pytest.mark.parametrize("mass", [0, -1, 1e9, "heavy", None, True])
def test_an_impossible_mass_is_refused_in_one_line(mass: object, tmp_path: Path) -> None:
    scene = Scene("room", (SceneObject.box("crate", [0.1] * 3, [0, 0, 1]),))
    save_scene(scene, tmp_path / "room.json")
    content = json.loads((tmp_path / "room.json").read_text())
    content["objects"][0]["mass"] = mass
    (tmp_path / "room.json").write_text(json.dumps(content))
    with pytest.raises(SceneError, match="mass") as caught:
        load_scene(tmp_path / "room.json")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("mass", [0.0, -1.0, 1e9, float("nan"), float("inf")])
def test_an_impossible_mass_in_code_is_refused(mass: float) -> None:
    scene = Scene("room", (SceneObject.box("crate", [0.1] * 3, [0, 0, 1]),))
    with pytest.raises(InputError, match="mass of 'crate'"):
        scene.with_mass("crate", mass)


def test_a_robot_file_without_payload_lifts_what_its_motors_bear(
    kitchen: Scene, tmp_path: Path
) -> None:
    folder = tmp_path / "husky_ur5e"
    shutil.copytree(LIBRARY / "husky_ur5e", folder)
    text = (folder / "husky_ur5e.toml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("payload")]
    (folder / "husky_ur5e.toml").write_text("\n".join(lines))
    robot = load_robot(folder / "husky_ur5e.toml")
    heavy = kitchen.with_mass("apple", 40.0)
    plan = plan_base_placement(heavy, robot, make_task(heavy, "pick", "apple"), config=QUICK).plan
    assert plan.status != "solved"
