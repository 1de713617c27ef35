"""Laws of reach studies: a map counts what is reached, and the best base pose reaches the most."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.commands import error_of, json_of, output_of

from momapos.core.errors import InputError, UnknownNameError
from momapos.core.geometry.transforms import pose_planar
from momapos.model.records.plans import Task
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.grasps.surfaces import surface_poses
from momapos.planning.query import PlacementQuery
from momapos.planning.reach_study import map_poses, study_reach

FLOOR = np.array([[-1.5, -1.5], [2, -1.5], [2, 1.5], [-1.5, 1.5]], float)
BOX = SceneObject.box("box", (0.4, 0.6, 0.3), (0.6, 0.0, 0.8))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("segway_ur5e")


@pytest.fixture(scope="module")
def query(robot: Robot) -> PlacementQuery:
    room = Scene("room", (BOX,), floor_polygon=FLOOR, start=np.array([-0.9, 0.0, 0.0]))
    poses = surface_poses(room, robot, "box", 0.3)
    return PlacementQuery.of(room, robot, Task("reach", "", poses=poses))


def test_points_lie_on_the_surface_and_hands_are_toward_it(robot: Robot) -> None:
    poses = surface_poses(Scene("room", (BOX,)), robot, "box", 0.1, standoff=0.05)
    assert len(poses) == round(2 * (0.4 * 0.6 + 0.4 * 0.3 + 0.6 * 0.3) / 0.01)
    T = np.stack([pose.T_world_tool for pose in poses])
    approach = T[:, :3, :3] @ robot.approach_axis
    near = surface_poses(Scene("room", (BOX,)), robot, "box", 0.1)
    moved = T[:, :3, 3] - [pose.xyz for pose in near]
    np.testing.assert_allclose(moved, -0.05 * approach, atol=1e-9)
    half = np.array([0.2, 0.3, 0.15])
    side = np.abs(approach).argmax(1)
    out = np.abs(T[:, :3, 3] - [0.6, 0.0, 0.8]) - half
    across = np.array([np.delete(row, k).max() for row, k in zip(out, side, strict=True)])
    assert across.max() <= 1e-9
    with pytest.raises(InputError, match="so a spacing of"):
        surface_poses(Scene("room", (BOX,)), robot, "box", 0.01)
    with pytest.raises(UnknownNameError, match="no part 'lid' in box"):
        surface_poses(Scene("room", (BOX,)), robot, "box/lid", 0.1)


def test_the_best_base_pose_reaches_what_its_cell_says_and_no_cell_more(
    query: PlacementQuery,
) -> None:
    found = map_poses(query)
    assert found.best is not None
    study = study_reach(query, found.best)
    assert study.reached.sum() == np.nanmax(found.served) > 0
    assert study.base_pose == study_reach(query).base_pose == found.best
    assert (study.dexterity[study.reached] > 0.0).all()
    assert not study.dexterity[~study.reached].any()
    back = np.linalg.inv(pose_planar(np.array(found.best)))
    away = [np.linalg.norm((back @ pose.T_world_tool)[:3, 3]) for pose in query.task.poses]
    assert np.array(away)[study.reached].max() < query.robot.reach + 1.0


def test_a_base_pose_off_the_floor_or_in_the_way_has_its_reason(query: PlacementQuery) -> None:
    off = study_reach(query, (5.0, 0.0, 0.0))
    assert (int(off.reached.sum()), off.why) == (0, "base off the floor")
    assert "collision" in study_reach(query, (0.6, 0.0, 0.0)).why
    with pytest.raises(InputError, match="base_pose"):
        study_reach(query, (np.nan, 0.0, 0.0))


def test_the_command_writes_a_table_a_picture_and_a_map(tmp_path: Path) -> None:
    mesh = trimesh.creation.box((0.3, 0.3, 0.3))
    mesh.apply_translation((0.0, 0.0, 0.9))
    mesh.export(tmp_path / "cube.stl")
    command = ["reach", "study", "segway_ur5e", str(tmp_path / "cube.stl"), "--spacing", "15cm"]
    found = json_of(
        *command, "--out", str(tmp_path / "t.csv"), "--plot", str(tmp_path / "p.png"),
        "--map", str(tmp_path / "m.png"), "--page", str(tmp_path / "p.html"), "--json",
    )  # fmt: skip
    rows = list(csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))
    assert len(rows) == found["points"] == 24
    assert sum(int(row["reached"]) for row in rows) == found["reached"] > 0
    for name in ("p.png", "m.png"):
        assert (tmp_path / name).stat().st_size > 10_000
    assert f"{found['reached']} of 24 points are reached" in (tmp_path / "p.html").read_text()
    at = ",".join(map(str, found["base_pose"]))
    words = output_of(*command, "--at", f"{at}rad")
    assert f"{found['reached']} of 24 points of cube are reached" in words
    assert "none.stl" in error_of("reach", "study", "segway_ur5e", str(tmp_path / "none.stl"))
    assert "--spacing: 5deg is not a length" in error_of(*command[:-1], "5deg")


def test_reach_draws_from_where_how_many_of_its_poses_are_reached(tmp_path: Path) -> None:
    poses = [{"xyz": [1.2, y, 0.9], "wxyz": [1, 0, 0, 0]} for y in (-1.2, -1.1)]
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    figure = tmp_path / "map.png"
    words = output_of(
        "place", "reach", "kitchen_small", str(tmp_path / "poses.json"), "--robot", "segway_ur5e",
        "--map", str(figure),
    )  # fmt: skip
    assert "reach 2 poses: solved" in words
    assert figure.stat().st_size > 10_000
