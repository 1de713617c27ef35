"""Laws of exported plans: every format has the motion of the plan."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float
from tests.commands import error_of
from tests.rooms import Everywhere

from momapos.apps.cli.main import main
from momapos.apps.export.ros2 import write_scene, write_srdf
from momapos.apps.export.timeline import Phase, PhaseKind, phases_of, samples_of
from momapos.core.geometry.transforms import pose_wxyz
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.records.plans import Hold, PlacementPlan
from momapos.model.robots.robot import Robot, read_srdf
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig

CONFIG = PipelineConfig(place=PlaceConfig(count=256, polish=1), timeout=300.0)
TOLERANCE = 1e-6


@pytest.fixture(scope="module")
def plan(kitchen: Scene, segway: Robot) -> PlacementPlan:
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    return plan_base_placement(kitchen, segway, task, Everywhere(), config=CONFIG).plan


@pytest.fixture(scope="module")
def phases(plan: PlacementPlan, segway: Robot) -> tuple[Phase, ...]:
    return phases_of(plan, segway)


@pytest.fixture(scope="module")
def plan_file(plan: PlacementPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "fridge.json"
    write_plan(plan, path)
    return path


def kinds(phases: tuple[Phase, ...]) -> list[str]:
    return [phase.kind.value for phase in phases]


def test_a_phase_begins_where_the_previous_one_ends(phases: tuple[Phase, ...]) -> None:
    for before, after in pairwise(phases):
        for key in ("base", "positions", "object_q"):
            assert np.allclose(getattr(before, key)[-1], getattr(after, key)[0], atol=TOLERANCE), (
                key
            )
    for phase in phases:
        assert not phase.velocities[[0, -1]].any()
        assert (np.diff(phase.times) > 0).all()


def test_a_door_moves_only_while_the_gripper_is_closed(
    plan: PlacementPlan, phases: tuple[Phase, ...]
) -> None:
    assert kinds(phases) == ["drive", "arm", "close_gripper", "arm", "open_gripper"]
    assert np.allclose(phases[0].base[-1], plan.base_pose)
    assert np.ptp(phases[1].object_q) == 0.0
    assert phases[3].object_q[0] == plan.motion.object_q[0]
    assert phases[3].object_q[-1] == pytest.approx(plan.task.to)
    assert np.allclose(phases[-1].positions[-1], plan.motion.q[-1])


def test_joints_and_base_respect_their_speed_limits(
    phases: tuple[Phase, ...], segway: Robot
) -> None:
    speed = np.array([segway.model.joint(name).velocity for name in segway.moved_joints])
    for phase in phases:
        assert (np.abs(phase.velocities) <= speed + TOLERANCE).all()
        moved = np.diff(phase.base, axis=0) / np.diff(phase.times)[:, None]
        assert np.hypot(*moved[:, :2].T).max() <= segway.max_speed + 1e-3
        assert np.abs(moved[:, 2]).max() <= segway.max_yaw_rate + 1e-3


@pytest.mark.parametrize("bend", [0.0, 0.5])
def test_a_drive_across_the_axes_keeps_speed_and_acceleration(
    plan: PlacementPlan, segway: Robot, bend: float
) -> None:
    assert plan.base_pose is not None
    s = np.linspace(0.0, 1.0, 60)[:, None]
    way = np.array([-2.0, -2.0, 0.0]) * (1 - s) + bend * np.sin(np.pi * s) * [1.0, -1.0, 0.0]
    drive = phases_of(replace(plan, base_path=np.array(plan.base_pose) + way), segway)[0]
    speed = np.diff(drive.base[:, :2], axis=0) / np.diff(drive.times)[:, None]
    change = np.diff(speed[:-1], axis=0) / np.diff(drive.times)[0]
    assert (bend or 0.95 * segway.max_speed) < np.hypot(*speed.T).max() + bend
    assert np.hypot(*speed.T).max() <= segway.max_speed + 1e-3
    assert np.hypot(*change.T).max() <= 1.02 * segway.max_acceleration


def test_the_gripper_opens_between_two_grasps(plan: PlacementPlan, segway: Robot) -> None:
    motion = plan.motion
    last = len(motion.q) - 1
    middle = last // 2
    object_q = motion.object_q.copy()
    object_q[middle : middle + 4] = object_q[middle]
    twice = replace(motion, object_q=object_q, holds=(Hold(0, middle), Hold(middle + 3, last)))
    phases = phases_of(replace(plan, motion=twice), segway)
    expected = ["drive", "arm", *(["close_gripper", "arm", "open_gripper", "arm"] * 2)[:-1]]
    assert kinds(phases) == expected
    assert np.ptp(phases[5].object_q) == 0.0


@pytest.mark.parametrize(
    ("verb", "expected"),
    [
        ("pick", ["drive", "arm", "close_gripper", "arm"]),
        ("place", ["drive", "close_gripper", "arm", "open_gripper", "arm"]),
    ],
)
def test_a_picked_object_is_held_before_the_lift_and_a_placed_one_from_the_start(
    verb: Any, expected: list[str], plan: PlacementPlan, segway: Robot
) -> None:
    task = replace(plan.task, verb=verb, joint=None, to=None)
    assert kinds(phases_of(replace(plan, task=task), segway)) == expected


def test_csv_and_npz_have_equal_values(plan_file: Path, tmp_path: Path) -> None:
    table, arrays = tmp_path / "a.csv", tmp_path / "a.npz"
    assert main(["export", str(plan_file), "--to", "csv", "--out", str(table)]) == 0
    assert main(["export", str(plan_file), "--to", "npz", "--out", str(arrays)]) == 0
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    with np.load(arrays) as content:
        assert len(rows) == len(content["times"])
        for k, name in enumerate(content["joints"].tolist()):
            column = np.array([float(row[name]) for row in rows])
            assert np.allclose(column, content["positions"][:, k], atol=1e-7)
        kind = [content["phases"][i] for i in content["phase"]]
        assert [row["phase"].partition("_")[2] for row in rows] == kind


def test_ros_goals_match_the_plan(
    plan: PlacementPlan, plan_file: Path, segway: Robot, tmp_path: Path
) -> None:
    out = tmp_path / "goals.json"
    assert main(["export", str(plan_file), "--to", "ros2", "--out", str(out)]) == 0
    content = json.loads(out.read_text())
    pose = content["base_pose"]["pose"]
    assert content["base_pose"]["header"]["frame_id"] == "map"
    assert (pose["position"]["x"], pose["position"]["y"]) == plan.base_pose[:2]
    turn = 2 * np.arctan2(pose["orientation"]["z"], pose["orientation"]["w"])
    assert np.cos(turn - plan.base_pose[2]) == pytest.approx(1.0)
    actions = [step["action"].rpartition("/")[2] for step in content["steps"]]
    assert actions == [
        "NavigateToPose", "FollowJointTrajectory", "GripperCommand", "FollowJointTrajectory",
        "GripperCommand",
    ]  # fmt: skip
    closing, opening = content["steps"][2], content["steps"][4]
    assert closing["goal"]["command"] == {"position": 0.0, "max_effort": segway.grip_force}
    assert opening["goal"]["command"]["position"] == segway.opening
    trajectory = content["steps"][3]["goal"]["trajectory"]
    assert trajectory["joint_names"] == list(plan.joints)
    assert np.allclose(trajectory["points"][-1]["positions"], plan.motion.q[-1])
    stamps = [point["time_from_start"] for point in trajectory["points"]]
    assert all(0 <= stamp["nanosec"] < 10**9 for stamp in stamps)
    assert (np.diff([s["sec"] + 1e-9 * s["nanosec"] for s in stamps]) > 0).all()


def test_an_independent_reader_finds_the_plan_in_a_recording(
    plan: PlacementPlan, plan_file: Path, phases: tuple[Phase, ...], tmp_path: Path
) -> None:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    out = tmp_path / "bag"
    assert main(["export", str(plan_file), "--to", "mcap", "--out", str(out)]) == 0
    found: dict[str, list[Any]] = {}
    with next(out.glob("*.mcap")).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(message)
    assert set(found) == {
        "/robot_description", "/scene", "/base_path", "/trajectory", "/joint_states", "/base_pose",
        "/tf",
    }  # fmt: skip
    assert list(found["/joint_states"][0].name) == list(plan.joints)
    assert np.allclose(found["/joint_states"][-1].position, plan.motion.q[-1])
    stands = found["/base_pose"][-1].pose.position
    assert np.allclose((stands.x, stands.y), plan.base_pose[:2])
    arms = [phase for phase in phases if phase.kind is PhaseKind.ARM]
    assert len(found["/trajectory"]) == len(arms)
    points = found["/trajectory"][-1].joint_trajectory.points
    assert np.allclose(points[-1].positions, plan.motion.q[-1])
    times = [s.header.stamp.sec + 1e-9 * s.header.stamp.nanosec for s in found["/joint_states"]]
    assert times[-1] == pytest.approx(float(samples_of(phases).times[-1]))
    assert (np.diff(times) > 0).all()


def parsed_scene(text: str) -> dict[str, tuple[Float[np.ndarray, "4 4"], list[str]]]:
    """Return poses and shape kinds of the objects of a `.scene` file, parsed as MoveIt does."""
    lines = iter(text.splitlines()[1:])
    found: dict[str, tuple[Float[np.ndarray, "4 4"], list[str]]] = {}

    def pose() -> Float[np.ndarray, "4 4"]:
        xyz = tuple(map(float, next(lines).split()))
        x, y, z, w = map(float, next(lines).split())
        return pose_wxyz(xyz, (w, x, y, z))

    for line in lines:
        if line == ".":
            return found
        assert line.startswith("* ")
        T, names = pose(), []
        for _ in range(int(next(lines))):
            names.append(next(lines))
            size = next(lines).split()
            if names[-1] == "mesh":
                for _ in range(sum(map(int, size))):
                    assert len(next(lines).split()) == 3
            else:
                assert len(size) == {"box": 3, "cylinder": 2, "sphere": 1}[names[-1]]
            pose()
            assert len(next(lines).split()) == 4
        assert next(lines) == "0"
        found[line[2:]] = T, names
    raise AssertionError("the file does not end")


def test_a_planning_scene_has_every_shape_at_its_pose(kitchen: Scene, tmp_path: Path) -> None:
    write_scene(kitchen, np.eye(4), tmp_path / "a.scene")
    found = parsed_scene((tmp_path / "a.scene").read_text())
    count = 0
    for item in kitchen.objects:
        for link, T in item.link_poses().items():
            shapes = item.model.urdf.links[link].collisions
            name = item.name if item.name in found else f"{item.name}/{link}"
            if shapes:
                count += 1
                assert np.allclose(found[name][0], T, atol=1e-6)
                assert found[name][1] == [shape.kind for shape in shapes]
    assert len(found) == count


def test_a_carried_object_is_attached_at_its_pose_in_the_hand(
    kitchen: Scene, segway: Robot, tmp_path: Path
) -> None:
    for verb in ("pick", "place"):
        plan = plan_base_placement(
            kitchen, segway, make_task(kitchen, verb, "cup"), config=CONFIG
        ).plan
        write_plan(plan, tmp_path / f"{verb}.json")
        room = tmp_path / f"{verb}.scene"
        words = [str(tmp_path / f"{verb}.json"), "--to", "moveit", "--out", str(room)]
        assert main(["export", *words]) == 0
        said = json.loads((tmp_path / f"{verb}_attached.json").read_text())
        assert said["link_name"] == segway.tool_link
        assert said["touch_links"] == list(segway.gripper_links)
        held, cup = said["object"], kitchen.object("cup")
        at, turn = held["pose"]["position"], held["pose"]["orientation"]
        T_tool_object = pose_wxyz(tuple(at[k] for k in "xyz"), tuple(turn[k] for k in "wxyz"))
        T = plan.motion.Ts_world_tool[0] @ T_tool_object
        assert np.allclose(T, cup.T_world_object, atol=TOLERANCE)
        count = sum(len(link.collisions) for link in cup.model.urdf.links.values())
        assert len(held["primitives"]) + len(held["meshes"]) == count > 0
        # An object to place is in the hand, not in the scene.
        assert ("cup" in parsed_scene(room.read_text())) == (verb == "pick")


def test_a_plan_without_a_carried_object_attaches_none(plan_file: Path, tmp_path: Path) -> None:
    room = str(tmp_path / "room.scene")
    assert main(["export", str(plan_file), "--to", "moveit", "--out", room]) == 0
    assert sorted(file.name for file in tmp_path.iterdir()) == ["room.scene", "room.srdf"]


def test_an_srdf_has_the_disabled_pairs_of_the_robot(segway: Robot, tmp_path: Path) -> None:
    write_srdf(segway, tmp_path / "a.srdf")
    assert read_srdf(tmp_path / "a.srdf") == segway.disabled
    text = (tmp_path / "a.srdf").read_text()
    assert f'tip_link="{segway.tool_link}"' in text
    assert all(f'<joint name="{name}"' in text for name in segway.moved_joints)


def test_export_errors_are_one_line(plan: PlacementPlan, plan_file: Path, tmp_path: Path) -> None:
    unsolved = tmp_path / "no.json"
    write_plan(replace(plan, status="infeasible", motion=None, base_pose=None), unsolved)
    assert "nothing to export" in error_of("export", str(unsolved), "--to", "csv")
    assert "no such plan file" in error_of("export", str(tmp_path / "none.json"), "--to", "csv")
    own = ("--to", "ros2", "--out", str(plan_file))
    assert "is the input file" in error_of("export", str(plan_file), *own)
    there = ("--to", "mcap", "--out", str(tmp_path))
    assert "exists already" in error_of("export", str(plan_file), *there)
    assert not list(tmp_path.glob(".momapos-*"))


def test_the_default_output_is_next_to_the_plan(
    plan_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(plan_file.parent)
    before = plan_file.read_bytes()
    assert main(["export", plan_file.name, "--to", "ros2"]) == 0
    assert (plan_file.parent / f"{plan_file.stem}_ros2.json").is_file()
    assert plan_file.read_bytes() == before


def test_a_plan_that_starts_at_the_grasp_can_be_exported(
    plan: PlacementPlan, segway: Robot
) -> None:
    motion = plan.motion
    there = replace(motion, approach=motion.approach[:0])
    phases = phases_of(replace(plan, motion=there, base_path=None), segway)
    assert kinds(phases) == ["close_gripper", "arm", "open_gripper"]
    assert np.allclose(phases[0].positions, motion.q[0])


def test_a_scene_does_not_overwrite_an_srdf(plan_file: Path, tmp_path: Path) -> None:
    out = ("--to", "moveit", "--out", str(tmp_path / "room.srdf"))
    assert "--out names the scene file" in error_of("export", str(plan_file), *out)
    assert not (tmp_path / "room.srdf").exists()
