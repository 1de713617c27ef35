"""The start of a robot: it touches nothing with its arm at home."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import Everywhere, cabinet_room

from momapos.core.cache import default_cache_dir
from momapos.core.errors import SceneError
from momapos.model.records.plans import PlacementPlan, Task
from momapos.model.robots.robot import Robot, read_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.navigation.footprint_map import build_navigation_map
from momapos.planning.navigation.judge import FootprintCollisionChecker
from momapos.planning.navigation.start import (
    check_arm_at_home,
    clear_at_home,
    outlines_after,
    touched_at_home,
)
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.reachability.map_store import load_reach
from momapos.verification.exact_check import PlanVerifier

CONFIG = PipelineConfig(place=PlaceConfig(count=256, polish=1), timeout=300.0)
STRETCHED = np.array([0.15, 0.0, -0.1, 0.0, 0.2, 0.0, 0.2, 0.0])
"""A state of the Fetch with its arm out in front."""


@pytest.fixture(scope="module")
def wide(tmp_path_factory: pytest.TempPathFactory, fetch: Robot) -> Robot:
    """Return a Fetch that drives with its arm stretched out."""
    folder = tmp_path_factory.mktemp("wide")
    text = fetch.path.read_text()
    home = next(line for line in text.splitlines() if line.startswith("home"))
    text = text.replace(home, f"home = {STRETCHED.tolist()}")
    text = text.replace('"fetch.urdf"', f'"{fetch.model.urdf.path}"')
    (folder / "wide.toml").write_text(text)
    return read_robot(folder / "wide.toml")


@pytest.fixture
def room(tmp_path: Path) -> Scene:
    return cabinet_room(tmp_path)


def touching(ground_robot: Robot, scene: Scene, pose: np.ndarray) -> str:
    ground = build_navigation_map(scene, ground_robot)
    checker = FootprintCollisionChecker(ground.prisms, ground.obstacles, ground.floor_polygon)
    return checker.distance(pose[None])[1][0]


def test_a_start_where_only_the_arm_at_home_collides_is_refused(wide: Robot, room: Scene) -> None:
    start = np.array([0.0, -1.0, np.pi / 2])
    assert touching(wide, room, start).startswith("cabinet/")
    task = make_task(room, "open", "cabinet")
    with pytest.raises(SceneError, match=r"with its arm at home [1-9][0-9]* mm in cabinet/"):
        plan_base_placement(room, wide, task, Everywhere(), start=start, config=CONFIG)


def test_a_chosen_start_has_clearance_for_the_arm_at_home(wide: Robot, tmp_path: Path) -> None:
    """A board at arm height is farther from the base than the clearance of a start."""
    board = (
        ', {"name": "board", "category": "board", "pose": {"xyz": [0.95, -1.5, 0.9], '
        '"wxyz": [1, 0, 0, 0]}, "box": [0.1, 2.0, 1.2]}'
    )
    cabinet_room(tmp_path, extra=board)
    text = (tmp_path / "room.json").read_text()
    start = '"start": {"x": 0, "y": -2.5, "yaw": 1.57},'
    assert start in text
    (tmp_path / "room.json").write_text(text.replace(start, ""))
    room = load_scene(tmp_path / "room.json")
    answer = plan_base_placement(
        room, wide, make_task(room, "open", "cabinet"), Everywhere(), config=CONFIG
    )
    assert touching(wide, room, answer.start) == ""


def test_a_plan_contains_its_start_and_a_free_path_to_its_base_pose(
    room: Scene, segway: Robot
) -> None:
    plan = plan_base_placement(
        room, segway, make_task(room, "open", "cabinet"), Everywhere(), config=CONFIG
    ).plan
    assert plan.status == "solved"
    np.testing.assert_allclose(plan.start, room.start)
    np.testing.assert_allclose(plan.base_path[0], plan.start)
    np.testing.assert_allclose(plan.base_path[-1], plan.base_pose)
    assert all(touching(segway, room, pose) == "" for pose in plan.base_path[::5])
    checks = PlanVerifier(room, segway, plan.task).drive_checks(plan)
    assert len(checks) == 6
    assert all(check.ok for check in checks)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (
            {"start": (0.0, -0.3, 0.0), "base_path": None},
            "start and base path collision, arm at home",
        ),
        ({"start": (0.0, -2.6, 1.57)}, "base path from start to base pose"),
        ({"base_path": np.zeros((0, 3))}, "base path has 1 to 20000 poses"),
    ],
)
def test_a_start_or_path_that_is_not_free_fails_the_check(
    room: Scene, change: dict[str, object], name: str, segway: Robot
) -> None:
    plan = plan_base_placement(
        room, segway, make_task(room, "open", "cabinet"), Everywhere(), config=CONFIG
    ).plan
    wrong: PlacementPlan = replace(plan, **change)  # type: ignore[arg-type]
    checks = PlanVerifier(room, segway, plan.task).drive_checks(wrong)
    assert name in [check.name for check in checks if not check.ok]


def test_a_base_pose_that_is_unreachable_with_the_arm_at_home_is_rejected(
    tmp_path: Path, ranger: Robot
) -> None:
    """Bars at arm height surround the base pose; the base alone would pass under them."""
    bars = "".join(
        f', {{"name": "bar{k}", "category": "bar", "pose": {{"xyz": [{x}, {y}, 1.1], '
        f'"wxyz": [1, 0, 0, 0]}}, "box": [{dx}, {dy}, 0.5]}}'
        for k, (x, y, dx, dy) in enumerate(
            [(0, -1.9, 6, 0.05), (0, 0.9, 6, 0.05), (-3, -0.5, 0.05, 2.9), (3, -0.5, 0.05, 2.9)]
        )
    )
    scene = cabinet_room(tmp_path, extra=bars)
    start = np.array([0.0, -3.0, np.pi / 2])
    config = PipelineConfig(place=PlaceConfig(count=64, rounds=1, grid=False), timeout=60.0)
    plan = plan_base_placement(
        scene, ranger, make_task(scene, "open", "cabinet"), Everywhere(), start=start, config=config
    ).plan
    assert plan.status == "infeasible"
    reasons = " ".join(plan.candidates.rejections)
    assert "no way to drive there: obstacles close it off" in reasons


def test_outlines_after_a_task_are_those_of_the_object_in_the_scene_after_it(
    room: Scene, segway: Robot
) -> None:
    task = make_task(room, "open", "cabinet", to=1.2)
    after = room.with_joint("cabinet", task.joint, 1.2)
    nav_map = build_navigation_map(after, segway)
    rng = np.random.default_rng(0)
    poses = rng.uniform([-1.5, -1.5, -np.pi], [1.5, 0.5, np.pi], (200, 3))
    outlines = outlines_after(room, segway, task)
    clear = clear_at_home(poses, segway, outlines)
    judge = FootprintCollisionChecker(nav_map.prisms, nav_map.obstacles, None)
    touched = judge.distance(poses)[1]
    assert 20 < clear.sum() < 180
    assert [not name for name in touched] == clear.tolist()
    assert [touched_at_home(pose, segway, outlines) for pose in poses] == touched


def test_a_task_without_a_joint_has_no_outlines_after_it(kitchen: Scene, segway: Robot) -> None:
    rigid = next(item.name for item in kitchen.objects if not item.model.joints)
    outlines = outlines_after(kitchen, segway, Task("pick", rigid))
    assert not len(outlines)
    assert clear_at_home(np.zeros((3, 3)), segway, outlines).all()
    assert touched_at_home(np.zeros(3), segway, outlines) == ""


def test_the_next_task_can_start_at_the_base_pose_that_opened_a_door(
    kitchen: Scene, segway: Robot
) -> None:
    reach = load_reach(segway, default_cache_dir())
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    answer = plan_base_placement(kitchen, segway, task, reach)
    assert answer.touched_after == ""
    opened = kitchen.with_joint("fridge", "door_hinge", task.to)
    check_arm_at_home(build_navigation_map(opened, segway), np.array(answer.plan.base_pose))
