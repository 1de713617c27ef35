"""Laws of the recovery from a failed motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.rooms import Everywhere

from momapos.core.geometry.transforms import apply, rotation_angle, rotation_of
from momapos.model.records.plans import JointResistance, PlacementPlan, Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import check_base_pose, plan_base_placement
from momapos.planning.navigation.driving import DriveRecord
from momapos.planning.task_setup import NO_OTHER_GRASP
from momapos.simulation.config import ExecutionConfig
from momapos.simulation.joint_estimate import Axis, LearnedPart
from momapos.simulation.simulation import Simulation
from momapos.workflows.replanning import (
    MIN_GRASP_ANGLE,
    MIN_GRASP_DISTANCE,
    arm_home_path,
    believed_scene,
    falls_closed,
    grasp_in_part,
    other_grasps,
    with_estimated_joint,
    without_pushes,
)
from momapos.workflows.run import run_plan

CONFIG = PipelineConfig()


@pytest.fixture(scope="module")
def plan(kitchen: Scene, segway: Robot) -> PlacementPlan:
    task = make_task(kitchen, "open", "cabinet_right", "drawer_top_slide")
    plan = plan_base_placement(kitchen, segway, task, Everywhere(), config=CONFIG).plan
    assert plan.status == "solved"
    return plan


def test_another_grasp_at_the_same_base_pose_differs_from_the_one_that_failed(
    kitchen: Scene, segway: Robot, plan: PlacementPlan
) -> None:
    failed = grasp_in_part(kitchen, plan.task, plan.motion)
    others = other_grasps(kitchen, plan.task, [failed])
    found = check_base_pose(
        kitchen, segway, plan.task, plan.base_pose, Everywhere(), how_far=False, keep_grasps=others
    )
    assert found.motion is not None, found.reason
    other = grasp_in_part(kitchen, plan.task, found.motion)
    away = np.linalg.norm(other[:3, 3] - failed[:3, 3])
    assert (
        away > MIN_GRASP_DISTANCE or rotation_angle(other[:3, :3], failed[:3, :3]) > MIN_GRASP_ANGLE
    )


def test_if_no_other_grasp_is_left_the_reason_states_it(
    kitchen: Scene, segway: Robot, plan: PlacementPlan
) -> None:
    found = check_base_pose(
        kitchen, segway, plan.task, plan.base_pose, Everywhere(), how_far=False,
        keep_grasps=lambda motion: np.zeros(len(motion.Ts_world_tool), bool),
    )  # fmt: skip
    assert found.motion is None
    assert NO_OTHER_GRASP in found.reason


def test_the_believed_scene_has_the_part_where_the_hand_left_it(kitchen: Scene) -> None:
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    offset = np.array([0.01, -0.02, 0.005])
    believed = believed_scene(kitchen, task, 0.7, offset)
    one, other = kitchen.object("fridge"), believed.object("fridge")
    assert other.values()["door_hinge"] == pytest.approx(0.7)
    np.testing.assert_allclose(other.T_world_object[:3, 3] - one.T_world_object[:3, 3], offset)
    beyond = believed_scene(kitchen, task, 9.0, offset).object("fridge")
    assert beyond.values()["door_hinge"] == beyond.model.joint("door_hinge").upper
    others = [o for o in believed.objects if o.name != "fridge"]
    assert others == [o for o in kitchen.objects if o.name != "fridge"]


def door_points(room: Scene, task: Task, value: float) -> np.ndarray:
    """Return the vertices of a task's part in the world at a joint value."""
    item = room.object(task.object)
    poses = item.link_poses({task.joint: value})
    links = item.model.moved_by(task.joint)
    return np.concatenate([apply(poses[n], h.vertices) for n in links for h in item.model.hulls[n]])


def hinge(room: Scene, task: Task) -> Axis:
    """Return the joint of a task's part in the world."""
    item = room.object(task.object)
    joint = item.model.joint(task.joint)
    T = item.link_poses()[joint.parent] @ joint.T_parent_joint
    return Axis(joint.kind == "prismatic", T[:3, :3] @ joint.axis, T[:3, 3])


@pytest.mark.parametrize(
    ("name", "joint"), [("fridge", "door_hinge"), ("cabinet_right", "drawer_top_slide")]
)
def test_a_part_moves_about_the_measured_joint(kitchen: Scene, name: str, joint: str) -> None:
    task = make_task(kitchen, "open", name, joint)
    modeled = hinge(kitchen, task)
    lean = rotation_of(np.array([0.03, 0.05, 0.0]))
    found = replace(
        modeled,
        direction=lean @ modeled.direction,
        point=modeled.point + np.array([0.01, 0.02, 0.0]),
    )
    sign = np.sign(task.to)
    room, same, value = with_estimated_joint(kitchen, task, found, 0.5 * task.to)
    assert same.to == pytest.approx(abs(task.to))
    assert value == pytest.approx(0.5 * abs(task.to))
    closed = door_points(kitchen, task, 0.0)
    np.testing.assert_allclose(door_points(room, same, 0.0), closed, atol=1e-6)
    expected = apply(found.moved(sign * value), closed)
    np.testing.assert_allclose(door_points(room, same, value), expected, atol=1e-6)


def test_a_grasp_does_not_depend_on_the_believed_joint(kitchen: Scene, plan: PlacementPlan) -> None:
    axis = hinge(kitchen, plan.task)
    other, _, _ = with_estimated_joint(
        kitchen, plan.task, axis.shifted(np.array([0.1, 0.0, 0.2])), 0.1
    )
    before = grasp_in_part(kitchen, plan.task, plan.motion)
    np.testing.assert_allclose(grasp_in_part(other, plan.task, plan.motion), before, atol=1e-6)


@pytest.mark.parametrize(("lean", "falls"), [(0.08, True), (0.0, False), (-0.08, False)])
def test_a_door_falls_closed_if_its_hinge_leans_so_that_opening_lifts_it(
    kitchen: Scene, lean: float, *, falls: bool
) -> None:
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    modeled = hinge(kitchen, task)
    closed = door_points(kitchen, task, 0.0).mean(0)
    way = np.sign(task.to) * modeled.way_at(closed)
    arm = closed - modeled.point
    # Tilt the hinge about the door's horizontal line, so that opening lifts or lowers its edge.
    across = arm - (arm @ modeled.direction) * modeled.direction
    turn = rotation_of(lean * across / np.linalg.norm(across))
    tilted = replace(modeled, direction=turn @ modeled.direction)
    if lean and (np.sign(task.to) * tilted.way_at(closed)[2] > 0.0) != (lean > 0.0):
        turn = rotation_of(-lean * across / np.linalg.norm(across))
        tilted = replace(modeled, direction=turn @ modeled.direction)
    assert abs(way[2]) < 1e-6
    learned = LearnedPart(0.5 * task.to, tilted, np.zeros(3), (closed,))
    assert falls_closed(kitchen, task, learned) is falls


def test_without_pushes_only_the_push_family_is_removed() -> None:
    config = without_pushes(CONFIG)
    assert "push" in CONFIG.motion.grasps.families
    assert "push" not in config.motion.grasps.families
    assert replace(config, motion=CONFIG.motion) == CONFIG


def test_the_arm_has_a_path_home_from_a_half_open_drawer(
    kitchen: Scene, segway: Robot, plan: PlacementPlan
) -> None:
    half = len(plan.motion.q) // 2
    value, q = float(plan.motion.object_q[half]), plan.motion.q[half]
    believed = believed_scene(kitchen, plan.task, value, np.zeros(3))
    way = arm_home_path(
        believed, segway, plan.task, np.array(plan.base_pose), q, config=CONFIG, seed=0
    )
    np.testing.assert_allclose(way[0], q)
    np.testing.assert_allclose(way[-1], segway.home)
    assert np.abs(np.diff(way, axis=0)).max() < 0.05


@pytest.mark.slow
def test_after_a_lost_grasp_another_grasp_does_the_task(
    kitchen: Scene, segway: Robot, plan: PlacementPlan
) -> None:
    worlds: list[Simulation] = []

    def weaken_the_first(world: Simulation, *_: object) -> None:
        if not worlds or world is not worlds[-1]:
            worlds.append(world)
        if len(worlds) == 1 and world.data.qpos[world.part_q] > 0.1:
            for _finger, motor in world.fingers:
                world.model.actuator_forcerange[motor] = 0.0

    def stand_there(_: object, __: object, goal: np.ndarray, ___: object) -> DriveRecord:
        none = np.zeros(0)
        return DriveRecord(
            True, "", goal, goal, goal, "", 0.0, 0.0, 0.0, 0.5, np.inf, 1, np.zeros(1), goal[None],
            np.zeros((1, 3)), none,
        )  # fmt: skip

    record = run_plan(
        plan, kitchen, segway, Everywhere(), config=CONFIG, driver=stand_there,
        watch=weaken_the_first, physics=ExecutionConfig(),
    )  # fmt: skip
    assert len(record.failed) == 1
    assert not record.failed[0].success
    assert record.success, record.reason
    assert record.execution.start == pytest.approx(0.0)


def test_the_path_home_of_a_telescopic_arm_has_all_its_joints(
    kitchen: Scene, stretch: Robot
) -> None:
    task = make_task(kitchen, "open", "cabinet_right", "drawer_top_slide")
    home = stretch.chain.joint_values(stretch.home)
    away = stretch.home.copy()
    away[1] += 0.1
    base = np.array([1.9, -1.6, 1.5708])
    way = arm_home_path(
        kitchen, stretch, task, base, stretch.chain.joint_values(away), config=CONFIG, seed=0
    )
    assert way.shape[1] == len(stretch.moved_joints) > stretch.chain.size
    assert np.allclose(way[-1], home)


def test_base_poses_of_an_arm_with_few_joints_can_be_checked(
    kitchen: Scene, stretch: Robot
) -> None:
    # The seal of a fridge pulls this light robot over.
    kitchen = kitchen.with_resistance({"fridge": {"door_hinge": JointResistance(seal_force=4.0)}})
    task = make_task(kitchen, "open", "fridge", "door_hinge", 0.2)
    feasible, infeasible = (
        check_base_pose(kitchen, stretch, task, pose, Everywhere(), how_far=False)
        for pose in ((0.4, -1.3, np.pi), (0.7, -1.0, np.pi))
    )
    assert feasible.motion is not None
    assert infeasible.reason == "out of reach at the pre-grasp"
