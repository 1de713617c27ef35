"""The exact check measures efforts and stability on its own, and finds what the planner finds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos.core.units import GRAVITY
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.plans import MOVING_PULL, JointResistance, PlacementPlan
from momapos.model.robots.load_limits import robot_loads
from momapos.model.robots.robot import Robot
from momapos.model.scene.resistance_config import ResistanceConfig
from momapos.model.scene.scene_files import load_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.motion_loads import CarriedLoad, MeasuredLoads, robot_efforts
from momapos.verification.path_checks import DensePath
from momapos.verification.plan_check import verify_files
from momapos.verification.report import DEFAULT
from momapos.verification.robot_collision_model import robot_collision_model

Robots = Callable[[str], Robot]


@pytest.mark.parametrize("name", ["fetch", "stretch", "segway_ur5e"])
def test_it_agrees_with_the_planner_at_any_state_and_load(name: str, robots: Robots) -> None:
    robot = robots(name)
    model = robot_collision_model(robot)
    judge = robot_efforts(robot.model, model.bodies, robot.base_link, model.joints)
    rng, chain = np.random.default_rng(1), robot.chain
    low, high = (np.clip(end, -3.0, 3.0) for end in (chain.lower, chain.upper))
    q = rng.uniform(low, high, (40, chain.size))
    force, point = rng.normal(0.0, 20.0, (40, 3)), rng.normal(0.0, 0.5, (40, 3))
    Ts = model.body_poses((0.0, 0.0, 0.0), chain.joint_values(q))
    planned = robot_loads(robot).at(q, force, point)
    np.testing.assert_allclose(judge.efforts(Ts, force, point), planned.efforts, atol=1e-6)
    stability = judge.stability((0.0, 0.0, 0.0), Ts, force, point)
    assert stability is not None
    inside = planned.stability > 0
    np.testing.assert_allclose(stability[inside], planned.stability[inside], atol=1e-6)
    assert (stability[~inside] <= 0).all()


def test_the_sign_of_an_effort_does_not_count(robots: Robots) -> None:
    robot = robots("fetch")
    model = robot_collision_model(robot)
    judge = robot_efforts(robot.model, model.bodies, robot.base_link, model.joints)
    needs = np.zeros((3, len(judge.names)))
    needs[1, 2] = -1.2 * judge.limits[2]
    needs[2, 3] = 0.5 * judge.limits[3]
    path = DensePath(np.zeros((3, 1)), np.zeros(3), np.arange(3.0), 0)
    for sign in (1.0, -1.0):
        loads = MeasuredLoads(judge, sign * needs, None, np.zeros(3))
        assert loads.record(None).worst == (judge.names[2], pytest.approx(1.2))
        effort = loads.checks(path, DEFAULT)[0]
        assert (effort.value, effort.culprit) == (pytest.approx(120.0), judge.names[2])
        assert not effort.ok


@pytest.fixture(scope="module")
def opened(robots: Robots) -> PlacementPlan:
    scene = load_scene("kitchen_small")
    task = make_task(scene, "open", "fridge", "door_hinge")
    plan = plan_base_placement(scene, robots("fetch"), task).plan
    assert plan.status == "solved"
    return plan


def test_a_plan_holds_its_worst_loads(opened: PlacementPlan, tmp_path: Path) -> None:
    loads = opened.loads
    assert loads is not None
    assert loads.payload is None
    assert set(loads.efforts) == set(opened.joints)
    assert loads.worst == ("torso_lift_joint", pytest.approx(0.632, abs=0.02))
    assert loads.stability == pytest.approx(0.2, abs=0.06)
    assert str(loads).startswith("torso_lift_joint needs 63 % of its effort limit; ")
    write_plan(opened, tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json").loads == loads
    report = verify_files(tmp_path / "plan.json")
    assert report.valid
    effort = next(check for check in report.checks if check.name == "joint effort")
    assert effort.value == pytest.approx(100 * max(loads.efforts.values()), abs=0.1)


def test_a_stiffer_door_needs_more_and_tips_the_robot(
    opened: PlacementPlan, robots: Robots
) -> None:
    assert opened.motion is not None
    assert opened.base_pose is not None
    scene, robot = load_scene("kitchen_small"), robots("fetch")

    def failed(seal: float) -> list[str]:
        stiff = {"fridge": {"door_hinge": JointResistance(seal_force=seal)}}
        verifier = PlanVerifier(scene.with_resistance(stiff), robot, opened.task)
        assert opened.motion is not None
        assert opened.base_pose is not None
        return [one.name for one in verifier.check(opened.base_pose, opened.motion).violations]

    assert failed(30.0) == []
    assert "joint effort" in failed(150.0)
    assert {"joint effort", "tipping over"} <= set(failed(600.0))


def test_a_payload_adds_its_weight_where_it_is_held(robots: Robots) -> None:
    scene, robot = load_scene("kitchen_small"), robots("husky_ur5e")
    task = make_task(scene, "pick", "apple")
    plan = plan_base_placement(scene, robot, task).plan
    assert plan.motion is not None
    assert plan.base_pose is not None
    assert plan.loads is not None
    assert plan.loads.payload == pytest.approx(0.5)

    def lift(mass: float) -> float:
        loads = PlanVerifier(scene.with_mass("apple", mass), robot, task).loads(
            plan.base_pose, replace(plan.motion, approach=plan.motion.q[:1])
        )
        assert loads.payload == mass
        return 150.0 * loads.efforts["shoulder_lift_joint"]

    T_base = np.array([*plan.base_pose[:2], 0.0])
    level = np.linalg.norm(plan.motion.Ts_world_tool[:, :2, 3] - T_base[:2], axis=1)
    added = (lift(4.0) - lift(1.0)) / (3.0 * GRAVITY)
    assert 0.5 * level.min() < added < 1.5 * level.max()


def test_a_part_pulls_more_on_a_hand_whose_base_moves(
    opened: PlacementPlan, robots: Robots
) -> None:
    """Planner and exact check add the same force, along the path of the hand."""
    motion, scene = opened.motion, load_scene("kitchen_small")
    assert motion is not None
    assert opened.base_pose is not None
    load = CarriedLoad(scene.object("fridge"), opened.task, ResistanceConfig())
    count, held = len(motion.q), motion.grasps[0]
    path = DensePath(motion.q, motion.object_q, np.arange(count, dtype=float), 0)
    rests = np.tile(opened.base_pose, (count, 1))
    moves = rests + np.outer(np.linspace(0.0, 0.1, count), [1.0, 0.0, 0.0])
    pull, at_rest, moving = (
        load.along(replace(motion, base=base), path, motion.Ts_world_tool)[0]
        for base in (None, rests, moves)
    )
    np.testing.assert_array_equal(at_rest, pull)
    more = (moving - pull)[held.first : held.last + 1]
    np.testing.assert_allclose(np.linalg.norm(more, axis=1), MOVING_PULL, rtol=0.02)
    hand = np.gradient(motion.Ts_world_tool[held.first : held.last + 1, :3, 3], axis=0)
    along = (more * hand).sum(1) / np.linalg.norm(hand, axis=1)
    np.testing.assert_allclose(along, -MOVING_PULL, rtol=0.02)
    planned = task_motion(scene, robots("fetch"), opened.task, PipelineConfig().motion)
    usual, _ = planned.hand_loads
    more_pull, _ = replace(planned, more_pull=MOVING_PULL).hand_loads
    added = np.linalg.norm(more_pull - usual, axis=-1)[:, planned.closed]
    np.testing.assert_allclose(added, MOVING_PULL, rtol=0.02)
