"""Test the cost of base poses and its weights."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of
from tests.rooms import Everywhere

from momapos.apps.cli.main import main
from momapos.core.stopwatch import Stopwatch
from momapos.model.collision.arm_collision import FREE
from momapos.model.collision.base_collision import base_hits
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.records.plans import PlacementPlan, Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import iter_placements, plan_base_placement
from momapos.planning.placement.area import PlacementGeometry
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.placement.pose_cost import missing_clearance
from momapos.planning.placement.pose_search import iter_searches, search
from momapos.planning.query import PlacementQuery
from momapos.planning.reachability.map_store import load_reach
from momapos.planning.search_setup import prepare_search

NAMES = ["driving", "room", "clearance", "manipulability", "effort"]
WORDS = ["place", "open", "kitchen_small", "cabinet_right/drawer_middle_slide"]


@pytest.fixture(scope="module")
def task(kitchen: Scene) -> Task:
    return make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide")


def total(plan: PlacementPlan, place: PlaceConfig) -> float:
    """Return a plan's cost under the given weights, which may differ from its own."""
    weights = {"room": "robustness"}
    terms = (
        (term.value, getattr(place, f"weight_{weights.get(name, name)}"))
        for name, term in plan.cost.items()
    )
    return sum(value * weight for value, weight in terms if weight and value is not None)


def test_the_base_is_free_with_the_clearance_it_has(geometry: PlacementGeometry) -> None:
    rng = np.random.default_rng(3)
    poses = np.stack([rng.uniform(-2, 2, 200), rng.uniform(-3, 0, 200), rng.uniform(-3, 3, 200)], 1)
    missing = missing_clearance(geometry, poses)
    assert 0.0 <= missing.min() < 0.05 < missing.max() <= 0.2
    robot = geometry.robot.base
    for boxes in (geometry.static, geometry.sweep):
        clearance = 0.2 - missing
        clear = np.array([
            base_hits(pose[None], robot, boxes, clearance=max(one - 1e-9, 0.0))[0] == FREE
            for pose, one in zip(poses, clearance, strict=True)
        ])  # fmt: skip
        assert clear[clearance > 0].all()


def test_a_plan_names_each_term_with_its_value_and_weight(tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    words = ["--robot", "segway_ur5e", "--set", "place.weight_effort=0.5", "--out", str(file)]
    assert main([*WORDS, *words]) == 0
    plan = read_plan(file)
    assert list(plan.cost) == NAMES
    assert [term.weight for term in plan.cost.values()] == [1.0, None, 0.0, 0.0, 0.5]
    assert plan.cost["driving"].value == pytest.approx(plan.navigation_cost)
    moved = np.abs(np.diff(plan.motion.q, axis=0)).sum()  # it has no prismatic joint
    assert plan.cost["effort"].value == pytest.approx(moved)
    assert all(term.value is not None and term.value >= 0.0 for term in plan.cost.values())


def test_no_grid_pose_costs_less_than_the_solution(
    kitchen: Scene, segway: Robot, task: Task
) -> None:
    grid = PlaceConfig(method="exhaustive", grid_cell=0.2, grid_turn=30.0, weight_robustness=0.0)
    weighed = replace(grid, weight_effort=0.2, weight_manipulability=0.5, weight_clearance=1.0)
    config = PipelineConfig(place=weighed, timeout=300.0)
    query = PlacementQuery(
        kitchen, segway, task, Everywhere(), config=config, watch=Stopwatch(lambda: 0.0)
    )
    ready = prepare_search(query, kitchen, task_motion(kitchen, segway, task, config.motion))
    least = total(
        ready.result(search(ready.problem, weighed, np.random.default_rng(0))).plan, weighed
    )
    costs = [
        total(ready.result(replace(found)).plan, weighed)
        for found in iter_searches(ready.problem, grid, np.random.default_rng(0))
    ]
    assert len(costs) > 20
    assert min(costs) < costs[0] - 0.1  # the first is the nearest, which is not the cheapest
    assert least <= min(costs) + 1e-6


def test_without_weight_on_robustness_the_drive_is_shorter(kitchen: Scene, segway: Robot) -> None:
    reach = load_reach(segway, None)
    cheapest = PipelineConfig(place=PlaceConfig(weight_robustness=0.0))
    driven = []
    for name, joint in [("fridge", "door_hinge"), ("cabinet_left", "drawer_slide")]:
        task = make_task(kitchen, "open", name, joint)
        usual, near = (
            plan_base_placement(kitchen, segway, task, reach, config=config).plan.navigation_cost
            for config in (PipelineConfig(), cheapest)
        )
        driven.append((usual, near))
    assert sum(near for _, near in driven) < sum(usual for usual, _ in driven)


def test_further_solutions_come_in_order_of_cost(kitchen: Scene, segway: Robot, task: Task) -> None:
    place = PlaceConfig(count=1024, rounds=1, grid=False, weight_robustness=0.0, weight_effort=1.0)
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
    "setting",
    [
        "place.weight_robustness=-1", "place.weight_driving=inf", "place.weight_effort=nan",
        "place.weight_robustness=nan",
    ],
)  # fmt: skip
def test_an_invalid_weight_is_reported_in_one_line(setting: str) -> None:
    assert f"--set {setting.partition('=')[0]} must be" in error_of(*WORDS, "--set", setting)
