"""Laws of what follows a task: the robot can drive on, wherever there is such a base pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import Everywhere, corridor_room

from momapos.apps.cli.console import summary
from momapos.core.stopwatch import Stopwatch
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning import base_paths as drives
from momapos.planning.base_paths import WaysOn
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.tasks import make_task
from momapos.planning.navigation.footprint_map import NavigationMap, build_navigation_map
from momapos.planning.navigation.global_path import BasePath, plan_path
from momapos.planning.placement.config import Method, PlaceConfig
from momapos.planning.plan import plan_base_placement
from momapos.planning.query import PlacementQuery
from momapos.planning.result import PlacementResult
from momapos.planning.search_setup import ready_search

QUICK = PipelineConfig(place=PlaceConfig(count=256, improve=1, grid=False), timeout=300.0)
START = np.array([-2.8, -0.8, 0.0])


@pytest.fixture(scope="module")
def corridor(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return corridor_room(tmp_path_factory.mktemp("corridor"))


@pytest.fixture(scope="module")
def segway(robots: Callable[[str], Robot]) -> Robot:
    return robots("segway_ur5e")


def ask(scene: Scene, robot: Robot, to: float, start: np.ndarray = START) -> PlacementResult:
    task = make_task(scene, "open", "cabinet", to=to)
    return plan_base_placement(scene, robot, task, Everywhere(), start=start, config=QUICK)


def way_out(answer: PlacementResult, robot: Robot, goal: np.ndarray = START) -> bool:
    """Whether a way leads from the base pose to where the robot came from, past the open door."""
    task, scene = answer.plan.task, answer.prepared.scene
    assert task.joint is not None
    assert task.to is not None
    assert answer.plan.base_pose is not None
    after = scene.with_joint(task.object, task.joint, task.to)
    base = np.array(answer.plan.base_pose)
    return plan_path(build_navigation_map(after, robot), base, goal) is not None


def test_a_door_that_would_shut_the_robot_in_is_opened_from_its_other_side(
    corridor: Scene, segway: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = ask(corridor, segway, 1.2)
    assert answer.plan.status == "solved"
    assert way_out(answer, segway)
    assert not answer.search.shut_in
    assert "afterward" not in summary(answer, None)
    with monkeypatch.context() as patch:
        patch.setattr(WaysOn, "__call__", lambda _self, _base: True)
        unasked = ask(corridor, segway, 1.2)
    assert unasked.plan.status == "solved"
    assert not way_out(unasked, segway)


def test_no_answer_is_lost_where_every_base_pose_shuts_the_robot_in(
    corridor: Scene, segway: Robot
) -> None:
    answer = ask(corridor, segway, 1.57)
    assert answer.plan.status == "solved"
    assert not way_out(answer, segway)
    assert answer.search.shut_in
    assert answer.touched_after == ""
    assert "the base cannot drive on from there: cabinet" in summary(answer, None)


def test_a_start_that_the_open_door_comes_near_is_no_goal_of_the_way_out(
    corridor: Scene, segway: Robot
) -> None:
    start = np.array([0.0, -0.95, 0.0])
    answer = ask(corridor, segway, 1.2, start)
    assert answer.plan.status == "solved"
    assert not way_out(answer, segway, start)
    assert not answer.search.shut_in
    assert way_out(answer, segway)


@pytest.mark.parametrize(
    ("method", "way_on", "asked"),
    [
        ("ours", True, True),
        ("ours", False, False),
        ("exhaustive", True, False),
        ("m3", True, False),
    ],
)
def test_base_poses_are_asked_for_a_way_on_where_it_counts(
    corridor: Scene, segway: Robot, method: Method, way_on: bool, asked: bool
) -> None:
    """The cheapest pose of the grid is that, and other methods choose as they do."""
    config = PipelineConfig(place=PlaceConfig(method=method, way_on=way_on))
    task = make_task(corridor, "open", "cabinet", to=1.2)
    query = PlacementQuery(
        corridor, segway, task, Everywhere(), START, None, config, 0, Stopwatch(lambda: 0.0)
    )
    motion = task_motion(corridor, segway, task, config.motion)
    assert (ready_search(query, corridor, motion).problem.leads_on is not None) == asked


def test_base_poses_are_compared_once_with_each_that_shuts_the_robot_in(
    corridor: Scene, segway: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared: list[tuple[bytes, bytes]] = []
    beside = drives.leads_straight

    def spied(nav_map: NavigationMap, one: np.ndarray, other: np.ndarray) -> bool:
        compared.append((one.tobytes(), other.tobytes()))
        return beside(nav_map, one, other)

    monkeypatch.setattr(drives, "leads_straight", spied)
    assert ask(corridor, segway, 1.57).search.shut_in
    assert len(compared) > 10
    assert len(set(compared)) == len(compared)


def test_that_no_way_leads_to_a_place_is_told_few_times(
    tmp_path: Path, segway: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disc passes the open door, the robot does not, and most base poses beyond do the task."""
    mug = ', {"name": "mug", "pose": {"xyz": [3.3, -0.1, 0.9]}, "box": [0.06, 0.06, 0.1]}'
    room = corridor_room(tmp_path, end=4.0, extra=mug).with_joint("cabinet", "hinge", 1.2)
    floor = np.array([[-4.0, -1.4], [4.0, -1.4], [4.0, 0.1], [-4.0, 0.1]])
    told: list[bool] = []

    def spied(nav_map: NavigationMap, start: np.ndarray, goal: np.ndarray) -> BasePath | None:
        path = plan_path(nav_map, start, goal)
        told.append(path is not None)
        return path

    monkeypatch.setattr(drives, "plan_path", spied)
    scene, task = replace(room, floor_polygon=floor), make_task(room, "pick", "mug")
    plan = plan_base_placement(scene, segway, task, Everywhere(), start=START, config=QUICK).plan
    assert plan.status == "infeasible"
    cut_off = plan.candidates.rejections["no way to drive there with the arm at home"]
    assert 0 < 10 * len(told) < cut_off
    assert not any(told)
