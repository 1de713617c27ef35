"""A hand that turns about the bar that it holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos.config import PipelineConfig
from momapos.geometry.transforms import invert, rotation_angle
from momapos.manipulation.motion import TaskMotion
from momapos.manipulation.tasks import make_task
from momapos.manipulation.turning import LEAST
from momapos.placement.holding import score_grasps, score_turning
from momapos.prepare import PreparedTask, prepare
from momapos.reachability.store import load_reach_map
from momapos.robots.robot import Robot, load_robot
from momapos.scene.files import load_scene

CONFIG = PipelineConfig()
BASE = np.array([0.458, -1.39, 2.532])
"""From here no rigid grasp opens the fridge all the way."""


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("segway_ur5e")


@pytest.fixture(scope="module")
def fridge(robot: Robot) -> PreparedTask:
    scene = load_scene("kitchen_small")
    task = make_task(scene, "open", "fridge", "door_hinge")
    return prepare(scene, robot, task, CONFIG, clearance=0.0)


def in_part(motion: TaskMotion, Ts: np.ndarray) -> np.ndarray:
    """Tool poses in the frame of the door, from where the first grasp has it there."""
    T_part_tool = np.eye(4)
    T_part_tool[:3, :3] = motion.turning.R_part_tool[0]
    rigid = motion.Ts_world_tool[0, motion.grasp_step :]
    return np.asarray(T_part_tool @ invert(rigid) @ Ts[motion.grasp_step :])


def test_grasps_of_one_group_differ_by_a_turn_about_the_bar(fridge: PreparedTask) -> None:
    turning = fridge.motion.turning
    assert len(turning.groups)
    for group in turning.groups:
        members = group[group >= 0]
        R = turning.R_part_tool[members]
        turns = turning.angles[members] - turning.angles[members[0]]
        np.testing.assert_allclose(rotation_angle(R[:1], R), np.abs(turns), atol=1e-6)
        held = fridge.motion.Ts_world_tool[members, fridge.motion.grasp_step, :3, 3]
        assert np.ptp(held, axis=0).max() < 1e-9


def test_a_turning_hand_keeps_its_place_in_the_bar(fridge: PreparedTask) -> None:
    motion = fridge.motion
    group = motion.turning.groups[0]
    members = group[group >= 0]
    grasps = np.full(len(motion.waypoint_steps), members[0])
    grasps[-4:] = members[1]
    turned = in_part(motion, motion.tool_poses(grasps))
    np.testing.assert_allclose(
        turned[:, :3, 3], turned[:1, :3, 3].repeat(len(turned), 0), atol=1e-9
    )
    R = turned[:, :3, :3] @ turned[0, :3, :3].T
    # What turns about the axis leaves the axis where it is.
    np.testing.assert_allclose(
        R @ motion.turning.axis, motion.turning.axis[None].repeat(len(R), 0), atol=1e-9
    )
    change = float(rotation_angle(turned[0, :3, :3], turned[-1, :3, :3]))
    assert change == pytest.approx(abs(np.diff(motion.turning.angles[members[:2]])[0]))


def test_single_grasps_stay_where_they_are(fridge: PreparedTask) -> None:
    motion = fridge.motion
    grasps = np.full(len(motion.waypoint_steps), 5)
    np.testing.assert_array_equal(motion.tool_poses(grasps), motion.Ts_world_tool[5])


def test_groups_lose_the_grasps_that_are_dropped(fridge: PreparedTask) -> None:
    motion = fridge.motion
    kept = np.ones(len(motion.Ts_world_tool), bool)
    group = motion.turning.groups[0]
    members = group[group >= 0]
    kept[members[LEAST - 1 :]] = False
    left = motion.only(kept)
    assert len(left.turning.groups) == len(motion.turning.groups) - 1
    old = np.flatnonzero(kept)
    for row in left.turning.groups:
        same = [g for g in motion.turning.groups if np.isin(old[row[row >= 0]], g).all()]
        assert len(same) == 1


def test_a_turning_hand_opens_what_a_rigid_one_cannot(
    fridge: PreparedTask, robot: Robot, tmp_path: Path
) -> None:
    reach = load_reach_map(robot, tmp_path)
    feasible = fridge.feasibility(CONFIG, seed=0)
    geometry, poses = fridge.geometry, BASE[None]
    rigid = feasible.screen(poses, score_grasps(reach, poses, geometry), None)
    turning = feasible.screen(poses, score_turning(reach, poses, geometry), None)
    assert rigid is not None
    assert turning is not None
    assert rigid[0].q is None
    assert turning[0].q is not None
    found = feasible(BASE, turning[0], np.array([turning[0].grasp])).motion
    assert found is not None
    assert found.holds[0].turn_axis is not None
    assert fridge.violation(BASE, found) is None
    assert "rotation" in (fridge.violation(BASE, replace(found, holds=())) or "")
