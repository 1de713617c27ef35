"""Laws of trajectories of a base that moves with the arm: one clock, both within their limits."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.moving_base import arc, moved

from momapos.core.geometry.transforms import pose_planar
from momapos.model.records.plans import Motion, PlacementPlan, Task
from momapos.model.robots.robot import Robot
from momapos.model.trajectory import DEFAULT, SpeedConfig, time_motion, time_plan, with_times

STEP = 0.01
FAST = SpeedConfig(manipulation_speed=1.0, tool_speed=10.0)
"""So fast that the base limits the motion."""
READY = np.array([0.3, -0.9, 1.6, -0.7, 1.57, 0.0])
"""A state of the arm in which the hand can move in every direction [rad]."""


def motion_of(robot: Robot, base: np.ndarray) -> Motion:
    """Return a motion whose hand stays in its place while the base moves."""
    T = pose_planar(base[0]) @ robot.chain.tool_poses(READY[None])
    q = robot.chain.joint_values(READY[None])
    count = len(base)
    still = Motion(q, np.tile(q, (count, 1)), np.linspace(0, 1, count), np.tile(T, (count, 1, 1)))
    return moved(still, robot.chain, base)


def plan_of(robot: Robot, motion: Motion) -> PlacementPlan:
    x, y, yaw = motion.base[0].tolist()
    return PlacementPlan(
        "scene", robot.name, "urdf", "base", "tool", Task("open", "a", "b", 1.0), "solved",
        robot.moved_joints, (x, y, yaw), motion,
    )  # fmt: skip


PATHS = {
    "straight": arc((0.5, 0.2, 0.7), -0.2, 0.0, 40),
    "curve": arc((0.5, 0.2, 0.7), -0.25, 0.3, 40),
    "on the spot": arc((0.5, 0.2, 3.0), 0.0, 0.4, 40),
    "there and back": np.concatenate(
        [arc((0, 0, 0), -0.15, 0.1, 30), arc((0, 0, 0), -0.15, 0.1, 30)[-2::-1]]
    ),
}


@pytest.mark.parametrize("config", [DEFAULT, FAST])
@pytest.mark.parametrize("name", PATHS)
def test_base_and_arm_keep_their_limits_on_one_clock(
    name: str, config: SpeedConfig, segway: Robot
) -> None:
    motion = motion_of(segway, PATHS[name])
    timed = time_motion(segway, motion, config, STEP)[1]
    share = config.manipulation_speed
    speed = np.hypot(*timed.base_v[:, :2].T)
    assert speed.max() <= 1.01 * share * segway.max_speed
    assert np.abs(timed.base_v[:, 2]).max() <= 1.01 * share * segway.max_yaw_rate
    a = np.diff(timed.base_v, axis=0)[:-1] / STEP
    assert np.hypot(*a[:, :2].T).max() <= 1.05 * segway.max_acceleration
    assert np.abs(a[:, 2]).max() <= 1.05 * segway.max_yaw_acceleration
    limits = np.array([segway.model.joint(name).velocity for name in segway.moved_joints])
    assert (np.abs(timed.v) <= 1.01 * share * limits).all()
    np.testing.assert_allclose(timed.base_v[[0, -1]], 0.0, atol=1e-2)
    tool = pose_planar(timed.base) @ segway.chain.tool_poses(segway.chain.freedom_values(timed.q))
    off = np.linalg.norm(tool[:, :3, 3] - motion.Ts_world_tool[0, :3, 3], axis=1)
    assert off.max() < 2e-3  # base and arm at the same time: the hand stays where it is


def test_the_base_reaches_the_limit_that_holds_it_back(segway: Robot) -> None:
    slow = replace(segway, max_speed=0.04)
    timed = time_motion(slow, motion_of(segway, PATHS["straight"]), FAST, STEP)[1]
    assert np.hypot(*timed.base_v[:, :2].T).max() == pytest.approx(0.04, rel=0.02)
    diagonal = replace(segway, max_speed=0.04, drive="omni")
    base = np.linspace([0.0, 0.0, 0.0], [-0.1, 0.1, 0.0], 40)
    timed = time_motion(diagonal, motion_of(segway, base), FAST, STEP)[1]
    assert np.hypot(*timed.base_v[:, :2].T).max() == pytest.approx(0.04, rel=0.02)


def test_each_state_is_passed_by_base_and_arm_at_its_time(segway: Robot) -> None:
    motion = motion_of(segway, PATHS["curve"])
    timed = time_motion(segway, motion, DEFAULT, STEP)[1]
    assert timed.base is not None
    samples = np.arange(len(timed)) * STEP
    for states, there in ((motion.q, timed.q), (motion.base, timed.base)):
        at = [np.interp(timed.state_times, samples, column) for column in there.T]
        np.testing.assert_allclose(np.stack(at, 1), states, atol=0.5 * STEP)
    assert with_times(plan_of(segway, motion), segway).motion is not None


def test_a_timed_plan_tells_where_the_base_is(segway: Robot, tmp_path: Path) -> None:
    motion = motion_of(segway, PATHS["curve"])
    timed = time_plan(plan_of(segway, motion), segway)
    assert len(timed.base) == len(timed.times)
    np.testing.assert_allclose(timed.base[: timed.grasp_index], np.tile(PATHS["curve"][0], (1, 1)))
    np.testing.assert_allclose(timed.base[-1], PATHS["curve"][-1], atol=1e-6)
    timed.write_csv(tmp_path / "a.csv")
    with (tmp_path / "a.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["base_yaw"]) == pytest.approx(PATHS["curve"][-1, 2])
    assert {"base_x_velocity", "base_y_velocity", "base_yaw_velocity"} <= set(rows[0])


def test_a_base_that_stands_still_adds_nothing(segway: Robot) -> None:
    motion = replace(motion_of(segway, PATHS["curve"]), base=None)
    timed = time_motion(segway, motion, DEFAULT, STEP)[1]
    assert timed.base is None
    assert timed.q.shape[1] == len(segway.moved_joints)
