"""Laws of exported plans whose base moves: base and arm on one clock, or one after the other."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests import optional
from tests.simulation.toy import Toy, toy
from tests.verification.door_case import Case
from tests.verification.moving_case import chain, moving_case, stops_case

from momapos.apps.export.mcap_recording import write_recording
from momapos.apps.export.ros2 import messages, write_ros2
from momapos.apps.export.timeline import Phase, phases_of, plan_timeline, write_csv
from momapos.apps.web.playback import Story
from momapos.core.geometry.transforms import pose_planar
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.records.plans import PlacementPlan

CASES: dict[str, tuple[Callable[[], Case], list[str]]] = {
    "moving": (moving_case, ["arm", "close_gripper", "drive_and_arm", "open_gripper"]),
    "lead-in": (
        lambda: moving_case(lead_in=8),
        ["arm", "drive_and_arm", "close_gripper", "drive_and_arm", "open_gripper"],
    ),
    "stops": (
        stops_case,
        ["arm", "close_gripper", "arm", "open_gripper", "arm", "drive", "arm", "close_gripper",
         "arm", "open_gripper"],
    ),
}  # fmt: skip


def made(folder: Path, name: str) -> tuple[Toy, PlacementPlan, tuple[Phase, ...]]:
    ready = toy(folder, CASES[name][0]())
    plan = read_plan(folder / "plan.json")
    return ready, plan, phases_of(plan, ready.robot)


@pytest.mark.parametrize("name", CASES)
def test_phases_name_the_drive_and_begin_where_the_last_one_ends(name: str, tmp_path: Path) -> None:
    ready, plan, phases = made(tmp_path, name)
    assert [phase.kind.value for phase in phases] == CASES[name][1]
    for before, after in pairwise(phases):
        for key in ("base", "positions", "object_q"):
            np.testing.assert_allclose(
                getattr(before, key)[-1], getattr(after, key)[0], atol=1e-6, err_msg=key
            )
    np.testing.assert_allclose(phases[0].base[0], plan.base_pose, atol=1e-9)
    np.testing.assert_allclose(phases[-1].base[-1], plan.motion.base[-1], atol=1e-6)
    for phase in phases:
        moved = np.diff(phase.base, axis=0) / np.diff(phase.times)[:, None]
        assert np.hypot(*moved[:, :2].T).max(initial=0.0) <= ready.robot.max_speed + 1e-3
        if phase.kind.value not in ("drive", "drive_and_arm"):
            assert not moved.any()


@pytest.mark.parametrize("name", CASES)
def test_the_hand_follows_the_handle_by_base_and_arm(name: str, tmp_path: Path) -> None:
    _, plan, phases = made(tmp_path, name)
    points = plan.motion.Ts_world_tool[:, :3, 3]
    for phase in phases:
        hand = (pose_planar(phase.base) @ chain().tool_poses(phase.positions))[:, :3, 3]
        if phase.object_q[0] != phase.object_q[-1]:
            away = np.linalg.norm(hand[:, None] - points, axis=2).min(1)
            assert away.max() < 0.01  # half the distance between two states


def test_ros2_has_one_goal_for_base_and_arm_with_one_clock(tmp_path: Path) -> None:
    ready, plan, phases = made(tmp_path, "moving")
    write_ros2(plan, phases, ready.robot, "map", tmp_path / "ros.json")
    content = json.loads((tmp_path / "ros.json").read_text())
    assert content["version"] == 2  # older readers know version 1 only
    (step,) = [s for s in content["steps"] if s["action"].endswith("ExecuteTrajectory")]
    arm, base = (
        step["goal"]["trajectory"][key]
        for key in ("joint_trajectory", "multi_dof_joint_trajectory")
    )
    assert [p["time_from_start"] for p in arm["points"]] == [
        p["time_from_start"] for p in base["points"]
    ]
    assert base["joint_names"] == ["base"]
    assert base["header"]["frame_id"] == "map"
    twists = [point["velocities"][0] for point in base["points"]]
    ahead, left = (np.array([twist["linear"][key] for twist in twists]) for key in "xy")
    assert ahead[0] == ahead[-1] == 0.0
    assert ahead.min() < -0.02  # it drives backwards
    assert np.abs(left).max() < 0.05 * np.abs(ahead).max()  # and not sideways
    times = np.array(
        [t["sec"] + 1e-9 * t["nanosec"] for t in (p["time_from_start"] for p in base["points"])]
    )
    turned = np.trapezoid([twist["angular"]["z"] for twist in twists], times)
    assert turned == pytest.approx(np.ptp(plan.motion.base[:, 2]), abs=1e-3)


def test_ros2_has_a_drive_for_the_second_stop(tmp_path: Path) -> None:
    ready, plan, phases = made(tmp_path, "stops")
    steps = messages(plan, phases, ready.robot, "map")["steps"]
    (drive,) = [step for step in steps if step["action"].endswith("NavigateToPose")]
    position = drive["goal"]["pose"]["pose"]["position"]
    assert (position["x"], position["y"]) == pytest.approx(plan.final_base_pose[:2])
    assert len(drive["path"]["poses"]) == 15
    assert not [step for step in steps if step["action"].endswith("ExecuteTrajectory")]


def test_tables_and_bags_have_the_moving_base(tmp_path: Path) -> None:
    ready, plan, phases = made(tmp_path, "moving")
    timeline = plan_timeline(plan, phases, ready.scene, ready.robot)
    write_csv(timeline, tmp_path / "a.csv")
    with (tmp_path / "a.csv").open() as file:
        rows = list(csv.DictReader(file))
    last = [float(rows[-1][key]) for key in ("base_x", "base_y", "base_yaw")]
    assert last == pytest.approx(plan.final_base_pose, abs=1e-6)
    assert "2_drive_and_arm" in {row["phase"] for row in rows}
    np.testing.assert_allclose(timeline.base_path[-1], plan.final_base_pose, atol=1e-9)
    optional.module("rosbags")
    write_recording(timeline, ready.scene, ready.robot, "map", tmp_path / "bag")
    assert (tmp_path / "bag").is_dir()


def test_the_page_plays_the_base_with_the_arm(tmp_path: Path) -> None:
    ready, plan, _ = made(tmp_path, "moving")
    story = Story.of(plan, ready.robot, ready.scene)
    moments = [story.at(t) for t in np.linspace(0.0, story.duration, 50)]
    assert "drive and move the arm" in {moment.phase for moment in moments}
    np.testing.assert_allclose(moments[0].base, plan.base_pose, atol=1e-6)
    np.testing.assert_allclose(moments[-1].base, plan.final_base_pose, atol=1e-6)


def test_a_plan_at_one_base_pose_is_exported_as_before(tmp_path: Path) -> None:
    ready, plan, _ = made(tmp_path, "moving")
    still = replace(plan, motion=replace(plan.motion, base=None))
    content = messages(still, phases_of(still, ready.robot), ready.robot, "map")
    assert content["version"] == 1
