"""Joints set on the command line are stored in the plan."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of, json_of
from tests.rooms import Everywhere, cabinet_room

from momapos.core.errors import MomaposError
from momapos.model.plan_files.plan_format import plan_to_dict, read_plan, write_plan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene, set_joints
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.verification.plan_check import verify_files

CONFIG = PipelineConfig(place=PlaceConfig(count=256, polish=1), timeout=300.0)


def test_a_set_joint_has_its_value_and_is_recorded(kitchen: Scene) -> None:
    ajar = set_joints(kitchen, ["fridge/door_hinge=60deg", "cabinet_left/drawer_slide=10cm"])
    assert ajar.object("fridge").values()["door_hinge"] == pytest.approx(np.pi / 3)
    assert ajar.object("cabinet_left").values()["drawer_slide"] == pytest.approx(0.1)
    assert kitchen.joints_set == {}
    assert ajar.joints_set == {
        "fridge": {"door_hinge": pytest.approx(np.pi / 3)},
        "cabinet_left": {"drawer_slide": pytest.approx(0.1)},
    }


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fridge/door_hinge", "not OBJECT/JOINT=VALUE"),
        ("fridge=60deg", "not OBJECT/JOINT=VALUE"),
        ("fridge/door_hinge=30cm", "30cm is not an angle"),
        ("fridge/door_hinge=300deg", "outside its limits"),
        ("fridge/door_hinge=1e999", "must be finite"),
        ("fridge/dor_hinge=1", "did you mean door_hinge"),
        ("frige/door_hinge=1", "did you mean fridge"),
    ],
)
def test_an_invalid_joint_value_is_refused_in_one_line(
    text: str, words: str, kitchen: Scene
) -> None:
    with pytest.raises(MomaposError, match=words):
        set_joints(kitchen, [text])
    for command in (["scene", "show", "kitchen_small"], ["rank", "kitchen_small", "fridge"]):
        error_of(*command, "--joint", text)


def test_a_scene_is_shown_with_its_doors_open() -> None:
    words = ["--joint", "fridge/door_hinge=60deg", "--joint", "cabinet_left/drawer_slide=10cm"]
    objects = {
        item["name"]: item
        for item in json_of("scene", "show", "kitchen_small", *words, "--json")["objects"]
    }
    at = {joint["name"]: joint["value"] for joint in objects["fridge"]["joints"]}
    assert at["door_hinge"] == pytest.approx(np.pi / 3)


def test_a_plan_to_close_a_door_that_was_set_open_is_verified_and_round_trips(
    tmp_path: Path, segway: Robot
) -> None:
    ajar = set_joints(cabinet_room(tmp_path), ["cabinet/hinge=60deg"])
    task = make_task(ajar, "close", "cabinet")
    plan = plan_base_placement(ajar, segway, task, Everywhere(), config=CONFIG).plan
    assert plan.status == "solved"
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    again = read_plan(path)
    assert again.scene_joints == {"cabinet": {"hinge": pytest.approx(np.pi / 3)}}
    assert plan_to_dict(again) == plan_to_dict(plan)
    assert verify_files(path).valid
    # Without the set joint, the door is not where the plan grasps it.
    data = json.loads(path.read_text())
    del data["scene_joints"]
    path.write_text(json.dumps(data))
    assert not verify_files(path).valid
