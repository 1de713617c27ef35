"""Laws of runs of plans whose base moves."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.moving_base import arc, on_moving_base

from momapos.core.geometry.transforms import compose, local_points
from momapos.core.stopwatch import Stopwatch
from momapos.model.records.plans import PlacementPlan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.base_use import plan_moving
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.navigation.driving import DriveRecord
from momapos.planning.navigation.footprint_map import build_navigation_map
from momapos.planning.query import PlacementQuery
from momapos.planning.reachability.map_store import load_reach_map
from momapos.planning.reachability.reach_map import ReachMap
from momapos.simulation.config import ExecutionConfig
from momapos.verification.exact_check import PlanVerifier
from momapos.workflows.joint_belief import JointBeliefs
from momapos.workflows.replanning import MIN_POSE_DISTANCE, Replanner, motion_from
from momapos.workflows.run import run_plan


@pytest.fixture(scope="module")
def reach(segway: Robot, tmp_path_factory: pytest.TempPathFactory) -> ReachMap:
    return load_reach_map(segway, tmp_path_factory.mktemp("maps"))


@pytest.fixture(scope="module")
def plan(kitchen: Scene, segway: Robot, reach: ReachMap) -> PlacementPlan:
    """Return a plan that opens a drawer while the base drives a little back."""
    task = make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide")
    found = plan_base_placement(kitchen, segway, task, reach).plan
    base = arc(found.base_pose, -0.06, 0.05, len(found.motion.q))
    moves = on_moving_base(found, segway, base)
    assert (
        PlanVerifier(kitchen, segway, task).first_violation(found.base_pose, moves.motion) is None
    )
    return moves


def off(plan: PlacementPlan, by: list[float]) -> np.ndarray:
    """Return a pose ahead, to the left of, and turned from a plan's base pose."""
    return np.asarray(compose(np.array(plan.base_pose), np.array([by]))[0])


def test_the_base_path_moves_with_the_base_and_the_hand_stays(
    kitchen: Scene, segway: Robot, plan: PlacementPlan
) -> None:
    here = off(plan, [0.01, -0.008, 0.01])
    moved = motion_from(plan, kitchen, segway, here).motion
    np.testing.assert_allclose(moved.base[0], here, atol=1e-12)
    for one, other in ((moved, here), (plan.motion, np.array(plan.base_pose))):
        relative = local_points(other, one.base[:, :2])
        np.testing.assert_allclose(
            relative, local_points(plan.motion.base[0], plan.motion.base[:, :2]), atol=1e-9
        )
    np.testing.assert_allclose(moved.Ts_world_tool, plan.motion.Ts_world_tool, atol=2e-4)
    np.testing.assert_allclose(moved.approach[0], plan.motion.approach[0])


def test_a_base_that_stopped_too_far_away_has_no_motion_and_a_reason(
    kitchen: Scene, segway: Robot, plan: PlacementPlan
) -> None:
    attempt = motion_from(plan, kitchen, segway, off(plan, [-0.8, 0.0, 0.0]))
    assert attempt.motion is None
    assert "the arm does not reach" in attempt.reason
    into = motion_from(plan, kitchen, segway, off(plan, [0.3, 0.0, 0.0]))
    assert into.motion is None


def test_a_robot_that_stops_elsewhere_searches_again_with_a_moving_base(
    kitchen: Scene, stretch: Robot
) -> None:
    """A Stretch opens this microwave from no single base pose, and the plan does not reach it."""
    task = make_task(kitchen, "open", "microwave", "door_hinge")
    query = PlacementQuery.of(kitchen, stretch, task, clock=time.process_time)
    plan = plan_moving(query).plan
    assert plan.moves_base
    assert plan.motion is not None
    far, goals = off(plan, [-0.5, 0.0, 0.0]), []
    assert motion_from(plan, kitchen, stretch, far).motion is None

    def driver(_: Any, here: np.ndarray, goal: np.ndarray, __: Any) -> DriveRecord:
        goals.append(goal)
        there = far if len(goals) == 1 else goal
        return DriveRecord(
            True, "", goal, there, there, "", 1.0, 1.0, 1.0, 0.5, np.inf, 1, np.array([0.0, 1.0]),
            np.array([here, there]), np.zeros((2, 3)), np.zeros(1),
        )  # fmt: skip

    config = PipelineConfig()
    replanner = Replanner(
        build_navigation_map(kitchen, stretch), kitchen, plan, query.reach, driver, config,
        lambda _, __: None, Stopwatch(time.process_time), np.random.default_rng(0),
        initial=kitchen, beliefs=JointBeliefs((), ExecutionConfig().compliance),
    )  # fmt: skip
    assert plan.start is not None
    here, motion = replanner.drive_and_plan(np.array(plan.start), plan, 3)
    assert len(goals) == 2
    assert np.ptp(motion.base[:, :2], axis=0).max() > 0.05
    np.testing.assert_allclose(motion.base[0], here, atol=1e-9)
    assert "does not reach" in replanner.visits[0].reason
    assert np.hypot(*(goals[1] - far)[:2]) >= MIN_POSE_DISTANCE


def test_a_run_moves_the_base_and_ends_at_its_last_pose(
    kitchen: Scene, segway: Robot, reach: ReachMap, plan: PlacementPlan
) -> None:
    def driver(_: Any, here: np.ndarray, goal: np.ndarray, __: Any) -> DriveRecord:
        there = compose(goal, np.array([[0.004, 0.003, 0.005]]))[0]
        return DriveRecord(
            True, "", goal, there, there, "", 1.0, 1.0, 1.0, 0.5, np.inf, 1, np.array([0.0, 1.0]),
            np.array([here, there]), np.zeros((2, 3)), np.zeros(1),
        )  # fmt: skip

    record = run_plan(plan, kitchen, segway, reach, driver=driver, seed=1)
    assert record.success, record.reason
    assert len(record.visits) == 1
    np.testing.assert_allclose(record.final_base_pose, plan.final_base_pose, atol=0.03)
    still = replace(record, execution=replace(record.execution, final_base_pose=None))
    assert still.final_base_pose == record.visits[0].reached
