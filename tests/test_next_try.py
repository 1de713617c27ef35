"""Laws of what a robot tries next where a motion failed."""

from __future__ import annotations

import numpy as np
import pytest
from tests.rooms import Everywhere

from momapos.base_pose import check_base_pose
from momapos.config import PipelineConfig
from momapos.execution.config import ExecutionConfig
from momapos.execution.simulation import Simulation
from momapos.geometry.transforms import rotation_angle
from momapos.manipulation.tasks import make_task
from momapos.navigation.drive_record import DriveRecord
from momapos.next_try import (
    OTHER_ANGLE,
    OTHER_POSITION,
    arm_way_home,
    believed_scene,
    grasp_in_part,
    other_grasps,
)
from momapos.pipeline import plan_base_placement
from momapos.prepare import NO_OTHER_GRASP
from momapos.robots.robot import Robot, load_robot
from momapos.run_plan import run_plan
from momapos.scene.files import load_scene
from momapos.scene.scene import Scene
from momapos.types import PlacementPlan

CONFIG = PipelineConfig()


@pytest.fixture(scope="module")
def kitchen() -> Scene:
    return load_scene("kitchen_small")


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("segway_ur5e")


@pytest.fixture(scope="module")
def plan(kitchen: Scene, robot: Robot) -> PlacementPlan:
    task = make_task(kitchen, "open", "cabinet_right", "drawer_top_slide")
    plan = plan_base_placement(kitchen, robot, task, Everywhere(), config=CONFIG).plan
    assert plan.status == "solved"
    return plan


def test_another_grasp_at_the_same_base_pose_differs_from_the_one_that_failed(
    kitchen: Scene, robot: Robot, plan: PlacementPlan
) -> None:
    assert plan.base_pose is not None
    assert plan.motion is not None
    failed = grasp_in_part(kitchen, plan.task, plan.motion)
    others = other_grasps(kitchen, plan.task, [failed])
    found = check_base_pose(
        kitchen, robot, plan.task, plan.base_pose, Everywhere(), how_far=False, grasp_filter=others
    )
    assert found.motion is not None, found.reason
    other = grasp_in_part(kitchen, plan.task, found.motion)
    away = np.linalg.norm(other[:3, 3] - failed[:3, 3])
    assert away > OTHER_POSITION or rotation_angle(other[:3, :3], failed[:3, :3]) > OTHER_ANGLE


def test_where_no_grasp_is_left_the_answer_says_so(
    kitchen: Scene, robot: Robot, plan: PlacementPlan
) -> None:
    assert plan.base_pose is not None
    found = check_base_pose(
        kitchen, robot, plan.task, plan.base_pose, Everywhere(), how_far=False,
        grasp_filter=lambda motion: np.zeros(len(motion.Ts_world_tool), bool),
    )  # fmt: skip
    assert found.motion is None
    assert NO_OTHER_GRASP in found.reason


def test_the_believed_room_has_the_part_where_the_hand_left_it(kitchen: Scene) -> None:
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


def test_the_arm_finds_home_from_a_grasp_with_the_drawer_half_open(
    kitchen: Scene, robot: Robot, plan: PlacementPlan
) -> None:
    assert plan.base_pose is not None
    assert plan.motion is not None
    half = len(plan.motion.q) // 2
    value, q = float(plan.motion.object_q[half]), plan.motion.q[half]
    believed = believed_scene(kitchen, plan.task, value, np.zeros(3))
    way = arm_way_home(
        believed, robot, plan.task, np.array(plan.base_pose), q, config=CONFIG, seed=0
    )
    assert way is not None
    np.testing.assert_allclose(way[0], q)
    np.testing.assert_allclose(way[-1], robot.home)
    assert np.abs(np.diff(way, axis=0)).max() < 0.05


def test_where_the_hand_loses_its_hold_another_grasp_does_the_task(
    kitchen: Scene, robot: Robot, plan: PlacementPlan
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
        plan, kitchen, robot, Everywhere(), config=CONFIG, go=stand_there, watch=weaken_the_first,
        physics=ExecutionConfig(),
    )  # fmt: skip
    assert len(record.failed) == 1
    assert not record.failed[0].success
    assert record.success, record.reason
    assert record.execution is not None
    assert record.execution.start == pytest.approx(0.0)


def test_an_arm_with_a_telescope_finds_home_in_all_its_joints(kitchen: Scene) -> None:
    stretch = load_robot("stretch")
    task = make_task(kitchen, "open", "cabinet_right", "drawer_top_slide")
    home = stretch.chain.joint_values(stretch.home)
    away = stretch.home.copy()
    away[1] += 0.1
    base = np.array([1.9, -1.6, 1.5708])
    way = arm_way_home(
        kitchen, stretch, task, base, stretch.chain.joint_values(away), config=CONFIG, seed=0
    )
    assert way is not None
    assert way.shape[1] == len(stretch.moved_joints) > stretch.chain.size
    assert np.allclose(way[-1], home)


def test_base_poses_of_an_arm_of_few_joints_are_answered(kitchen: Scene) -> None:
    task = make_task(kitchen, "open", "fridge", "door_hinge", 0.2)
    stretch = load_robot("stretch")
    there, beside = (
        check_base_pose(kitchen, stretch, task, pose, Everywhere(), how_far=False)
        for pose in ((0.4, -1.3, np.pi), (0.7, -1.0, np.pi))
    )
    assert there.motion is not None
    assert beside.reason == "out of reach at the pre-grasp"
