"""Laws of keeping an object level: no state in which the hand holds it tilts it by more."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of
from tests.real import check_independently

from momapos.core import GRAVITY
from momapos.core.errors import InputError, TaskError
from momapos.core.geometry import halton, rotation_about
from momapos.model.collision.collision_world import build_world
from momapos.model.collision.straight_motions import Upright, build_motions
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.plans import PlacementPlan, Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.trajectory import SpeedConfig
from momapos.model.urdf.hulls import Boxes, MovingBoxes
from momapos.planning.arm_motion.payload import (
    HOME_SPREAD,
    carrying_homes,
    payload_hits_at_home,
)
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import MotionConfig
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.keyword_forms import plan_tour
from momapos.planning.query import PlacementQuery
from momapos.planning.tour import Request, Tour
from momapos.verification.plan_check import verify_files

ROOM = [
    SceneObject.box("counter", (1.6, 0.6, 0.9), (0.0, 2.1, 0.45)),
    SceneObject.box("cup", (0.07, 0.07, 0.10), (0.2, 1.95, 0.95)),
]
GOAL = "-0.4,2.0,0.9"


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    path = tmp_path_factory.mktemp("room") / "room.json"
    save_scene(Scene("room", tuple(ROOM), start=np.array([0.0, -1.0, 1.57])), path)
    return load_scene(path)


def level(angle: float | None) -> PipelineConfig:
    return PipelineConfig(timeout=60.0, motion=MotionConfig(level=angle))


def brought(scene: Scene, robot: Robot, angle: float | None) -> Tour:
    return plan_tour(scene, robot, [Request("bring", "cup", None, GOAL)], config=level(angle))


def largest_tilt(plan: PlacementPlan, robot: Robot) -> float:
    """Return how far the object in the hand is tilted at most [rad], by the robot's kinematics."""
    motion = plan.motion
    assert motion is not None
    if plan.task.verb == "pick":
        assert motion.home is not None
        states, standing = [motion.q, motion.home], motion.q[0]
    else:
        down = int(np.argmin(motion.Ts_world_tool[:, 2, 3]))
        states, standing = [motion.approach, motion.q[: down + 1]], motion.q[down]
    q = robot.chain.freedom_values(np.concatenate(states))
    q = np.linspace(q[:-1], q[1:], 5).reshape(-1, q.shape[1])
    R = robot.chain.tool_poses(q)[:, :3, :3]
    first = robot.chain.tool_poses(robot.chain.freedom_values(standing)[None])[0, :3, :3]
    return float(np.arccos(np.clip((R @ first.T)[:, 2, 2], -1.0, 1.0)).max())


@pytest.mark.parametrize(
    ("name", "angle"),
    [("fetch", 15.0), ("tiago", 5.0), ("ranger_rm63", 10.0),
     pytest.param("segway_ur5e", 15.0, marks=pytest.mark.slow)],
)  # fmt: skip
def test_a_full_cup_is_brought_without_spilling(
    room: Scene, robots: Callable[[str], Robot], name: str, angle: float
) -> None:
    robot = robots(name)
    tour = brought(room, robot, angle)
    assert [step.plan.feasible for step in tour.steps] == [True, True]
    assert max(largest_tilt(s.plan, robot) for s in tour.steps) < math.radians(angle) + 1e-3
    loose = brought(room, robot, None)
    assert max(largest_tilt(s.plan, robot) for s in loose.steps) > math.radians(angle)


def test_both_plans_of_a_level_tour_are_valid_and_name_the_tilt(
    room: Scene, fetch: Robot, tmp_path: Path
) -> None:
    tour = brought(room, fetch, 15.0).with_scene_files(tmp_path / "tour.json")
    paths = []
    for k, step in enumerate(tour.steps):
        paths.append(tmp_path / f"{k}.json")
        write_plan(step.plan, paths[-1])
        assert read_plan(paths[-1]).task.level == pytest.approx(math.radians(15.0))
        report = verify_files(paths[-1])
        assert report.valid, report.violations
        check_independently(paths[-1])
    data = json.loads(paths[0].read_text())
    data["task"]["level"] = math.radians(1.0)
    paths[0].write_text(json.dumps(data))
    (worst,) = verify_files(paths[0]).violations
    assert "level" in str(worst)


def test_the_arm_carries_as_near_to_home_as_it_can(room: Scene, fetch: Robot) -> None:
    task = Task("place", "cup", level=math.radians(15.0))
    motion = task_motion(room, fetch, task, MotionConfig())
    plain = task_motion(room, fetch, Task("place", "cup"), MotionConfig())
    home = fetch.home[None]
    found = 0
    for grasp in range(0, len(motion.grasps), 14):
        if payload_hits_at_home(fetch, plain)[grasp] < 0:
            np.testing.assert_array_equal(carrying_homes(fetch, plain, grasp), home)
        homes = carrying_homes(fetch, motion, grasp)
        assert (np.diff(np.linalg.norm(homes - home, axis=1)) >= 0.0).all()
        assert (homes >= fetch.chain.lower).all()
        assert (homes <= fetch.chain.upper).all()
        Rs = fetch.chain.tool_poses(homes)[:, :3, :3]
        standing = motion.Ts_world_tool[grasp, motion.grasp_step, :3, :3]
        assert ((Rs @ standing.T)[:, 2, 2] > np.cos(task.level or 0.0)).all()
        for q in homes:
            assert payload_hits_at_home(fetch.with_home(q), motion)[grasp] < 0
        apart = np.abs(homes[:, None] - homes).max(2) + 9.0 * np.eye(len(homes))
        assert (apart > HOME_SPREAD).all()
        found += len(homes) > 1
    assert found > 2


def test_a_straight_motion_is_refused_exactly_where_it_tilts(fetch: Robot) -> None:
    chain, spheres = fetch.chain, fetch.spheres
    none = MovingBoxes(np.zeros((1, 0, 3)), np.zeros((1, 0, 3, 3)), np.zeros((1, 0, 3)))
    empty = build_world(Boxes.join([]), none, np.zeros(0, bool), [], spheres, clearance=0.0)
    low = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    high = np.where(np.isfinite(chain.upper), chain.upper, np.pi)
    ends = low + halton(400, chain.size) * (high - low)
    axis = chain.tool_poses(fetch.home[None])[0, :3, :3].T @ [0.0, 0.0, 1.0]
    given = {"value": 0, "holding": False, "step": 0.04}
    free = build_motions(empty, chain, spheres, np.zeros(3), **given)
    tilted = kept = 0
    for cosine in (-0.5, 0.3):
        upright = Upright(chain.tool_rotation @ axis, cosine)
        steady = build_motions(empty, chain, spheres, np.zeros(3), **given, upright=upright)
        for a, b in zip(ends[::2], ends[1::2], strict=True):
            if not free(a, b):
                continue
            between = a + np.linspace(0.0, 1.0, 400)[:, None] * (b - a)
            least = float((chain.tool_poses(between)[:, 2, :3] @ axis).min())
            if abs(least - cosine) > 0.02:
                assert steady(a, b) == (least > cosine)
                tilted, kept = tilted + (least < cosine), kept + (least > cosine)
    assert min(tilted, kept) > 5


def test_speeds_leave_half_of_the_tilt_to_the_surface_of_a_liquid() -> None:
    speeds = SpeedConfig()
    assert speeds.for_task(Task("pick", "cup")) is speeds
    slow = speeds.for_task(Task("pick", "cup", level=math.radians(4.0)))
    assert slow.carry_acceleration == pytest.approx(GRAVITY * math.tan(math.radians(2.0)))
    loose = speeds.for_task(Task("pick", "cup", level=math.radians(60.0)))
    assert loose.carry_acceleration == speeds.carry_acceleration


def test_what_cannot_be_kept_level_is_refused_in_one_line(
    room: Scene, fetch: Robot, tmp_path: Path
) -> None:
    lying = room.with_pose("cup", room.object("cup").T_world_object @ tilted_by(30.0))
    with pytest.raises(TaskError, match="tilted by 30 deg in the scene, more than the 15 deg"):
        PlacementQuery.of(lying, fetch, Task("pick", "cup"), config=level(15.0))
    with pytest.raises(InputError, match="level"):
        MotionConfig(level=0.0)
    path = tmp_path / "room.json"
    save_scene(room, path)
    place = ["place", "open", "kitchen_small", "fridge/door_hinge"]
    assert "--level" in error_of(*place, "--level", "15deg")
    assert "--level" in error_of("place", "pick", str(path), "cup", "--level", "15cm")


def tilted_by(angle: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = rotation_about(np.array([1.0, 0.0, 0.0]), math.radians(angle))
    return T
