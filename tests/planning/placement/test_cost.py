"""Laws of what base poses cost, and of the weights by which they are ordered."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import Everywhere

from momapos.apps.cli.main import main
from momapos.core.stopwatch import Stopwatch
from momapos.model.collision.arm_collision import FREE
from momapos.model.collision.base_collision import base_hits
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.records.plans import PlacementPlan
from momapos.model.records.tasks import Task
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.tasks import make_task
from momapos.planning.iterate import iter_placements
from momapos.planning.placement.area import PlacementGeometry
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.placement.pose_cost import missing_clearance
from momapos.planning.placement.pose_search import search, search_every
from momapos.planning.plan import plan_base_placement
from momapos.planning.query import PlacementQuery
from momapos.planning.reachability.map_store import load_reach
from momapos.planning.search_setup import ready_search

NAMES = ["driving", "room", "clearance", "manipulability", "effort"]
WORDS = ["place", "open", "kitchen_small", "cabinet_right/drawer_middle_slide"]


@pytest.fixture(scope="module")
def kitchen() -> Scene:
    return load_scene("kitchen_small")


@pytest.fixture(scope="module")
def segway() -> Robot:
    return load_robot("segway_ur5e")


@pytest.fixture(scope="module")
def task(kitchen: Scene) -> Task:
    return make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide")


def total(plan: PlacementPlan, place: PlaceConfig) -> float:
    """What a plan costs by some weights; its own may be others."""
    terms = ((term.value, getattr(place, f"weight_{name}")) for name, term in plan.cost.items())
    return sum(value * weight for value, weight in terms if weight and value is not None)


def test_clearance_lacks_what_the_base_hits_with_it(geometry: PlacementGeometry) -> None:
    rng = np.random.default_rng(3)
    poses = np.stack([rng.uniform(-2, 2, 200), rng.uniform(-3, 0, 200), rng.uniform(-3, 3, 200)], 1)
    lacks = missing_clearance(geometry, poses)
    assert 0.0 <= lacks.min() < 0.05 < lacks.max() <= 0.2
    robot = geometry.robot.base
    for boxes in (geometry.static, geometry.sweep):
        kept = 0.2 - lacks
        clear = np.array([
            base_hits(pose[None], robot, boxes, clearance=max(room - 1e-9, 0.0))[0] == FREE
            for pose, room in zip(poses, kept, strict=True)
        ])  # fmt: skip
        assert clear[kept > 0].all()


def test_a_plan_names_each_term_with_its_value_and_weight(tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    words = ["--robot", "segway_ur5e", "--weight-effort", "0.5", "--out", str(file)]
    assert main([*WORDS, *words]) == 0
    plan = read_plan(file)
    assert list(plan.cost) == NAMES
    assert [term.weight for term in plan.cost.values()] == [1.0, None, 0.0, 0.0, 0.5]
    assert plan.cost["driving"].value == pytest.approx(plan.navigation_cost)
    assert plan.motion is not None
    moved = np.abs(np.diff(plan.motion.q, axis=0)).sum()  # no joint of it slides
    assert plan.cost["effort"].value == pytest.approx(moved)
    assert all(term.value is not None and term.value >= 0.0 for term in plan.cost.values())


def test_of_the_grid_no_base_pose_costs_less_than_the_answer(
    kitchen: Scene, segway: Robot, task: Task
) -> None:
    grid = PlaceConfig(method="exhaustive", grid_cell=0.2, grid_turn=30.0, weight_room=0.0)
    weighed = replace(grid, weight_effort=0.2, weight_manipulability=0.5, weight_clearance=1.0)
    config = PipelineConfig(place=weighed, timeout=300.0)
    query = PlacementQuery(
        kitchen, segway, task, Everywhere(), None, None, config, 0, Stopwatch(lambda: 0.0)
    )
    ready = ready_search(query, kitchen, task_motion(kitchen, segway, task, config.motion))
    least = total(
        ready.result(search(ready.problem, weighed, np.random.default_rng(0))).plan, weighed
    )
    costs = [
        total(ready.result(replace(found)).plan, weighed)
        for found in search_every(ready.problem, grid, np.random.default_rng(0))
    ]
    assert len(costs) > 20
    assert min(costs) < costs[0] - 0.1  # the first is the nearest, which is not the cheapest
    assert least <= min(costs) + 1e-6


def test_without_weight_on_room_less_is_driven(kitchen: Scene, segway: Robot) -> None:
    reach = load_reach(segway, None)
    cheapest = PipelineConfig(place=PlaceConfig(weight_room=0.0))
    driven = []
    for name, joint in [("fridge", "door_hinge"), ("cabinet_left", "drawer_slide")]:
        asked = make_task(kitchen, "open", name, joint)
        usual, near = (
            plan_base_placement(kitchen, segway, asked, reach, config=config).plan.navigation_cost
            for config in (PipelineConfig(), cheapest)
        )
        assert usual is not None
        assert near is not None
        driven.append((usual, near))
    assert sum(near for _, near in driven) < sum(usual for usual, _ in driven)


def test_further_answers_come_in_the_order_of_their_cost(
    kitchen: Scene, segway: Robot, task: Task
) -> None:
    place = PlaceConfig(count=1024, rounds=1, grid=False, weight_room=0.0, weight_effort=1.0)
    config = PipelineConfig(place=place, timeout=300.0)
    given = iter_placements(kitchen, segway, task, Everywhere(), config=config)
    plans = [answer.plan for answer in islice(given, 12)][1:]
    given.close()  # type: ignore[attr-defined]
    costs = [total(plan, place) for plan in plans]
    assert len(costs) == 11
    assert all(before <= after + 1e-6 for before, after in pairwise(costs))
    driven = [plan.navigation_cost or 0.0 for plan in plans]
    assert any(before > after for before, after in pairwise(driven))


@pytest.mark.parametrize(
    "words",
    [
        ["--weight-room", "-1"], ["--weight-driving", "inf"], ["--weight-effort", "nan"],
        ["--weight-room", "nan"],
    ],
)  # fmt: skip
def test_what_is_no_weight_is_one_line(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*WORDS, *words]) == 2
    said = capsys.readouterr().err
    assert words[0].strip("-") in said
    assert said.count("\n") == 1
