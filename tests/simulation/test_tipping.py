"""A run watches where the floor's reaction acts, and fails where the base would tip over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from momapos.model.records.plans import PlacementPlan
from momapos.model.robots.load_limits import robot_loads
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.reachability.map_store import load_reach_map
from momapos.simulation import simulation
from momapos.simulation.config import Ending, Stage
from momapos.simulation.execution_run import Tipping
from momapos.simulation.run_record import RunRecord
from momapos.simulation.simulation import Simulation
from momapos.workflows.run import run_plan

Robots = Callable[[str], Robot]


@pytest.fixture(scope="module")
def drawer(kitchen: Scene, segway: Robot) -> PlacementPlan:
    task = make_task(kitchen, "open", "cabinet_right", "drawer_top_slide", 0.15)
    return plan_base_placement(kitchen, segway, task).plan


def run(plan: PlacementPlan, robot: Robot, **options: object) -> RunRecord:
    return run_plan(
        plan,
        load_scene("kitchen_small"),
        robot,
        load_reach_map(robot),
        **options,  # type: ignore[arg-type]
    )


def test_the_floor_reacts_where_statics_say(drawer: PlacementPlan, segway: Robot) -> None:
    loads, seen = robot_loads(segway), []

    def watch(world: Simulation, _: float, stage: Stage) -> None:
        if stage in (Stage.SETTLE, Stage.GRIP):  # nearly at rest
            tipping = Tipping(world, 1.0)
            tipping.update()
            q = segway.chain.freedom_values(world.data.qpos[world.arm_q])
            seen.append((tipping.stability, loads.at(q[None]).stability[0]))

    done = run(drawer, segway, watch=watch)
    assert done.success, done.reason
    measured, expected = np.array(seen).T
    assert len(seen) > 20
    np.testing.assert_allclose(np.median(measured - expected), 0.0, atol=2e-3)
    assert 0.0 < done.execution.stability < measured.max()


def test_a_base_that_tips_over_fails_the_run(
    drawer: PlacementPlan, monkeypatch: pytest.MonkeyPatch, segway: Robot
) -> None:
    axle = np.array([[-0.1, -0.3], [-0.05, -0.3], [-0.05, 0.3], [-0.1, 0.3]])
    monkeypatch.setattr(simulation, "_support", lambda _: axle)
    done = run(drawer, segway, tries=1)
    assert not done.success
    assert Ending.TIPS_OVER in done.reason


def test_a_robot_without_masses_of_its_base_is_not_judged(
    drawer: PlacementPlan, monkeypatch: pytest.MonkeyPatch, segway: Robot
) -> None:
    monkeypatch.setattr(simulation, "_support", lambda _: None)
    done = run(replace(drawer), segway)
    assert done.success
    assert done.execution.stability is None


def test_a_base_that_is_pulled_off_the_floor_tips_over_and_its_record_stays_finite(
    drawer: PlacementPlan, segway: Robot
) -> None:
    """Its wheels bear nothing, so no zero moment point exists."""
    seen: list[tuple[bool, float | None]] = []

    def lift(world: Simulation, _: float, stage: Stage) -> None:
        if stage is Stage.GRIP and not seen:
            tipping = Tipping(world, 0.01)
            tipping.update()
            gravity = world.model.opt.gravity.copy()
            world.model.opt.gravity[:] = -gravity  # everything pulls up
            for _ in range(100):
                tipping.update()
            world.model.opt.gravity[:] = gravity
            seen.append((tipping.tips, tipping.stability))

    run(drawer, segway, watch=lift, tries=1)
    ((tips, stability),) = seen
    assert tips
    assert -1.0 <= stability < 0.0
