"""Motions with regrasping, rotating grasps or pushes, in physics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import furniture_room, hollow_door
from tests.simulation.toy import execute, gripping
from tests.verification.door_case import BASE

from momapos.model.records.plans import Hold, PlacementPlan
from momapos.model.robots.robot import Grip, Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.trajectory import still
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import GraspConfig, MotionConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import check_base_pose, plan_base_placement
from momapos.planning.reachability.map_store import load_reach_map
from momapos.simulation.arm_control import PacedTrajectory
from momapos.simulation.config import (
    BESIDE_SPEED,
    OBSERVED_DISTANCE,
    Ending,
    ExecutionConfig,
    HoldMethod,
    Stage,
)
from momapos.simulation.exact_run import run_exactly
from momapos.simulation.execution_run import ExecutionRun, Stretch
from momapos.simulation.geoms import HAND, Kind
from momapos.simulation.robot_dynamics import find_hand, read_dynamics
from momapos.simulation.simulated_room import PartResistance, Seal
from momapos.simulation.simulation import Simulation, build_simulation
from momapos.simulation.stages import carry_out

HOLDS = ("contact", pytest.param("weld", marks=pytest.mark.slow))


@pytest.fixture(scope="module")
def kitchen() -> Scene:
    return load_scene("kitchen_island")


@pytest.fixture(scope="module")
def plans(
    kitchen: Scene, tmp_path_factory: pytest.TempPathFactory, segway: Robot
) -> dict[str, PlacementPlan]:
    reach = load_reach_map(segway, tmp_path_factory.mktemp("maps"))
    return {
        name: plan_base_placement(
            kitchen, segway, make_task(kitchen, "open", name, "door_hinge"), reach
        ).plan
        for name in ("cabinet_back", "fridge")
    }


def within_reach(kitchen: Scene, plan: PlacementPlan) -> Scene:
    """Return the kitchen without what is more than 2 m from the base, for a fast simulation."""
    at = np.array(plan.base_pose[:2])
    low, high = (np.array([item.bounds[k, :2] for item in kitchen.objects]) for k in (0, 1))
    away = np.linalg.norm(np.maximum(np.maximum(low - at, at - high), 0.0), axis=1)
    near = [item for item, gap in zip(kitchen.objects, away, strict=True) if gap < 2.0]
    return replace(kitchen, objects=tuple(near))


@pytest.mark.parametrize(
    ("item", "hold"),
    [
        ("fridge", "contact"),
        pytest.param("fridge", "weld", marks=pytest.mark.slow),
        pytest.param("cabinet_back", "weld", marks=pytest.mark.slow),
    ],
)
def test_a_door_opens_with_two_grasps_or_a_rotating_grasp(
    item: str, hold: HoldMethod, kitchen: Scene, plans: dict[str, PlacementPlan], segway: Robot
) -> None:
    plan = plans[item]
    two, turns = len(plan.motion.holds) == 2, plan.motion.holds[0].turn_axis is not None
    assert (two, turns) == ((True, False) if item == "cabinet_back" else (False, True))
    done = execute(
        within_reach(kitchen, plan), segway, plan.base_pose, plan.motion,
        plan.task,
        ExecutionConfig(hold=hold), np.random.default_rng(0),
    )  # fmt: skip
    assert done.success, done.reason
    assert done.ending in (Ending.DONE, Ending.STOPPED_AT_END)
    assert done.hold == hold


@pytest.mark.slow
def test_a_hollow_door_follows_the_states_of_a_push(tmp_path: Path, fetch: Robot) -> None:
    """Pushed at its hull, it would stay behind the hand."""
    (_, parts) = hollow_door(tmp_path)
    scene = furniture_room(tmp_path, parts)
    task = make_task(scene, "open", "cupboard", "hinge", "80deg")
    plan = plan_base_placement(scene, fetch, task, load_reach_map(fetch, tmp_path)).plan
    assert [hold.family for hold in plan.motion.holds] == ["pinch", "push"]
    done = run_exactly(plan, scene, fetch).execution
    assert done.success, done.reason
    assert abs(np.degrees(done.reached) - 80.0) < 3.0


@pytest.mark.parametrize("hold", HOLDS)
def test_a_hook_slides_along_a_bar(hold: HoldMethod, tmp_path: Path, segway: Robot) -> None:
    scene = load_scene("kitchen_small")
    hooked, base = replace(segway, grips=Grip.HOOK), (0.300476, -1.502722, -3.024759)
    config = PipelineConfig(motion=MotionConfig(grasps=GraspConfig(turning=False)))
    task, reach = make_task(scene, "open", "fridge", "door_hinge"), load_reach_map(segway, tmp_path)
    motion = check_base_pose(
        scene, hooked, task, base, reach, how_far=False, config=config
    ).motion  # fmt: skip
    assert "after a slide" in motion.holds[1].words
    done = execute(
        scene, hooked, base, motion, task, ExecutionConfig(hold=hold), np.random.default_rng(0)
    )
    assert done.success, done.reason
    assert all(touch.force < 150.0 for touch in done.collisions)


def test_a_hand_that_grasped_with_an_offset_pushes_later_without_it(tmp_path: Path) -> None:
    toy, config = gripping(tmp_path), ExecutionConfig()
    dynamics, q = read_dynamics(toy.robot.model.urdf.path), toy.motion.q[0]
    hand = find_hand(toy.robot, dynamics.mimics)
    light = PartResistance(mass=5.0, friction=0.1, damping=0.1, pull=0.0)
    world = build_simulation(
        toy.scene, toy.robot, BASE, q[None], toy.task, hand, dynamics, light, None, config
    )
    free = Seal(0.0, 0.0, 0.0, 1.0)
    run = ExecutionRun(world, toy.motion, toy.task, config, free, None, world, None)
    # As found by the first grasp.
    run.lateral_offset, run.forward_offset = 0.024, np.array([0.03, 0.0, 0.0])
    there = PacedTrajectory(still(q, 1), np.ones(1), np.zeros(1), np.ones(1))
    push = Stretch(still(q, 1), toy.motion, Hold(0, 0, None, "push"))
    assert carry_out(run, there, [push]) is Ending.DONE


@pytest.mark.slow
def test_between_two_grasps_the_hand_is_slow_near_obstacles(
    kitchen: Scene, plans: dict[str, PlacementPlan], segway: Robot
) -> None:
    plan, config = plans["cabinet_back"], ExecutionConfig()
    ways: list[tuple[float, np.ndarray, bool]] = []

    def watch(world: Simulation, time: float, stage: Stage) -> None:
        contact = world.data.contact
        kinds = world.kinds[contact.geom[contact.dist < OBSERVED_DISTANCE]]
        beside = np.isin(kinds, HAND).any(1) & np.isin(kinds, (Kind.PART, Kind.ROOM)).any(1)
        near = bool(beside.any()) and stage is Stage.MANIPULATE
        ways.append((time, world.T_world_tool[:3, 3], near))

    assert len(plan.motion.holds) == 2
    done = execute(
        within_reach(kitchen, plan), segway, plan.base_pose, plan.motion,
        plan.task, config,
        np.random.default_rng(0), watch=watch,
    )  # fmt: skip
    assert done.success, done.reason
    assert done.ending in (Ending.DONE, Ending.STOPPED_AT_END)
    times, points = np.array([w[0] for w in ways]), np.array([w[1] for w in ways])
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(times)
    beside = np.array([w[2] for w in ways[1:]])
    assert beside.sum() > 100
    # The hand needs some time to brake near an obstacle, and returns to the plan meanwhile, where
    # obstacles are not checked.
    came = np.maximum.accumulate(np.where(beside, -np.inf, times[1:]))
    braked = beside & (times[1:] - came > 0.05)
    assert speed[braked].max() < 1.5 * BESIDE_SPEED
    assert speed.max() > 3.0 * BESIDE_SPEED
