"""An object lifted and carried by friction stays in the hand, and the arm bears its weight."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.simulation.toy import execute

from momapos.core.geometry.transforms import rotation_angle
from momapos.model.records.plans import Motion
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene_files import load_scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.reachability.map_store import load_reach_map
from momapos.simulation.arm_control import SensedForces
from momapos.simulation.config import Ending, ExecutionConfig, FurnitureConfig, Stage
from momapos.simulation.execution_run import Payload
from momapos.simulation.run_record import Execution
from momapos.simulation.simulation import Simulation

STEP, WEIGHT = 0.004, np.array([0.0, 0.0, -5.0])


def carried_out(
    verb: str, name: str, robot: Robot, cache: Path, config: ExecutionConfig, **options: Any
) -> tuple[Execution, Motion]:
    """Plan a task in a built-in kitchen and execute it at the planned base pose."""
    scene = load_scene("kitchen_small")
    task = make_task(scene, verb, name)
    plan = plan_base_placement(scene, robot, task, load_reach_map(robot, cache)).plan
    rng = np.random.default_rng(0)
    return (
        execute(scene, robot, plan.base_pose, plan.motion, task, config, rng, **options),
        plan.motion,
    )


def test_a_picked_object_is_lifted_as_planned_and_stays_in_the_hand(
    tmp_path: Path, segway: Robot
) -> None:
    heavy = ExecutionConfig(furniture=FurnitureConfig(density=400.0))
    done, motion = carried_out("pick", "cereal_box", segway, tmp_path, heavy)
    assert done.success, done.reason
    assert (done.hold, done.ending) == ("contact", Ending.DONE)
    assert done.resistance["mass"] > 0.8
    lift = motion.Ts_world_tool[-1, 2, 3] - motion.Ts_world_tool[0, 2, 3]
    assert done.reached - done.start == pytest.approx(lift, abs=1.5e-3)  # the arm does not sag
    assert done.slip.position < 2e-3


def test_a_placed_object_stays_in_the_hand_until_it_stands_at_its_goal(
    tmp_path: Path, fetch: Robot
) -> None:
    seen: list[tuple[bool, np.ndarray]] = []

    def watch(world: Simulation, _: float, stage: Stage) -> None:
        if stage is Stage.APPROACH:
            held = np.linalg.inv(world.T_world_tool) @ world.T_world_part
            seen.append((world.welded, held))

    done, _ = carried_out("place", "bottle", fetch, tmp_path, ExecutionConfig(), watch=watch)
    assert done.success, done.reason
    assert not any(welded for welded, _ in seen)
    first, last = seen[0][1], seen[-1][1]
    assert np.linalg.norm(last[:3, 3] - first[:3, 3]) < 2e-3
    assert rotation_angle(first[:3, :3], last[:3, :3]) < np.radians(2.0)


def felt(force: np.ndarray, torque: np.ndarray) -> SensedForces:
    """Return sensed forces without a load on the pads."""
    return SensedForces(force, torque, (0.0, 0.0), np.zeros(0))


def test_the_hand_yields_to_a_push_and_not_to_the_carried_weight() -> None:
    load, torque = Payload(0.15, STEP), np.array([0.1, -0.2, 0.0])
    for _ in range(500):
        rest = load.remove_weight(felt(WEIGHT, torque), carried=True)
    np.testing.assert_allclose(rest.force, 0.0, atol=1e-3)
    np.testing.assert_allclose(rest.torque, 0.0, atol=1e-3)
    push = np.array([10.0, 0.0, 0.0])
    np.testing.assert_allclose(
        load.remove_weight(felt(WEIGHT + push, torque), carried=True).force, push, atol=1e-3
    )


def test_an_upward_push_is_no_weight_and_an_empty_hand_carries_none() -> None:
    load = Payload(0.15, STEP)
    for _ in range(500):
        rest = load.remove_weight(felt(-WEIGHT, np.ones(3)), carried=True)
    np.testing.assert_allclose(rest.force, -WEIGHT)
    for _ in range(500):
        load.remove_weight(felt(WEIGHT, np.zeros(3)), carried=True)
    assert load.weight[2] == pytest.approx(-5.0, abs=1e-3)
    np.testing.assert_allclose(
        load.remove_weight(felt(WEIGHT, np.zeros(3)), carried=False).force, WEIGHT
    )
    np.testing.assert_allclose(load.weight, 0.0)
