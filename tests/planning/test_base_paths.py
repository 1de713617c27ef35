"""Laws of base paths: after a task the robot can drive on, if any base pose allows it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import Everywhere, corridor_room

from momapos.apps.cli.console import summary
from momapos.core.stopwatch import Stopwatch
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning import base_paths
from momapos.planning.base_paths import OnwardPaths
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.navigation.footprint_map import NavigationMap, build_navigation_map
from momapos.planning.navigation.global_path import BasePath, plan_path
from momapos.planning.placement.config import Method, PlaceConfig
from momapos.planning.query import PlacementQuery
from momapos.planning.result import PlacementResult
from momapos.planning.search_setup import prepare_search

QUICK = PipelineConfig(place=PlaceConfig(count=256, polish=1, grid=False), timeout=300.0)
START = np.array([-2.8, -0.8, 0.0])


@pytest.fixture(scope="module")
def corridor(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return corridor_room(tmp_path_factory.mktemp("corridor"))


def plan_cabinet(
    scene: Scene, robot: Robot, to: float, start: np.ndarray = START
) -> PlacementResult:
    task = make_task(scene, "open", "cabinet", to=to)
    return plan_base_placement(scene, robot, task, Everywhere(), start=start, config=QUICK)


def leads_out(answer: PlacementResult, robot: Robot, goal: np.ndarray = START) -> bool:
    """Return whether a path leads from the base pose back to the start, past the open door."""
    task, scene = answer.plan.task, answer.prepared.scene
    after = scene.with_joint(task.object, task.joint, task.to)
    base = np.array(answer.plan.base_pose)
    return plan_path(build_navigation_map(after, robot), base, goal) is not None


def test_a_door_that_would_block_the_robot_in_is_opened_from_its_other_side(
    corridor: Scene, segway: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = plan_cabinet(corridor, segway, 1.2)
    assert answer.plan.status == "solved"
    assert leads_out(answer, segway)
    assert not answer.search.blocked_in
    assert "afterward" not in summary(answer, None)
    with monkeypatch.context() as patch:
        patch.setattr(OnwardPaths, "__call__", lambda _self, _base: True)
        unchecked = plan_cabinet(corridor, segway, 1.2)
    assert unchecked.plan.status == "solved"
    assert not leads_out(unchecked, segway)


def test_a_task_is_solved_even_if_every_base_pose_blocks_the_robot_in(
    corridor: Scene, segway: Robot
) -> None:
    answer = plan_cabinet(corridor, segway, 1.57)
    assert answer.plan.status == "solved"
    assert not leads_out(answer, segway)
    assert answer.search.blocked_in
    assert answer.touched_after == ""
    assert "the base can't drive on from there: cabinet" in summary(answer, None)


def test_a_start_near_the_open_door_is_not_the_goal_of_the_departure(
    corridor: Scene, segway: Robot
) -> None:
    start = np.array([0.0, -0.95, 0.0])
    answer = plan_cabinet(corridor, segway, 1.2, start)
    assert answer.plan.status == "solved"
    assert not leads_out(answer, segway, start)
    assert not answer.search.blocked_in
    assert leads_out(answer, segway)


@pytest.mark.parametrize(
    ("method", "departure", "checked"),
    [
        ("ours", True, True),
        ("ours", False, False),
        ("exhaustive", True, False),
        ("m3", True, False),
    ],
)
def test_only_our_method_checks_the_departure_from_a_base_pose(
    corridor: Scene, segway: Robot, method: Method, departure: bool, checked: bool
) -> None:
    """The grid returns the cheapest pose, and other methods follow their papers."""
    config = PipelineConfig(place=PlaceConfig(method=method, departure=departure))
    task = make_task(corridor, "open", "cabinet", to=1.2)
    query = PlacementQuery(
        corridor, segway, task, Everywhere(), START, config, watch=Stopwatch(lambda: 0.0)
    )
    motion = task_motion(corridor, segway, task, config.motion)
    assert (prepare_search(query, corridor, motion).problem.departure is not None) == checked


def test_a_base_pose_is_compared_once_with_each_blocked_one(
    corridor: Scene, segway: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared: list[tuple[bytes, bytes]] = []
    original = base_paths.leads_straight

    def spied(nav_map: NavigationMap, one: np.ndarray, other: np.ndarray) -> bool:
        compared.append((one.tobytes(), other.tobytes()))
        return original(nav_map, one, other)

    monkeypatch.setattr(base_paths, "leads_straight", spied)
    assert plan_cabinet(corridor, segway, 1.57).search.blocked_in
    assert len(compared) > 10
    assert len(set(compared)) == len(compared)


def test_few_missing_paths_are_planned(
    tmp_path: Path, segway: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disc passes the open door but the robot does not; most poses beyond it reach the task."""
    mug = ', {"name": "mug", "pose": {"xyz": [3.3, -0.1, 0.9]}, "box": [0.06, 0.06, 0.1]}'
    room = corridor_room(tmp_path, end=4.0, extra=mug).with_joint("cabinet", "hinge", 1.2)
    floor = np.array([[-4.0, -1.4], [4.0, -1.4], [4.0, 0.1], [-4.0, 0.1]])
    found: list[bool] = []

    def spied(nav_map: NavigationMap, start: np.ndarray, goal: np.ndarray) -> BasePath | None:
        path = plan_path(nav_map, start, goal)
        found.append(path is not None)
        return path

    monkeypatch.setattr(base_paths, "plan_path", spied)
    scene, task = replace(room, floor_polygon=floor), make_task(room, "pick", "mug")
    plan = plan_base_placement(scene, segway, task, Everywhere(), start=START, config=QUICK).plan
    assert plan.status == "infeasible"
    cut_off = plan.candidates.rejections["no base path with the arm at home"]
    assert 0 < 8 * len(found) < cut_off
    assert not any(found)
