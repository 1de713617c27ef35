"""Laws of Jacobians, dexterity and joint travel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from momapos.core.geometry.transforms import rotation_about
from momapos.model.kinematics.tool_tracking import jacobians, least_dexterity, travel_of_arm
from momapos.model.robots.robot import load_robot


@pytest.mark.parametrize("name", ["segway_ur5e", "fetch"])
def test_a_jacobian_predicts_small_motions(name: str) -> None:
    chain, rng = load_robot(name).chain, np.random.default_rng(0)
    q = np.clip(rng.uniform(-1.5, 1.5, (40, chain.size)), chain.lower, chain.upper)
    dq, length = 1e-4 * rng.normal(size=q.shape), 0.7
    J = jacobians(chain, q, length)
    twist = np.einsum("mij,mj->mi", J, dq / np.where(chain.prismatic, length, 1.0))
    T, moved = chain.tool_poses(q), chain.tool_poses(q + dq)
    np.testing.assert_allclose(moved[:, :3, 3] - T[:, :3, 3], length * twist[:, :3], atol=1e-6)
    for R, after, turn in zip(T[:, :3, :3], moved[:, :3, :3], twist[:, 3:], strict=True):
        angle = float(np.linalg.norm(turn))
        np.testing.assert_allclose(after, rotation_about(turn / angle, angle) @ R, atol=1e-6)


def test_a_straight_elbow_has_no_dexterity_and_the_smallest_counts() -> None:
    chain = load_robot("segway_ur5e").chain
    bent = np.array([0.3, -1.2, 1.4, -1.0, -1.3, 0.2])
    straight = bent.copy()
    straight[2] = 0.0
    assert least_dexterity(chain, straight[None], 1.0) < 1e-4
    alone = least_dexterity(chain, bent[None], 1.0)
    assert 0.01 < alone <= 1.0
    assert least_dexterity(chain, np.stack([bent, straight]), 1.0) < 1e-4


def test_dexterity_is_independent_of_the_arms_size() -> None:
    chain, rng = load_robot("segway_ur5e").chain, np.random.default_rng(1)
    larger = replace(chain, d=3.0 * chain.d, tool_offset=3.0 * chain.tool_offset)
    for q in rng.uniform(-1.5, 1.5, (10, 1, chain.size)):
        one, other = least_dexterity(chain, q, 0.85), least_dexterity(larger, q, 3.0 * 0.85)
        assert one == pytest.approx(other, abs=1e-5)


def test_the_travel_there_and_back_is_twice_the_travel_there() -> None:
    chain = load_robot("fetch").chain  # its torso slides
    q = np.zeros((3, chain.size))
    q[1] = 0.1
    slides = int(chain.prismatic.sum())
    assert slides == 1
    there = 0.1 * (chain.size - slides) + 0.1 * slides / 0.5
    assert travel_of_arm(chain, q[:2], 0.5) == pytest.approx(there)
    assert travel_of_arm(chain, q, 0.5) == pytest.approx(2 * there)
