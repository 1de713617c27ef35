"""Test arms of fewer than six degrees of freedom."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from momapos.core.geometry.transforms import invert, pose_planar
from momapos.model.records.plans import JointResistance
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.planning.arm_motion.arm_path import FOUND, HIT
from momapos.planning.arm_motion.free_turn import _feasible_modes, find_short_paths, fitted_bases
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import check_base_pose, plan_base_placement
from momapos.planning.reachability.map_store import load_reach
from momapos.planning.task_setup import prepare

CONFIG = PipelineConfig()
CONFIG = replace(CONFIG, place=replace(CONFIG.place, grid=False, rounds=2))


@pytest.fixture(scope="module")
def short_arm(husky: Robot) -> Robot:
    """Provide a UR5e whose last joint is fixed."""
    return replace(husky, arm_joints=husky.arm_joints[:-1], home=husky.home[:-1])


@pytest.mark.parametrize(
    ("name", "joint", "to"),
    [("fridge", "door_hinge", 0.3), ("cabinet_right", "drawer_top_slide", 0.2)],
)
def test_an_arm_of_five_joints_opens_a_door_and_a_drawer(
    kitchen: Scene, short_arm: Robot, name: str, joint: str, to: float
) -> None:
    task = make_task(kitchen, "open", name, joint, to)
    plan = plan_base_placement(kitchen, short_arm, task, config=CONFIG).plan
    assert plan.status == "solved"
    assert plan.motion.q.shape[1] == len(plan.joints) == 5
    # The plan's tool poses match the arm states.
    Ts = pose_planar(np.array(plan.base_pose)) @ short_arm.chain.tool_poses(plan.motion.q)
    np.testing.assert_allclose(Ts, plan.motion.Ts_world_tool, atol=1e-9)


def test_a_hand_that_turns_stays_on_the_bar(kitchen: Scene, short_arm: Robot) -> None:
    task = make_task(kitchen, "open", "fridge", "door_hinge", 0.3)
    plan = plan_base_placement(kitchen, short_arm, task, config=CONFIG).plan
    (hold,) = plan.motion.holds
    assert hold.turn_axis is not None
    part = [
        kitchen.object("fridge").link_poses({"door_hinge": float(v)})["door"]
        for v in plan.motion.object_q
    ]
    T_part_tool = invert(np.array(part)) @ plan.motion.Ts_world_tool
    slip = T_part_tool[:, :3, 3] - T_part_tool[0, :3, 3]
    assert np.abs(slip).max() < 1e-3
    # It turns only about the axis of the hold.
    along = np.array(hold.turn_axis) @ T_part_tool[:, :3, :3]
    np.testing.assert_allclose(along, along[:1].repeat(len(along), 0), atol=1e-3)


@pytest.mark.parametrize(
    ("name", "joint", "to"),
    [("fridge", "door_hinge", 0.3), ("cabinet_right", "drawer_top_slide", 0.4)],
)
def test_from_a_fitted_base_pose_the_arm_follows_the_motion_in_the_returned_mode(
    kitchen: Scene, name: str, joint: str, to: float, stretch: Robot
) -> None:
    task = make_task(kitchen, "open", name, joint, to)
    # With the seal of a fridge, the door pulls this robot over.
    kitchen = kitchen.with_resistance({name: {joint: JointResistance(seal_force=4.0)}})
    prepared = prepare(kitchen, stretch, task, CONFIG, clearance=0.01)
    motion, rng = prepared.motion, np.random.default_rng(0)
    middle = motion.waypoints[:, :2].mean(0)
    poses = np.column_stack([middle + rng.uniform(-1, 1, (400, 2)), rng.uniform(-3, 3, 400)])
    moved, modes = fitted_bases(stretch, motion, poses)
    met = modes >= 0
    np.testing.assert_array_equal(moved[~met], poses[~met])
    rigid = modes[met] < len(motion.Ts_world_tool)
    assert rigid.all() if joint == "drawer_top_slide" else not rigid.any()
    paths = find_short_paths(stretch, prepared.world, motion, moved[met], modes[met])
    # The others fail by collision or between the fitted waypoints.
    assert sum(path.status in (FOUND, HIT) for path in paths) >= 0.5 * len(paths) > 3
    assert any(path.status == FOUND for path in paths)


@pytest.mark.parametrize(("to", "some"), [(0.2, True), (0.4, False)])
def test_modes_that_the_arm_follows_from_nowhere_are_left_out(
    kitchen: Scene, to: float, some: bool
) -> None:
    """HSR's arm pulls a drawer by 30 cm at most."""
    robot = load_robot("hsr")
    task = make_task(kitchen, "open", "cabinet_right", "drawer_top_slide", to)
    motion = prepare(kitchen, robot, task, CONFIG, clearance=0.01).motion
    modes = _feasible_modes(robot, motion)
    assert bool(len(modes)) == some
    assert len(modes) < motion.turning.modes
    rng, middle = np.random.default_rng(0), motion.waypoints[:, :2].mean(0)
    poses = np.column_stack([middle + rng.uniform(-1, 1, (100, 2)), rng.uniform(-3, 3, 100)])
    moved, found = fitted_bases(robot, motion, poses)
    assert np.isin(found[found >= 0], modes).all()
    np.testing.assert_array_equal(moved[found < 0], poses[found < 0])


def test_a_base_error_of_millimeters_leaves_the_plan_feasible(
    kitchen: Scene, stretch: Robot
) -> None:
    task = make_task(kitchen, "open", "cabinet_right", "drawer_top_slide")
    reach = load_reach(stretch)
    plan = plan_base_placement(kitchen, stretch, task, reach, config=CONFIG).plan
    for off in ((0.004, 0.0, 0.006), (-0.003, 0.003, -0.006), (0.0, -0.004, 0.0)):
        again = check_base_pose(kitchen, stretch, task, np.add(plan.base_pose, off), reach)
        assert again.motion is not None
        # The tool poses match the arm states from there.
        motion = again.motion
        Ts = pose_planar(np.add(plan.base_pose, off)) @ stretch.chain.tool_poses(
            stretch.chain.freedom_values(motion.q)
        )
        np.testing.assert_allclose(Ts, motion.Ts_world_tool, atol=1e-9)
    far = check_base_pose(kitchen, stretch, task, np.add(plan.base_pose, (0.05, 0, 0.1)), reach)
    assert far.motion is None
