"""Laws of exported runs and tours: a run as recorded, a tour plan by plan."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.commands import error_of, output_of
from tests.rooms import Everywhere

from momapos.apps.cli.main import main
from momapos.apps.export.timeline import phases_of, plan_timeline, run_timeline
from momapos.core.geometry.transforms import invert, pose_planar
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.plan_files.tour_format import write_tour
from momapos.model.records.plans import PlacementPlan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.simulation.run_record import RunMotion, RunRecord, Visit, with_files, write_run

CONFIG = PipelineConfig(place=PlaceConfig(count=256, polish=1), timeout=300.0)
TIMES = (0.0, 0.1, 0.2, 0.2, 0.3, 0.4)
STAGES = ("drive", "drive", "drive", "approach", "approach", "manipulate")
DOOR = (0.0, 0.0, 0.0, 0.0, 0.1, 0.3)


@pytest.fixture(scope="module")
def plans(kitchen: Scene, segway: Robot) -> dict[str, PlacementPlan]:
    tasks = {
        "open": make_task(kitchen, "open", "fridge", "door_hinge"),
        "pick": make_task(kitchen, "pick", "cup"),
    }
    return {
        verb: plan_base_placement(kitchen, segway, task, Everywhere(), config=CONFIG).plan
        for verb, task in tasks.items()
    }


@pytest.fixture
def run_file(plans: dict[str, PlacementPlan], tmp_path: Path) -> Path:
    """Write the record of a run that opens the fridge, and its plan."""
    plan, path = plans["open"], tmp_path / "run.json"
    write_plan(plan, tmp_path / "plan.json")
    joints = {name: tuple(0.1 * k for k in range(6)) for name in plan.joints}
    bases = tuple((0.1 * k, 0.0, 0.0) for k in (0, 1, 2, 2, 2, 2))
    motion = RunMotion(TIMES, STAGES, bases, joints, DOOR, forces=((0.0, 0.0, 0.0),) * 6)
    stand = bases[-1]
    visit = Visit(stand, stand, 0.2, 0.2, "")
    record = RunRecord("kitchen_small", "segway_ur5e", plan.task, (visit,), None, motion=motion)
    write_run(with_files(record, path, tmp_path / "plan.json"), path)
    return path


def decoded(folder: Path) -> dict[str, list[Any]]:
    """Return the messages of a bag by topic, from an independent reader."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    found: dict[str, list[Any]] = {}
    with next(folder.glob("*.mcap")).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(message)
    return found


def test_a_table_of_a_run_has_each_time_of_its_record_once(
    run_file: Path, plans: dict[str, PlacementPlan], tmp_path: Path
) -> None:
    out = tmp_path / "run.csv"
    assert main(["export", str(run_file), "--to", "csv", "--out", str(out)]) == 0
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    kept = [0, 1, 3, 4, 5]  # of samples at one time, the last
    assert [float(row["time"]) for row in rows] == [TIMES[k] for k in kept]
    assert [row["phase"].partition("_")[2] for row in rows] == [STAGES[k] for k in kept]
    assert [float(row["object_q"]) for row in rows] == [DOOR[k] for k in kept]
    for name in plans["open"].joints:
        values = [float(row[name]) for row in rows]
        assert values == pytest.approx([0.1 * k for k in kept])
        # From 0.3 s to 0.4 s it moves by 0.1.
        assert float(rows[-1][f"{name}_velocity"]) == pytest.approx(1.0)


@pytest.mark.parametrize("to", ["csv", "mcap", "npz"])
def test_a_run_beyond_the_limits_of_a_joint_is_refused(
    run_file: Path, to: str, tmp_path: Path
) -> None:
    data = json.loads(run_file.read_text())
    name = next(iter(data["motion"]["joints"]))
    data["motion"]["joints"][name][2] = 9.5
    run_file.write_text(json.dumps(data))
    out = tmp_path / "out"
    assert f"moves {name!r} to 9.5; its limits are" in error_of(
        "export", str(run_file), "--to", to, "--out", str(out)
    )
    assert not out.exists()


def test_a_recording_of_a_run_has_the_motion_of_base_arm_and_door(
    run_file: Path, tmp_path: Path
) -> None:
    assert main(["export", str(run_file), "--to", "mcap", "--out", str(tmp_path / "bag")]) == 0
    found = decoded(tmp_path / "bag")
    assert [pose.pose.position.x for pose in found["/base_path"][0].poses] == [0.0, 0.1]
    assert found["/base_pose"][-1].pose.position.x == pytest.approx(0.2)
    assert np.allclose(found["/joint_states"][-1].position, 0.5)
    assert [len(m.joint_trajectory.points) for m in found["/trajectory"]] == [2, 1]
    frames = {t.child_frame_id: t for message in found["/tf"] for t in message.transforms}
    turn = frames["fridge/door"].transform.rotation
    assert 2 * np.arctan2(abs(turn.z), abs(turn.w)) == pytest.approx(DOOR[-1], abs=1e-6)


def test_a_picked_object_moves_with_the_hand_after_it_closes(
    plans: dict[str, PlacementPlan], kitchen: Scene, segway: Robot
) -> None:
    plan = plans["pick"]
    timeline = plan_timeline(plan, phases_of(plan, segway), kitchen, segway)
    poses, samples = timeline.Ts_world_object, timeline.samples
    closes = timeline.stages.index("close_gripper")
    item = kitchen.object("cup")
    rest = item.link_poses()[item.model.urdf.root]
    assert np.allclose(poses[samples.phase < closes], rest)
    tools = pose_planar(samples.base) @ segway.chain.tool_poses(
        segway.chain.freedom_values(samples.positions)
    )
    held = invert(tools[samples.phase >= closes]) @ poses[samples.phase >= closes]
    assert np.allclose(held, held[0], atol=1e-9)
    lifted = plan.motion.Ts_world_tool[-1] @ invert(plan.motion.Ts_world_tool[0]) @ rest
    assert np.allclose(poses[-1], lifted, atol=1e-6)


def test_a_recording_of_a_pick_has_a_frame_for_the_object(
    plans: dict[str, PlacementPlan], tmp_path: Path
) -> None:
    write_plan(plans["pick"], tmp_path / "pick.json")
    words = ["export", str(tmp_path / "pick.json"), "--to", "mcap", "--out", str(tmp_path / "bag")]
    assert main(words) == 0
    found = decoded(tmp_path / "bag")
    links = {m.header.frame_id for m in found["/scene"][0].markers if m.ns == "cup"}
    assert links
    assert all(link.startswith("cup/") for link in links)
    heights = [
        t.transform.translation.z
        for message in found["/tf"]
        for t in message.transforms
        if t.child_frame_id in links
    ]
    assert heights[-1] > heights[0] + 0.02


def test_a_movable_object_of_a_run_has_its_recorded_poses(
    plans: dict[str, PlacementPlan], segway: Robot
) -> None:
    poses = tuple((0.1 * k, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0) for k in range(6))
    base = (0.0, 0.0, 0.0)
    motion = RunMotion(
        TIMES, STAGES, (base,) * 6, dict.fromkeys(plans["pick"].joints, (0.0,) * 6),
        poses=poses,
    )  # fmt: skip
    record = RunRecord("kitchen_small", segway.name, plans["pick"].task, (), None, motion=motion)
    found = run_timeline(record, segway).Ts_world_object
    assert np.allclose(found[:, 0, 3], [0.0, 0.1, 0.3, 0.4, 0.5])
    assert np.allclose(found[:, :3, :3], np.diag([-1.0, -1.0, 1.0]))


@pytest.mark.parametrize("to", ["ros2", "moveit"])
def test_a_run_has_no_goals_and_the_message_names_its_plan(
    to: str, run_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(tmp_path.iterdir())
    assert main(["export", str(run_file), "--to", to, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip()
    assert str(tmp_path / "plan.json") in error
    assert "\n" not in error
    assert sorted(tmp_path.iterdir()) == before


def test_a_tour_is_exported_plan_by_plan_or_not_at_all(
    plans: dict[str, PlacementPlan], tmp_path: Path
) -> None:
    tour, out = tmp_path / "tour.json", tmp_path / "out.csv"
    write_tour(tour, [plans["open"], plans["pick"]], [1, 2], [])
    assert output_of("export", str(tour), "--to", "csv", "--out", str(out)).split() == [
        str(tmp_path / f"out_{k}.csv") for k in (1, 2)
    ]
    for k, plan in enumerate(plans.values(), start=1):
        alone = tmp_path / f"alone_{k}.csv"
        write_plan(plan, tmp_path / "alone.json")
        words = ["export", str(tmp_path / "alone.json"), "--to", "csv", "--out", str(alone)]
        assert main(words) == 0
        assert (tmp_path / f"out_{k}.csv").read_bytes() == alone.read_bytes()
    (tmp_path / "tour_2.json").unlink()
    assert main(["export", str(tour), "--to", "npz", "--out", str(tmp_path / "gone.npz")]) == 2
    assert not list(tmp_path.glob("gone*"))
