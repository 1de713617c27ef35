"""Laws of paths of the tool: it keeps to them, at their speed, from few stops."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests import optional
from tests.commands import error_of, output_of
from tests.real import DATA, check_independently

from momapos.core.errors import InputError, UnknownNameError
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.plans import Task
from momapos.model.records.poses import ToolPath, ToolPose
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.pose_files import load_path, load_poses
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.trajectory import with_times
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.surfaces import wipe_path
from momapos.planning.keyword_forms import plan_follow
from momapos.planning.tour import Tour
from momapos.verification.plan_check import verify_files

SQUARE = np.array([[-4, -3], [4, -3], [4, 3], [-4, 3]], float)
NORTH = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
"""Rotation of a tool that approaches along x, to the north."""
TABLE = SceneObject.box("table", (1.2, 0.5, 0.7), (0.0, 2.0, 0.35))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("fetch")


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Return a hall with a wall of boxes along its north."""
    wall = SceneObject.box("wall", (8.0, 0.4, 1.8), (0.0, 2.5, 0.9))
    room = Scene("hall", (wall,), floor_polygon=SQUARE, start=np.array([-2.0, -1.5, 0.0]))
    return save_scene(room, tmp_path_factory.mktemp("hall") / "scene.json")


def line(*xs: float, **how: object) -> tuple[ToolPose, ...]:
    return tuple(ToolPose((x, 2.1, 1.0), NORTH, f"at {x:g}", **how) for x in xs)  # type: ignore[arg-type]


def written(tour: Tour, folder: Path) -> list[Path]:
    """Write the plans of a tour with their times; both verifiers find them valid."""
    paths = [folder / f"{k}.json" for k in range(len(tour.steps))]
    for path, step in zip(paths, tour.steps, strict=True):
        write_plan(with_times(step.plan, step.prepared.robot), path)
        check_independently(path)
        report = verify_files(path)
        assert report.valid, [check for check in report.checks if not check.ok]
    return paths


def failed(plan: Path) -> list[str]:
    return [check.name for check in verify_files(plan).checks if not check.ok]


def test_a_tool_keeps_to_a_path_at_its_speed_and_a_plan_that_leaves_it_is_invalid(
    hall: Scene, robot: Robot, tmp_path: Path
) -> None:
    tour = plan_follow(hall, robot, ToolPath(line(-2.0, -1.7, -1.4), speed=0.05))
    assert (tour.status, tour.stops) == ("solved", (1,))
    path = written(tour, tmp_path)[0]
    plan = read_plan(path)
    assert plan == replace(with_times(tour.steps[0].plan, robot), scene=plan.scene)
    motion = plan.motion
    assert motion is not None
    assert motion.times is not None
    tool = motion.Ts_world_tool[: motion.holds[-1].last + 1, :3, 3]
    speed = np.linalg.norm(np.diff(tool, axis=0), axis=1) / np.diff(motion.times[: len(tool)])
    assert speed.max() <= 0.0505
    assert np.median(speed) >= 0.049
    middle = len(tool) // 3
    q = motion.q.copy()
    q[middle, 4] += 0.01
    T = motion.Ts_world_tool.copy()
    off = tmp_path / "off.json"
    write_plan(replace(plan, motion=replace(motion, q=q, Ts_world_tool=T)), off)
    assert "tool beyond the path's tolerance in position" in failed(off)
    write_plan(replace(plan, motion=replace(motion, times=motion.times / 2)), off)
    assert "tool speed along the path" in failed(off)
    short = replace(plan.task, poses=(*plan.task.poses[:1], *plan.task.poses[2:]))
    write_plan(replace(plan, task=short), off)
    assert "one hold for each pose" in failed(off)


def test_a_long_path_is_cut_at_its_breaks_and_only_there(
    hall: Scene, robot: Robot, tmp_path: Path
) -> None:
    poses = line(*np.linspace(-2.0, 0.4, 5).tolist())
    tour = plan_follow(hall, robot, ToolPath(poses, breaks=(1, 2, 3)))
    assert tour.status == "solved"
    met = [step.plan.task.poses for step in tour.steps]
    assert 2 <= len(met) <= 3
    assert met[0][0] == poses[0]
    assert met[-1][-1] == poses[-1]
    assert all(a[-1] == b[0] for a, b in pairwise(met))
    assert tour.steps[1].plan.start == tour.steps[0].plan.base_pose
    written(tour, tmp_path)


def test_the_base_moves_along_where_no_base_pose_serves_the_path(
    hall: Scene, robot: Robot, tmp_path: Path
) -> None:
    path = ToolPath(line(-2.0, -0.5))
    moving = plan_follow(hall, robot, path, config=PipelineConfig(base="moving"))
    assert moving.steps[0].plan.moves_base
    assert any("the base moves with the tool" in note for note in moving.steps[0].notes)
    written(moving, tmp_path)


def test_a_free_turn_about_the_tool_s_axis_is_used(hall: Scene, robot: Robot) -> None:
    rolled = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
    fixed = ToolPose((-1.2, 2.1, 0.3), rolled)
    free = replace(fixed, axis=(1.0, 0.0, 0.0), spin=np.pi)
    quick = PipelineConfig()
    tours = [
        plan_follow(hall, robot, ToolPath((one, replace(one, xyz=(-0.8, 2.1, 0.3)))), config=quick)
        for one in (free, fixed)
    ]
    assert tours[0].status == "solved"
    driving = [tour.driving if tour.status == "solved" else np.inf for tour in tours]
    assert driving[0] <= driving[1] + 0.05


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        (line(*np.linspace(-2.0, -1.5, 9).tolist(), 1.0), "at 1 is 250 cm from the pose before"),
        (
            (*line(-2.0), ToolPose((-1.9, 2.1, 1.0), (0.5**0.5, 0.0, 0.0, -(0.5**0.5)), "back")),
            "back is turned by 180 deg",
        ),
        ((*line(-2.0), *line(-1.9, contact="wall")), "at -1.9 touches wall and the path before"),
    ],
)
def test_paths_that_cannot_be_meant_are_refused(
    hall: Scene, robot: Robot, poses: tuple[ToolPose, ...], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        plan_follow(hall, robot, ToolPath(poses))


def test_a_file_states_breaks_and_speed(tmp_path: Path, hall: Scene) -> None:
    rows = [
        {"xyz": [x, 2.1, 1.0], "wxyz": list(NORTH), **({"break": True} if x == 0.1 else {})}
        for x in (0.0, 0.1, 0.2)
    ]
    file = tmp_path / "path.json"
    file.write_text(json.dumps({"poses": rows, "speed": "5cm/s", "contact": "wall"}))
    path = load_path(file, hall)
    assert (path.breaks, path.speed, path.poses[0].contact) == ((1,), 0.05, "wall")
    with pytest.raises(InputError, match="unknown 'speed'"):
        load_poses(file, hall)
    table = tmp_path / "path.csv"
    table.write_text(
        "x,y,z,qx,qy,qz,qw,break\n0,2,1,0,0,0,1,\n0.1,2,1,0,0,0,1,yes\n1,2,1,0,0,0,1,\n"
    )
    assert load_path(table, hall).breaks == (1,)
    table.write_text("x,y,z,qx,qy,qz,qw,break\n0,2,1,0,0,0,1,maybe\n0,2,1,0,0,0,1,\n")
    with pytest.raises(InputError, match="pose 1: break must be true or false"):
        load_path(table, hall)
    table.write_text("x,y,z,qx,qy,qz,qw\n0,2,1,0,0,0,1\n")
    with pytest.raises(InputError, match=r"path.csv: a path needs two poses or more, not 1"):
        load_path(table, hall)


def test_lanes_cover_a_face_and_keep_the_tool_on_it(robot: Robot) -> None:
    room = Scene("room", (TABLE,), floor_polygon=SQUARE)
    path = wipe_path(room, robot, "table/top", 0.1, tool_length=0.05)
    T = np.stack([pose.T_world_tool for pose in path.poses])
    down = T[:, :3, :3] @ robot.approach_axis
    np.testing.assert_allclose(down, np.tile([0.0, 0.0, -1.0], (len(T), 1)), atol=1e-9)
    assert np.ptp(T[:, 2, 3]) < 1e-9
    lanes = np.unique(np.round(T[:, 0, 3], 6))
    np.testing.assert_allclose(lanes[[0, -1]], [-0.55, 0.55])
    assert np.diff(lanes).max() <= 0.1 + 1e-9
    np.testing.assert_allclose(np.unique(np.round(T[:, 1, 3], 6))[[0, -1]], [1.8, 2.2])
    near = wipe_path(room, robot, "table/top", 0.1).poses[0]
    assert path.poses[0].xyz[2] - near.xyz[2] == pytest.approx(0.05)
    side = wipe_path(room, robot, "table/-y", 0.1)
    assert {round(pose.xyz[1], 6) for pose in side.poses} == {round(1.75 - (near.xyz[2] - 0.7), 6)}
    with pytest.raises(UnknownNameError, match="no face 'lid' in table"):
        wipe_path(room, robot, "table/lid", 0.1)
    with pytest.raises(InputError, match="less than the tool of 130"):
        wipe_path(room, robot, "table/top", 1.3)
    with pytest.raises(InputError, match="write OBJECT/FACE"):
        wipe_path(room, robot, "table", 0.1)
    kitchen = load_scene("kitchen_small")
    front = wipe_path(kitchen, robot, "fridge/door/front", 0.2)
    assert all(pose.contact == "fridge" for pose in front.poses)
    assert wipe_path(kitchen, robot, "fridge/door_hinge/front", 0.2) == front


def test_the_front_of_a_real_door_is_wiped_whose_shapes_are_on_other_links(robot: Robot) -> None:
    file = optional.there(DATA / "bestman/Asset/Scene/Scene/Kitchen_1.json")
    path = wipe_path(load_scene(file), robot, "elementA/chewie_door_right_joint/front", 0.15)
    toward = np.stack([pose.T_world_tool[:3, :3] for pose in path.poses]) @ robot.approach_axis
    np.testing.assert_allclose(toward, np.tile([1.0, 0.0, 0.0], (len(toward), 1)), atol=1e-6)


@pytest.mark.slow
def test_a_table_is_wiped_in_physics(tmp_path: Path) -> None:
    output_of(*_wiping(tmp_path))
    assert "follow a path of 6 poses: done" in output_of("run", str(tmp_path / "plan.json"))


def _wiping(tmp_path: Path) -> list[str]:
    small = SceneObject.box("table", (0.5, 0.4, 0.7), (1.6, 0.0, 0.35))
    floor = np.array([[-2, -2], [3, -2], [3, 2], [-2, 2]], float)
    save_scene(Scene("r", (small,), floor_polygon=floor, start=np.zeros(3)), tmp_path / "r.json")
    return [
        "place", "follow", str(tmp_path / "r.json"), "--wipe", "table/top", "--tool-width", "20cm",
        "--tool-length", "4cm", "--robot", "fetch", "--out", str(tmp_path / "plan.json"),
    ]  # fmt: skip


def test_a_table_is_wiped_by_command(tmp_path: Path) -> None:
    command = _wiping(tmp_path)
    words = output_of(*command)
    assert "fetch: follow a path of 6 poses: solved" in words
    assert "point 1 to point 6" in words
    check_independently(tmp_path / "plan.json")
    assert verify_files(tmp_path / "plan.json").valid
    output_of("view", str(tmp_path / "plan.json"), "--static", str(tmp_path / "page.html"))
    place = command[:3]
    assert "give either a file" in error_of(*place)
    assert "--wipe needs --tool-width" in error_of(*place, "--wipe", "table/top")
    assert "are for --wipe" in error_of(*place, "p.json", "--tool-width", "8cm")
    assert "--speed: 5deg is not a length" in error_of(*command, "--speed", "5deg")


def test_a_task_to_follow_has_poses_and_a_speed_that_is_one() -> None:
    task = Task("follow", "", poses=line(0.0, 1.0, contact="wall"), speed=0.1)
    assert (task.target, task.touches) == ("a path of 2 poses", "wall")
    with pytest.raises(InputError, match=r"Task.speed must be"):
        replace(task, speed=0.0)
    with pytest.raises(InputError, match="reach and follow need poses"):
        Task("follow", "wall")
