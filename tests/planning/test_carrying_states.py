"""What a robot holds is there while the base drives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float
from tests.rooms import Everywhere

from momapos.core.geometry.transforms import invert, pose_planar
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.records.plans import PlacementPlan
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.base_pose_check import plan_at_pose
from momapos.planning.carrying import carrier_of
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.max_opening import by_samples
from momapos.planning.navigation.convex_polygons import prisms_of
from momapos.planning.navigation.driving import drive
from momapos.planning.navigation.footprint_map import build_navigation_map
from momapos.planning.navigation.global_path import plan_path
from momapos.planning.plan import plan_placement
from momapos.planning.query import PlacementQuery
from momapos.verification.plan_check import verify_files

FLOOR = np.array([[-2.5, -2.5], [2.5, -2.5], [2.5, 2.5], [-2.5, 2.5]])
START = np.array([0.0, -1.5, np.pi / 2])
DRIVE = "start and base path collision, arm at home"


def room(folder: Path, length: float, door: float = 0.9) -> Scene:
    """Return a room with a bar on a table, behind a doorway in a wall across the room."""
    side = 2.5 - door / 2
    walls = [
        SceneObject.box(name, (side, 0.1, 2.4), (sign * (door + side) / 2, 0.0, 1.2))
        for name, sign in (("left", -1), ("right", 1))
    ]
    table = SceneObject.box("table", (1.6, 0.6, 0.75), (0.0, 2.1, 0.375))
    bar = replace(SceneObject.box("bar", (length, 0.03, 0.03), (0.0, 1.95, 0.765)), mass=0.3)
    scene = Scene("room", (*walls, table, bar), floor_polygon=FLOOR)
    save_scene(scene, folder / "room.json")
    return load_scene(folder / "room.json")


def question(scene: Scene, robot: str) -> PlacementQuery:
    task = make_task(scene, "place", "bar", None)
    return PlacementQuery.of(scene, load_robot(robot), task, Everywhere(), start=START)


def bar_on_drive(plan: PlacementPlan, robot: str, length: float) -> Float[np.ndarray, "n 3"]:
    """Return points of the bar on the drive, in the world, by the robot's kinematics alone."""
    machine = load_robot(robot)
    first = machine.chain.tool_poses(machine.chain.freedom_values(plan.motion.approach[:1]))[0]
    T_world_bar = np.eye(4)
    T_world_bar[:3, 3] = 0.0, 1.95, 0.765
    T_base_bar = first @ invert(plan.motion.Ts_world_tool[0]) @ T_world_bar
    points = np.outer(np.linspace(-length / 2, length / 2, 41), [1.0, 0.0, 0.0])
    placed = pose_planar(plan.base_path) @ T_base_bar
    return (points @ placed[:, :3, :3].swapaxes(1, 2) + placed[:, None, :3, 3]).reshape(-1, 3)


@pytest.mark.parametrize(("robot", "length"), [("segway_ur5e", 1.3), ("fetch", 2.0)])
def test_a_long_object_is_carried_through_a_doorway(
    tmp_path: Path, robot: str, length: float
) -> None:
    query = question(room(tmp_path, length), robot)
    plan = plan_placement(query).plan
    assert plan.feasible
    x, y, z = bar_on_drive(plan, robot, length).T
    assert not ((np.abs(y) < 0.05) & (np.abs(x) > 0.45) & (z < 2.4)).any()
    write_plan(plan, tmp_path / "plan.json")
    assert verify_files(tmp_path / "plan.json").valid
    assert plan_at_pose(query, plan.base_pose or ()).plan.status == "solved"


@pytest.mark.slow
def test_a_doorway_too_narrow_for_all_ways_to_carry_is_a_no(tmp_path: Path) -> None:
    """The robot gets through with an empty hand."""
    query = question(room(tmp_path, 1.3, door=0.66), "segway_ur5e")
    query = replace(query, config=by_samples(query.config))
    behind = np.array([0.0, 1.0, np.pi / 2])
    assert plan_path(build_navigation_map(query.scene, query.robot), START, behind) is not None
    plan = plan_placement(query).plan
    assert plan.status == "infeasible"
    assert "no base path with bar in the hand" in plan.candidates.rejections


def test_verify_sees_what_is_carried(tmp_path: Path, segway: Robot) -> None:
    """At home, the bar is across the way of the robot."""
    scene = room(tmp_path, 1.3)
    wide = scene.without("left").without("right")
    plan = plan_placement(question(wide, "segway_ur5e")).plan
    assert np.allclose(segway.chain.freedom_values(plan.motion.approach[0]), segway.home)
    write_plan(replace(plan, scene=str(tmp_path / "room.json")), tmp_path / "plan.json")
    report = verify_files(tmp_path / "plan.json")
    assert [check.name for check in report.violations] == [DRIVE]
    assert "bar" in report.violations[0].detail


def test_a_drive_in_closed_loop_holds_the_object(tmp_path: Path, segway: Robot) -> None:
    scene = room(tmp_path, 1.3)
    plan = plan_placement(question(scene, "segway_ur5e")).plan
    carrier, held = carrier_of(plan, scene, segway)
    assert held is not None
    ground = build_navigation_map(scene, carrier, (), held)
    goal = np.array(plan.base_pose)
    assert drive(ground, START, goal, rng=np.random.default_rng(0)).arrived
    at_home = build_navigation_map(scene, segway, (), held)
    blocked = drive(at_home, START, goal, rng=np.random.default_rng(0))
    assert not blocked.arrived


def test_prisms_contain_what_is_held(tmp_path: Path, segway: Robot) -> None:
    scene = room(tmp_path, 1.3)
    plan = plan_placement(question(scene, "segway_ur5e")).plan
    carrier, held = carrier_of(plan, scene, segway)
    prisms = prisms_of(carrier, held)
    T = carrier.chain.tool_poses(carrier.home[None])[0]
    corners = np.concatenate(held.hulls) @ T[:3, :3].T + T[:3, 3]
    assert prisms.heights[-1] >= corners[:, 2].max() - 1e-9
    for x, y, z in corners:
        layer = int(np.searchsorted(prisms.heights, z, side="right")) - 1
        outline = prisms.outlines[min(layer, len(prisms.outlines) - 1)]
        edge = np.roll(outline, -1, axis=0) - outline
        away = np.array([x, y]) - outline
        assert (edge[:, 0] * away[:, 1] - edge[:, 1] * away[:, 0] >= -1e-9).all()
