"""Test the free area of the base."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from tests.rooms import Everywhere, cabinet_room, move_scene

from momapos.core.geometry.transforms import compose, wrap_angle
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import MotionConfig
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.area import (
    BaseStatus,
    PlacementGeometry,
    arm_radius,
    base_pose_status,
    grid_standing,
    sampling_box,
    task_frame,
    within_reach,
)  # fmt: skip
from momapos.planning.placement.grasp_scores import attraction
from momapos.planning.placement.pose_search import by_expected_cost


def make_geometry(scene: Scene, robot: Robot, to: float = 1.5) -> PlacementGeometry:
    motion = task_motion(scene, robot, make_task(scene, "open", "cabinet", to=to), MotionConfig())
    return PlacementGeometry(
        robot, np.ascontiguousarray(motion.Ts_world_tool[:, motion.waypoint_steps]), motion.static,
        motion.sweep(), scene.floor_polygon, PipelineConfig().place.clearance,
    )  # fmt: skip


def grid(geometry: PlacementGeometry, count: int = 17) -> np.ndarray:
    corners = sampling_box(geometry)
    x, y = (np.linspace(lo, hi, count) for lo, hi in corners.T)
    yaw = np.linspace(-3, 3, 5)
    return compose(task_frame(geometry), np.stack(np.meshgrid(x, y, yaw), -1).reshape(-1, 3))


def test_the_base_cannot_stand_in_the_sweep_of_a_low_door(robot: Robot, tmp_path: Path) -> None:
    scene = cabinet_room(tmp_path)
    low = scene.object("cabinet").model.urdf.path
    low.write_text(
        low.read_text().replace(" 0.8", " 0.31").replace(" 1.09", " 0.6").replace(" 0.51", " 0.02")
    )
    scene = load_scene(tmp_path / "room.json")
    geometry = make_geometry(scene, robot)
    in_swing = np.array([[0.0, -0.65, 0.0]])
    outcome, _ = base_pose_status(geometry, in_swing)
    assert outcome[0] == BaseStatus.BLOCKED
    still = PlacementGeometry(
        geometry.robot, geometry.Ts_world_tool, geometry.static, geometry.sweep, None, 0.0
    )
    no_sweep = PlacementGeometry(
        still.robot, still.Ts_world_tool, still.static,
        type(still.sweep)(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3))), None, 0.0,
    )  # fmt: skip
    poses = grid(geometry)
    with_sweep, _ = base_pose_status(still, poses)
    without, _ = base_pose_status(no_sweep, poses)
    assert (without[with_sweep == BaseStatus.CLEAR] == BaseStatus.CLEAR).all()
    assert (with_sweep == BaseStatus.BLOCKED).sum() > (without == BaseStatus.BLOCKED).sum()


def test_the_free_area_moves_with_the_scene(robot: Robot, tmp_path: Path) -> None:
    scene = cabinet_room(tmp_path)
    moved = move_scene(scene, 3.0, -1.0, 0.7)
    geometry, other = make_geometry(scene, robot), make_geometry(moved, robot)
    poses = grid(geometry)
    carried = compose(np.array([3.0, -1.0, 0.7]), poses)
    np.testing.assert_array_equal(
        base_pose_status(geometry, poses)[0], base_pose_status(other, carried)[0]
    )
    np.testing.assert_allclose(
        attraction(geometry, poses[:, :2], np.array([1.0])),
        attraction(other, carried[:, :2], np.array([1.0])), atol=1e-9,
    )  # fmt: skip


def test_the_sampling_frame_moves_with_the_scene(robot: Robot, tmp_path: Path) -> None:
    scene = cabinet_room(tmp_path)
    geometry, other = (
        make_geometry(scene, robot),
        make_geometry(move_scene(scene, 3.0, -1.0, 0.7), robot),
    )
    a, b = sampling_box(geometry), sampling_box(other)
    np.testing.assert_allclose(a, b, atol=1e-9)
    shift = np.array([3.0, -1.0, 0.7])
    expected = compose(shift, task_frame(geometry)[None])[0]
    difference = task_frame(other) - expected
    assert np.abs(difference[:2]).max() < 1e-9
    assert abs(wrap_angle(difference[2])) < 1e-9


def test_a_mirrored_scene_mirrors_the_free_area(tmp_path: Path, fetch: Robot) -> None:
    robot: Robot = fetch  # type: ignore[operator]
    right = make_geometry(cabinet_room(tmp_path / "r"), robot)
    left = make_geometry(cabinet_room(tmp_path / "l", left=True), robot)
    poses = grid(right)
    mirrored = poses * [-1.0, 1.0, 1.0]
    mirrored[:, 2] = np.pi - poses[:, 2]
    a, b = base_pose_status(right, poses)[0], base_pose_status(left, mirrored)[0]
    # The base's covering boxes are not symmetric to the last millimeter.
    assert (a == b).mean() > 0.98
    plain_r, plain_l = right.Ts_world_tool[0, :, :3, 3], left.Ts_world_tool[0, :, :3, 3]
    np.testing.assert_allclose(plain_r * [-1, 1, 1], plain_l, atol=1e-9)


def test_no_pose_outside_the_sampling_box_is_within_reach(robot: Robot, tmp_path: Path) -> None:
    geometry = make_geometry(cabinet_room(tmp_path), robot)
    corners = sampling_box(geometry)
    rng = np.random.default_rng(0)
    local = rng.uniform(-4, 4, (4000, 3))
    inside = ((local[:, :2] >= corners[0]) & (local[:, :2] <= corners[1])).all(1)
    reached = within_reach(geometry, compose(task_frame(geometry), local))
    assert not (reached & ~inside).any()
    assert (arm_radius(geometry) > 0.2).all()


def test_a_base_off_the_floor_is_rejected(robot: Robot, tmp_path: Path) -> None:
    scene = cabinet_room(tmp_path)
    floor = np.array([[-2.0, -3.0], [2.0, -3.0], [2.0, 0.5], [-2.0, 0.5]])
    geometry = make_geometry(scene, robot)
    bounded = PlacementGeometry(
        robot, geometry.Ts_world_tool, geometry.static, geometry.sweep, floor - [0, 20], 0.0
    )
    poses = grid(geometry)
    assert BaseStatus.CLEAR in base_pose_status(geometry, poses)[0]
    outcome = base_pose_status(bounded, poses)[0]
    assert BaseStatus.CLEAR not in outcome
    assert BaseStatus.OFF_FLOOR in outcome


def test_candidates_are_ordered_by_expected_cost() -> None:
    travel = np.array([3.0, 1.0, np.inf, 2.0])
    odds = np.array([1.0, 0.0, 1.0, 1.0])
    assert by_expected_cost(travel, odds, miss=5.0).tolist() == [3, 0, 1]
    assert by_expected_cost(travel, np.ones(4), miss=5.0).tolist() == [1, 3, 0]


def test_a_handle_that_is_too_high_is_reported_as_such(robot: Robot, tmp_path: Path) -> None:
    cabinet_room(tmp_path)
    text = (tmp_path / "room.json").read_text()
    (tmp_path / "room.json").write_text(text.replace('"xyz": [0, 0, 0]', '"xyz": [0, 0, 3]'))
    high = load_scene(tmp_path / "room.json")
    task = make_task(high, "open", "cabinet")
    plan = plan_base_placement(high, robot, task, Everywhere()).plan
    assert plan.status == "infeasible"
    (reason,) = plan.candidates.rejections
    assert re.fullmatch(r"out of reach in height: 3\.8\d m is too high at any distance", reason)


def test_what_is_known_of_a_grid_changes_no_status(robot: Robot, tmp_path: Path) -> None:
    """Other openings of the same door see the same furniture; the remembered codes serve them."""
    scene = cabinet_room(tmp_path)
    cell, turn = 0.1, 30.0
    for to in (1.5, 0.4, 1.0):
        geometry = make_geometry(scene, robot, to)
        corners = sampling_box(geometry)
        x, y = (cell * np.arange(np.floor(lo / cell), np.ceil(hi / cell)) for lo, hi in corners.T)
        yaw = np.radians(np.arange(-180.0, 180.0, turn))
        local = np.stack(np.meshgrid(x, y, yaw, indexing="ij"), -1).reshape(-1, 3)
        poses = compose(task_frame(geometry), local)
        for _ in range(2):
            stands = grid_standing(geometry, poses, local, cell, turn)
            known = base_pose_status(geometry, poses, stands)
            np.testing.assert_array_equal(known, base_pose_status(geometry, poses))
    assert {BaseStatus.CLEAR, BaseStatus.BLOCKED} <= set(known[0].tolist())
