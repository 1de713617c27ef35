"""Plans round-trip and name all files that verify and run need."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import Everywhere, cabinet_room

from momapos.apps.cli.loading import _robot
from momapos.core.errors import FileFormatError, RobotError
from momapos.model.plan_files.plan_format import plan_to_dict, read_plan, write_plan
from momapos.model.records.plans import PlacementPlan
from momapos.model.robots.robot import Robot, load_robot
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.verification.plan_check import verify_files

CONFIG = PipelineConfig(place=PlaceConfig(count=256, polish=1), timeout=300.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, segway: Robot) -> Path:
    """Return a folder with a scene, and a robot file in another folder than its URDF."""
    folder = tmp_path_factory.mktemp("own")
    urdf = segway.model.urdf.path
    pairs = "".join(
        f'<disable_collisions link1="{a}" link2="{b}" reason="Always"/>'
        for a, b in map(sorted, segway.disabled)
    )
    (folder / "mine.srdf").write_text(f'<robot name="mine">{pairs}</robot>')
    text = segway.path.read_text().replace(f'urdf = "{urdf.name}"', f'urdf = "{urdf}"')
    text = text.replace("base_link =", 'srdf = "mine.srdf"\nbase_link =', 1)
    (folder / "mine.toml").write_text(text)
    return folder


@pytest.fixture(scope="module")
def plan(folder: Path) -> PlacementPlan:
    room, robot = cabinet_room(folder), load_robot(folder / "mine.toml")
    task = make_task(room, "open", "cabinet")
    start = np.array([0.2, -2.4, 1.5])
    found = plan_base_placement(room, robot, task, Everywhere(), start=start, config=CONFIG)
    assert found.plan.status == "solved"
    return found.plan


def test_a_plan_with_all_members_round_trips(plan: PlacementPlan, folder: Path) -> None:
    write_plan(plan, folder / "plan.json")
    again = read_plan(folder / "plan.json")
    assert plan_to_dict(again) == plan_to_dict(plan)
    assert again.start == (0.2, -2.4, 1.5)
    assert again.robot_file == str(folder / "mine.toml")
    assert again.robot_srdf == str((folder / "mine.srdf").resolve())
    data = json.loads((folder / "plan.json").read_text())
    assert data["version"] == 1
    assert data["robot"]["file"] == "mine.toml"
    assert data["robot"]["srdf"] == "mine.srdf"


def test_the_check_uses_the_rest_values_of_the_robots_other_joints(
    plan: PlacementPlan, folder: Path
) -> None:
    path = folder / "rest.json"
    held = {"left_finger_joint": 0.042}
    write_plan(replace(plan, robot_rest=held), path)
    again = read_plan(path)
    assert plan_to_dict(again) == plan_to_dict(replace(plan, robot_rest=held))
    write_plan(plan, folder / "plan.json")
    assert verify_files(path).gripper_depth != verify_files(folder / "plan.json").gripper_depth


def test_a_plan_names_the_robot_file_that_run_needs(plan: PlacementPlan, folder: Path) -> None:
    path = folder / "plan.json"
    write_plan(plan, path)
    content = read_plan(path)
    robot = _robot(content, path, Path(content.robot_urdf), None)
    assert robot.path == folder / "mine.toml"
    gone = replace(content, robot_file=str(folder / "gone.toml"))
    with pytest.raises(RobotError, match=r"gone\.toml.*give --robot"):
        _robot(gone, path, Path(content.robot_urdf), None)


def test_verify_finds_the_srdf_that_the_plan_names(plan: PlacementPlan, folder: Path) -> None:
    path = folder / "plan.json"
    write_plan(plan, path)
    report = verify_files(path)
    assert report.valid
    assert "start and base path collision, arm at home" in [check.name for check in report.checks]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("start", [1, 2, 3], "start"),
        ("base_path", [[0, 0]], "base_path has rows of 2 numbers; need 3, x, y, yaw"),
        ("base_path", [[0, 0, 0], [0]], "base_path"),
        ("scene_joints", {"cabinet": 1}, "scene_joints"),
        ("scene_hypotheses", {"cabinet": {"hinge": 0.5}}, "scene_hypotheses"),
        ("feasible_to", "45deg", "feasible_to"),
        ("feasible_from", [1.0, 2.0, 3.0], "feasible_from"),
    ],
)
def test_a_malformed_member_is_rejected(
    plan: PlacementPlan, folder: Path, key: str, value: object, words: str
) -> None:
    path = folder / "wrong.json"
    write_plan(plan, path)
    data = json.loads(path.read_text())
    data[key] = value
    path.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match=words) as caught:
        read_plan(path)
    assert "\n" not in str(caught.value)


def test_an_old_plan_without_these_members_is_read(plan: PlacementPlan, folder: Path) -> None:
    path = folder / "old.json"
    write_plan(plan, path)
    data = json.loads(path.read_text())
    new = "start", "base_path", "scene_joints", "scene_hypotheses", "feasible_to", "feasible_from"
    for key in new:
        del data[key]
    del data["task"]["farthest"]
    del data["robot"]["file"]
    path.write_text(json.dumps(data))
    old = read_plan(path)
    assert (old.start, old.base_path, old.robot_file, old.feasible_to) == (None, None, None, None)
    assert old.feasible_from is None
    assert not old.task.farthest
    assert verify_files(path).valid
