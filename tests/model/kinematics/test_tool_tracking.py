"""Laws of arm states that reach tool poses from nearby states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

from momapos.core.geometry.transforms import pose_planar, rotation_about
from momapos.model.kinematics.tool_tracking import jacobians, track_tools
from momapos.model.robots.robot import Robot


def middle(robot: Robot, rng: np.random.Generator, count: int) -> Float[np.ndarray, "count n"]:
    """Return states away from the limits and from singularities."""
    chain = robot.chain
    low, high = np.maximum(chain.lower, -1.2), np.minimum(chain.upper, 1.2)
    q = low + rng.uniform(0.2, 0.8, (40 * count, len(low))) * (high - low)
    least = np.linalg.svd(jacobians(chain, q, 1.0), compute_uv=False).min(1)
    return np.asarray(q[np.argsort(-least)[:count]])


@pytest.mark.parametrize("seed", range(3))
def test_the_tool_poses_of_nearby_states_are_reached(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = middle(robot, rng, 20)
    there = robot.chain.tool_poses(q + rng.uniform(-0.05, 0.05, q.shape))
    found = track_tools(robot.chain, q, there)
    assert found is not None
    np.testing.assert_allclose(robot.chain.tool_poses(found), there, atol=2e-4)
    assert (found >= robot.chain.lower).all()
    assert (found <= robot.chain.upper).all()
    assert np.abs(found - q).max() < 0.5


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_poses_are_reached_where_all_joints_move_one_way(robot: Robot, sign: float) -> None:
    rng = np.random.default_rng(3)
    q = middle(robot, rng, 20)
    there = robot.chain.tool_poses(q + sign * rng.uniform(0.02, 0.05, q.shape))
    together = track_tools(robot.chain, q, there)
    assert together is not None
    for k in range(len(q)):
        alone = track_tools(robot.chain, q[k : k + 1], there[k : k + 1])
        assert alone is not None
        np.testing.assert_allclose(alone[0], together[k], atol=1e-6)


def test_a_pose_out_of_reach_has_no_state(robot: Robot) -> None:
    q = middle(robot, np.random.default_rng(0), 5)
    there = robot.chain.tool_poses(q)
    there[3] = pose_planar(np.array([5.0, 0.0, 0.0])) @ there[3]
    assert track_tools(robot.chain, q, there) is None


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_arm_that_cannot_move_reaches_nothing_whatever_the_sign_of_the_errors(
    robot: Robot, sign: float
) -> None:
    q = middle(robot, np.random.default_rng(0), 1)
    fixed = replace(robot.chain, lower=q[0], upper=q[0])
    there = fixed.tool_poses(q)
    assert track_tools(fixed, q, there) is not None
    turn = rotation_about(np.ones(3) / np.sqrt(3.0), np.array(sign * 0.01))
    off = there.copy()
    off[0, :3, :3] = turn @ there[0, :3, :3]
    assert track_tools(fixed, q, off) is None
    off = there.copy()
    off[0, :3, 3] += sign * 0.01
    assert track_tools(fixed, q, off) is None
