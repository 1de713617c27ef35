"""The examples of own parts run as they are documented, and have an effect."""

from __future__ import annotations

import json
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import momapos
from momapos.apps.synthetic_scans.recording import synthetic_scan
from momapos.core.errors import InputError
from momapos.model.kinematics.ik import solve_ik
from momapos.model.records.scans import ImageDetection, Scan
from momapos.model.scene.scene_files import load_scene
from momapos.perception.pipeline import default_tools
from momapos.planning.placement.config import PlaceConfig

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "own_parts.md"
MAX_LINES = 10
"""Largest number of lines of an example, without blank ones [-]."""
BLOCKS = re.findall(r"## (\w+).*?```python\n(.*?)```", PAGE.read_text(), re.S)


def run(name: str, **given: Any) -> dict[str, Any]:
    """Run an example; return its names."""
    code = next(code for title, code in BLOCKS if title == name)
    names: dict[str, Any] = {"momapos": momapos, "np": np, **given}
    exec(compile(code, f"{PAGE} {name}", "exec"), names)
    return names


def test_examples_are_short() -> None:
    assert [title for title, _ in BLOCKS] == [
        "Cost", "Filter", "Reachability", "Detector", "Grasps", "Inverse"
    ]  # fmt: skip
    for _, code in BLOCKS:
        assert len([line for line in code.splitlines() if line.strip()]) <= MAX_LINES


def test_a_cost_of_ones_own_counts() -> None:
    names = run("Cost")
    plan, cost = names["result"].plan, names["far_from_the_window"]
    base = np.array([plan.base_pose])
    assert plan.cost["own"].value == pytest.approx(float(cost(base)[0]))
    plain = momapos.plan_base_placement(names["scene"], names["robot"], names["task"]).plan
    assert "own" not in plain.cost
    x, y, _ = plain.base_pose

    def away(poses: np.ndarray) -> np.ndarray:
        return 50.0 * np.exp(-10.0 * np.hypot(poses[:, 0] - x, poses[:, 1] - y))

    other = momapos.plan_base_placement(
        names["scene"], names["robot"], names["task"], pose_cost=away
    ).plan
    assert other.status == "solved"
    assert away(np.array([other.base_pose]))[0] < away(np.array([plain.base_pose]))[0]


@pytest.mark.parametrize(
    ("cost", "words"),
    [
        (lambda poses: poses, "numbers, one per base pose"),
        (lambda poses: [True] * len(poses), "numbers, one per base pose"),
        (lambda poses: -np.ones(len(poses)), "at least 0; keep_poses excludes"),
        (lambda poses: np.full(len(poses), np.inf), "at least 0; keep_poses excludes"),
    ],
)
def test_a_wrong_cost_is_refused_by_its_name(cost: Any, words: str) -> None:
    scene, robot = momapos.load_scene("kitchen_small"), momapos.load_robot("segway_ur5e")
    task = momapos.make_task(scene, "open", "fridge", "door_hinge")
    with pytest.raises(InputError, match=words):
        momapos.plan_base_placement(scene, robot, task, pose_cost=cost)
    other = momapos.PipelineConfig(place=momapos.PlaceConfig(method="habitat"))
    with pytest.raises(InputError, match="pose_cost needs the method ours"):
        momapos.plan_by_method(scene, robot, task, pose_cost=lambda p: p[:, 0], config=other)


def test_a_filter_of_ones_own_keeps_poses() -> None:
    names = run("Filter")
    plan = names["result"].plan
    assert plan.status == "solved"
    assert names["facing_north"](np.array([plan.base_pose])).all()


def test_a_map_of_ones_own_is_used() -> None:
    names = run("Reachability")
    plan = names["result"].plan
    assert plan.status == "solved"
    assert plan.base_pose is not None
    scores = names["WithinArmLength"]().min_score(
        np.array([plan.base_pose]), plan.motion.Ts_world_tool[None]
    )
    assert scores[0, 0] > 0.0


def test_a_detector_of_ones_own_labels_what_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    box = {"name": "it", "box": [0.6, 0.6, 1.6], "pose": {"xyz": [0.0, 0.6, 0.8]}}
    room = {"format": "momapos-scene", "version": 1, "walls": "floor", "objects": [box]}
    room["floor"] = [[-1.2, -1.2], [1.2, -1.2], [1.2, 1.2], [-1.2, 1.2]]
    (tmp_path / "truth.json").write_text(json.dumps(room))
    images = synthetic_scan(load_scene(tmp_path / "truth.json"), frames=8)
    scan = Scan("kitchen", tuple(images.frames()))
    names = run(
        "Detector", scan=scan, replace=replace, default_tools=default_tools,
        ImageDetection=ImageDetection,
    )  # fmt: skip
    labels = {d.detection.label for d in names["made"].decisions}
    assert "fridge" in labels


def test_inverse_kinematics_of_ones_own_finds_the_states() -> None:
    names = run("Inverse")
    plan, plain = names["result"].plan, names["plain"]
    assert plan.status == "solved"
    elbow = plain.moved_joints.index("elbow_joint")
    assert (plan.motion.q[:, elbow] >= 0.0).all()
    usual = momapos.plan_base_placement(names["scene"], plain, names["task"]).plan
    assert usual.status == "solved"


def test_grasps_of_ones_own_are_all_used() -> None:
    names = run("Grasps")
    assert names["result"].plan.status == "solved"
    assert not any("can be used" in note for note in names["result"].notes)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda states: states[0], r"of shape \(\d+, b, 6\)"),
        (lambda states: states + 0.1, "misses its pose by"),
        (list, "list"),
    ],
)
def test_wrong_inverse_kinematics_is_refused(wrong: Any, words: str) -> None:
    scene, robot = momapos.load_scene("kitchen_small"), momapos.load_robot("segway_ur5e")
    task = momapos.make_task(scene, "open", "fridge", "door_hinge")

    def solve(Ts: np.ndarray) -> Any:
        return wrong(solve_ik(robot.chain, robot.ik, Ts)[0])

    with pytest.raises(InputError, match=words):
        momapos.plan_base_placement(scene, robot.with_inverse_kinematics(solve), task)


def test_states_without_a_solution_or_beyond_limits_are_left_out() -> None:
    scene, robot = momapos.load_scene("kitchen_small"), momapos.load_robot("segway_ur5e")
    task = momapos.make_task(scene, "open", "fridge", "door_hinge")
    nothing = robot.with_inverse_kinematics(lambda Ts: np.full((len(Ts), 0, 6), np.nan))
    config = momapos.PipelineConfig(place=PlaceConfig(rounds=1, grid=False), base="fixed")
    answer = momapos.plan_base_placement(
        scene, nothing, task, config=config, clock=time.process_time
    )
    assert answer.plan.status == "infeasible"  # the time limit does not end it on a loaded machine
    assert momapos.plan_base_placement(scene, robot, task).plan.status == "solved"
