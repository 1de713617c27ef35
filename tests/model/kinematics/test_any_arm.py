"""Inverse kinematics of arms with unusual geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.model.collision.exact_hulls import random_states
from tests.model.kinematics import arms

from momapos.core.errors import RobotError
from momapos.model.kinematics.chain import Chain
from momapos.model.kinematics.closed_forms import NUMERIC, WRIST_MEETING
from momapos.model.kinematics.ik import MAX_SAMPLES, build_ik, solve_ik

ARMS = {
    "spherical shoulder": arms.spherical_shoulder(),
    "six skew joints": arms.skew(6, 7),
    "seven skew joints": arms.skew(7, 1),
    "ten skew joints": arms.skew(10, 2),
    "skew joints that slide": arms.skew(7, 3, slides=(0, 4)),
    "lift and telescope": arms.lift_and_telescope(),
    "five skew joints": arms.skew(5, 4),
    "four skew joints": arms.skew(4, 5),
}


@pytest.mark.parametrize("name", ARMS)
def test_reachable_poses_have_solutions(name: str) -> None:
    chain = ARMS[name]
    Ts = chain.tool_poses(random_states(chain, 400, np.random.default_rng(0)))
    q, counts = solve_ik(chain, build_ik(chain), Ts)
    assert (counts > 0).mean() >= 0.985
    found = np.arange(q.shape[1]) < counts[:, None]
    assert_allclose(chain.tool_poses(q[found]), Ts[np.nonzero(found)[0]], atol=2e-6)
    assert (q[found] >= chain.lower - 1e-8).all()
    assert (q[found] <= chain.upper + 1e-8).all()
    assert np.isnan(q[~found]).all()


@pytest.mark.parametrize("name", ["six skew joints", "seven skew joints", "five skew joints"])
def test_solutions_from_seeds_are_distinct(name: str) -> None:
    chain = ARMS[name]
    Ts = chain.tool_poses(random_states(chain, 50, np.random.default_rng(1)))
    for states, count in zip(*solve_ik(chain, build_ik(chain), Ts), strict=True):
        gaps = np.abs(states[:count, None] - states[None, :count]).max(-1)
        assert (gaps + np.eye(count) > 5e-3).all()


def test_a_spherical_shoulder_has_a_closed_form_from_the_tool() -> None:
    chain = ARMS["spherical shoulder"]
    ik = build_ik(chain)
    assert (ik.kind, ik.reverse) == (WRIST_MEETING, True)
    # If the locked joint is at a sample, the solutions include the state itself.
    q = random_states(chain, 300, np.random.default_rng(2))
    (locked,) = np.setdiff1d(np.arange(7), ik.active)
    q[:, locked] = np.random.default_rng(3).choice(ik.samples[:, locked], len(q))
    found, _ = solve_ik(chain, ik, chain.tool_poses(q))
    nearest = np.nanmin(np.abs(found - q[:, None]).max(-1), axis=1)
    assert (nearest < 1e-5).mean() >= 0.99


def test_more_seeds_find_no_more_branches_of_six_skew_joints() -> None:
    chain = ARMS["six skew joints"]
    ik = build_ik(chain)
    Ts = chain.tool_poses(random_states(chain, 60, np.random.default_rng(4)))
    few, many = solve_ik(chain, ik, Ts)[1], solve_ik(chain, replace(ik, tries=1000), Ts)[1]
    assert few.sum() >= 0.85 * many.sum()


def test_the_number_of_locked_samples_is_bounded() -> None:
    wrist = arms.spherical_shoulder()
    joints = [arms.UP] * 3
    long = arms.arm(
        [*joints, *wrist.h], [*[(0.1, 0.05, 0.1)] * 3, *wrist.d], tuple(wrist.tool_offset)
    )
    ik = build_ik(long)
    assert ik.kind != NUMERIC
    assert len(ik.samples) == MAX_SAMPLES < 9**4
    locked = np.setdiff1d(np.arange(long.size), ik.active)
    assert np.ptp(ik.samples[:, locked], axis=0).min() > 0.9 * (2 * 2.6)


def test_a_pose_that_five_joints_cannot_reach_has_no_solution() -> None:
    chain = ARMS["lift and telescope"]
    Ts = chain.tool_poses(random_states(chain, 50, np.random.default_rng(5)))
    Ts[:, 0, 3] += 0.3 * chain.tool_offset[0]
    _, counts = solve_ik(chain, build_ik(chain), Ts)
    assert (counts == 0).all()


def test_an_arm_of_three_joints_is_rejected() -> None:
    with pytest.raises(RobotError, match="3 degrees of freedom; at least 4"):
        build_ik(arms.skew(3, 0))


def test_seeds_are_deterministic() -> None:
    def seeds(chain: Chain) -> np.ndarray:
        return build_ik(chain).seeds

    assert_allclose(seeds(arms.skew(6, 7)), seeds(arms.skew(6, 7)), atol=0)
