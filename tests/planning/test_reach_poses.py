"""Laws of reaching tool poses: each is met, from few stops, and each refusal has its reason."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests import optional
from tests.commands import error_of, json_of, output_of
from tests.real import CASES, check_independently

from momapos.core.errors import InputError, OutOfTimeError, RobotError, UnknownNameError
from momapos.core.geometry.transforms import pose_wxyz
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.plans import BaseRegion, Task
from momapos.model.records.poses import ToolPose
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.pose_files import load_poses
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.trajectory import with_times
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.pose_targets import tool_poses_of
from momapos.planning.keyword_forms import plan_reach
from momapos.planning.tour import Tour
from momapos.verification.plan_check import verify_files, verify_tour

SQUARE = np.array([[-4, -3], [4, -3], [4, 3], [-4, 3]], float)
EAST = (1.0, 0.0, 0.0, 0.0)
NORTH = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
"""Rotations of a tool that approaches along x: to the east, and to the north."""


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("fetch")


@pytest.fixture(scope="module")
def hall() -> Scene:
    """Return a hall with a wall of boxes along its north, and a column."""
    wall = SceneObject.box("wall", (8.0, 0.4, 1.8), (0.0, 2.5, 0.9))
    column = SceneObject.box("column", (0.3, 0.3, 2.0), (0.6, 0.2, 1.0))
    start = np.array([-2.0, -1.5, 0.0])
    return Scene("hall", (wall, column), floor_polygon=SQUARE, start=start)


def along_wall(*xs: float, y: float = 2.15, z: float = 1.0) -> list[ToolPose]:
    return [ToolPose((x, y, z), NORTH, f"at {x:g}") for x in xs]


def met(tour: Tour) -> list[str]:
    """Return the names of the poses at which the tool is in the plans, by the kinematics."""
    names = []
    for step in tour.steps:
        motion, robot = step.plan.motion, step.prepared.robot
        if motion is None or step.plan.base_pose is None:
            continue
        base = step.plan.base_pose
        T = pose_wxyz((*base[:2], 0.0), (np.cos(base[2] / 2), 0.0, 0.0, np.sin(base[2] / 2)))
        for one, hold in zip(step.plan.task.poses, motion.holds, strict=True):
            q = robot.chain.freedom_values(motion.q[[hold.first]])
            assert (one.excess(T @ robot.chain.tool_poses(q)) <= 0.0).all()
            names.append(one.name)
    return names


def verified(tour: Tour, scene: Scene, folder: Path) -> bool:
    scene = save_scene(scene, folder / "scene.json")
    for k, step in enumerate(tour.steps):
        write_plan(replace(step.plan, scene=str(scene.path)), folder / f"{k}.json")
        check_independently(folder / f"{k}.json")
        if not verify_files(folder / f"{k}.json").valid:
            return False
    return True


def test_near_poses_are_met_from_one_base_pose(hall: Scene, robot: Robot, tmp_path: Path) -> None:
    poses = along_wall(-2.2, -2.0, -1.8, -1.6)
    tour = plan_reach(hall, robot, poses)
    assert (tour.status, tour.stops) == ("solved", (1,))
    assert sorted(met(tour)) == sorted(one.name for one in poses)
    assert verified(tour, hall, tmp_path)


def test_poses_at_both_ends_of_a_wall_need_two_stops_and_the_near_ones_come_first(
    hall: Scene, robot: Robot, tmp_path: Path
) -> None:
    tour = plan_reach(hall, robot, along_wall(3.0, -2.5, 2.8, -2.7))
    assert (tour.status, tour.stops) == ("solved", (1, 2))
    assert [sorted(one.name for one in step.plan.task.poses) for step in tour.steps] == [
        ["at -2.5", "at -2.7"], ["at 2.8", "at 3"],
    ]  # fmt: skip
    assert tour.steps[1].plan.start == tour.steps[0].plan.base_pose
    assert verified(tour, hall, tmp_path)


def test_in_order_keeps_the_order_and_needs_more_stops(hall: Scene, robot: Robot) -> None:
    poses = along_wall(-2.5, 2.8, -2.7)
    tour = plan_reach(hall, robot, poses, in_order=True)
    assert met(tour) == [one.name for one in poses]
    assert tour.stops == (1, 2, 3)
    near = along_wall(-2.0, -2.3, -1.9)
    assert met(plan_reach(hall, robot, near, in_order=True)) == [one.name for one in near]


def test_a_pose_inside_an_object_is_refused_with_its_name_and_the_others_are_met(
    hall: Scene, robot: Robot
) -> None:
    tour = plan_reach(hall, robot, [*along_wall(-2.0), ToolPose((0.0, 2.5, 1.0), NORTH, "inside")])
    assert tour.status == "infeasible"
    assert met(tour) == ["at -2"]
    last = tour.steps[-1].plan
    assert last.task.pose_names == ("inside",)
    assert "inside: the hand hits wall/box" in last.candidates.rejections


def test_a_pose_above_all_arms_is_out_of_reach_at_any_distance(hall: Scene, robot: Robot) -> None:
    tour = plan_reach(hall, robot, [ToolPose((0.0, 0.0, 3.0), EAST, "high")])
    assert tour.steps[0].plan.motion is None
    assert any("at any distance" in words for words in tour.steps[0].plan.candidates.rejections)


def test_a_pose_that_touches_an_object_is_met_only_if_that_is_meant(
    hall: Scene, robot: Robot, tmp_path: Path
) -> None:
    tip = 0.031  # of the fingers of a Fetch, from its tool
    at = {"y": 2.3 - tip + 0.002}
    touching = along_wall(-2.0, **at)[0]
    meant = plan_reach(hall, robot, [replace(touching, contact="wall")])
    assert meant.status == "solved"
    assert verified(meant, hall, tmp_path)
    assert plan_reach(hall, robot, [touching]).status == "infeasible"


def test_a_free_turn_is_used_where_the_pose_itself_is_out_of_reach(
    hall: Scene, robot: Robot
) -> None:
    # The wrist may not bend so far that the hand is upside down this high.
    turned = replace(along_wall(-2.0, z=1.55)[0], wxyz=(0.0, 0.5**0.5, 0.5**0.5, 0.0))
    free = replace(turned, axis=(1.0, 0.0, 0.0), spin=np.pi)
    assert plan_reach(hall, robot, [free]).status == "solved"
    assert (free.excess(tool_poses_of(free)) <= 0.0).all()


def test_all_tool_poses_of_a_tolerance_are_within_it() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = rng.normal(size=4)
        axis = rng.normal(size=3)
        one = ToolPose(
            tuple(rng.uniform(-1, 1, 3)), tuple(q / np.linalg.norm(q)),
            position=tuple(rng.uniform(0, 0.05, 3)), axis=tuple(axis / np.linalg.norm(axis)),
            spin=float(rng.uniform(0, np.pi)), cone=float(rng.uniform(0, 0.6)),
        )  # fmt: skip
        assert (one.excess(tool_poses_of(one)) <= 0.0).all()


def test_the_base_keeps_to_the_region_and_to_the_poses_that_are_kept(
    hall: Scene, robot: Robot
) -> None:
    area = ((-4.0, 0.9), (-1.0, 0.9), (-1.0, 2.2), (-4.0, 2.2))
    tour = plan_reach(hall, robot, along_wall(-2.0), region=BaseRegion(keep_in=(area,)))
    base = tour.steps[0].plan.base_pose
    assert base is not None
    assert base[1] > 0.9
    left = plan_reach(hall, robot, along_wall(-2.0), keep_poses=lambda p: p[:, 0] < -2.3)
    base = left.steps[0].plan.base_pose
    assert base is not None
    assert base[0] < -2.3


def test_the_same_seed_gives_the_same_answer(hall: Scene, robot: Robot) -> None:
    one, other = (plan_reach(hall, robot, along_wall(-2.0, 2.5), seed=3) for _ in range(2))
    assert [step.plan for step in one.steps] == [step.plan for step in other.steps]


def test_a_plan_that_misses_a_pose_is_invalid(hall: Scene, robot: Robot, tmp_path: Path) -> None:
    tour = plan_reach(hall, robot, along_wall(-2.0, -1.8))
    plan = replace(tour.steps[0].plan, scene=str(save_scene(hall, tmp_path / "s.json").path))
    for name, wrong in (
        ("moved", lambda one: {**one, "xyz": [one["xyz"][0] + 0.01, *one["xyz"][1:]]}),
        ("turned", lambda one: {**one, "wxyz": [*one["wxyz"][1:], one["wxyz"][0]]}),
    ):
        path = tmp_path / f"{name}.json"
        write_plan(plan, path)
        data = json.loads(path.read_text())
        data["task"]["poses"][1] = wrong(data["task"]["poses"][1])
        path.write_text(json.dumps(data))
        failed = [check.name for check in verify_files(path).checks if not check.ok]
        assert failed == [
            f"tool beyond the tolerance in {'position' if name == 'moved' else 'rotation'}"
        ]


def test_a_plan_file_names_no_object_and_is_read_again(
    hall: Scene, robot: Robot, tmp_path: Path
) -> None:
    tour = plan_reach(hall, robot, along_wall(-2.0))
    scene = save_scene(hall, tmp_path / "s.json")
    write_plan(replace(tour.steps[0].plan, scene=str(scene.path)), tmp_path / "plan.json")
    assert json.loads((tmp_path / "plan.json").read_text())["task"]["object"] is None
    assert read_plan(tmp_path / "plan.json").task == tour.steps[0].plan.task


def test_mistaken_arguments_are_refused(hall: Scene, robot: Robot) -> None:
    with pytest.raises(InputError, match="poses must be a sequence of ToolPose"):
        plan_reach(hall, robot, [])
    with pytest.raises(UnknownNameError, match="no object 'tabel'"):
        plan_reach(hall, robot, [replace(along_wall(0.0)[0], contact="tabel")])
    with pytest.raises(InputError, match="facing is for one grasp"):
        plan_reach(hall, robot, along_wall(0.0), region=BaseRegion(facing=0.1))
    with pytest.raises(RobotError, match="needs 6"):
        plan_reach(hall, load_robot("hsr"), along_wall(0.0))
    with pytest.raises(OutOfTimeError):
        plan_reach(hall, robot, along_wall(0.0), config=PipelineConfig(timeout=0.001))


def test_a_task_of_reach_is_made_with_poses(hall: Scene) -> None:
    task = Task("reach", "", poses=tuple(along_wall(0.0, 1.0)))
    assert task.target == "2 poses"
    assert not len(hall.object("").model.joints)


def test_the_command_writes_one_plan_for_one_stop_and_a_tour_for_several(tmp_path: Path) -> None:
    scene = tmp_path / "hall.json"
    wall = SceneObject.box("wall", (8.0, 0.4, 1.8), (0.0, 2.5, 0.9))
    start = np.array([-2.0, -1.5, 0.0])
    save_scene(Scene("hall", (wall,), floor_polygon=SQUARE, start=start), scene)

    def command(*xs: float, out: str) -> list[str]:
        rows = "".join(f"{x},2.15,1,0,0,{0.5**0.5},{0.5**0.5}\n" for x in xs)
        (tmp_path / "poses.csv").write_text(f"x,y,z,qx,qy,qz,qw\n{rows}")
        return [
            "place", "reach", str(scene), str(tmp_path / "poses.csv"), "--robot", "fetch",
            "--out", str(tmp_path / out),
        ]  # fmt: skip

    words = output_of(*command(-2.0, -1.9, out="plan.json"))
    assert "fetch: reach 2 poses: solved" in words
    assert verify_files(tmp_path / "plan.json").valid
    answer = json_of(*command(-2.0, 2.8, out="tour.json"), "--json")
    assert answer["stops"] == 2
    assert all(report.valid for report in verify_tour(tmp_path / "tour.json").values())
    assert error_of(*command(0.0, out="x.json"), "--base", "stops").endswith("leave it out")


def test_a_plan_for_poses_is_shown_and_exported_and_its_tool_is_there_in_physics(
    robot: Robot, tmp_path: Path
) -> None:
    floor = np.array([[-2, -2], [2, -2], [2, 2], [-2, 2]], float)
    box = SceneObject.box("box", (0.4, 0.4, 0.6), (1.4, 0.0, 0.3))
    room = Scene("room", (box,), floor_polygon=floor, start=np.array([-0.2, 0.0, 0.0]))
    scene = save_scene(room, tmp_path / "scene.json")
    tour = plan_reach(scene, robot, [ToolPose((1.3, y, 0.9), EAST) for y in (-0.1, 0.1)])
    plan = with_times(tour.steps[0].plan, robot)
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    output_of("view", str(path), "--static", str(tmp_path / "page.html"))
    output_of("export", str(path), "--to", "csv", "--out", str(tmp_path / "table.csv"))
    words = output_of("run", str(path))
    assert "fetch: reach 2 poses: done" in words
    assert "reached" not in words


def test_poses_of_other_people_are_met(robot: Robot, tmp_path: Path) -> None:
    folder = optional.there(CASES / "users/11_pose_list")
    scene = load_scene(folder / "tank.json")
    tour = plan_reach(scene, robot, load_poses(folder / "poses.json", scene))
    assert (tour.status, tour.stops, len(met(tour))) == ("solved", (1,), 6)
    assert verified(tour, scene, tmp_path)
