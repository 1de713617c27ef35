"""Base poses fitted to tool poses for arms with few degrees of freedom."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose
from tests.model.collision.exact_hulls import random_states
from tests.model.kinematics import arms

from momapos.core.geometry.transforms import invert, pose_planar, rotation_about
from momapos.model.kinematics.base_fit import fit_bases, meets_somewhere
from momapos.model.kinematics.chain import with_tool_turn
from momapos.model.kinematics.closed_forms import THREE_PARALLEL
from momapos.model.kinematics.ik import build_ik, solve_ik

CHAIN = arms.lift_and_telescope()


def test_a_tool_turn_adds_one_degree_of_freedom() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    longer = with_tool_turn(CHAIN, axis, -1.0, 1.0)
    q = random_states(longer, 50, np.random.default_rng(0))
    expected = CHAIN.tool_poses(q[:, :-1])
    expected[:, :3, :3] = expected[:, :3, :3] @ rotation_about(axis, q[:, -1])
    assert_allclose(longer.tool_poses(q), expected, atol=1e-12)
    assert (longer.size, longer.last) == (CHAIN.size + 1, CHAIN.last + 1)


def test_fitted_base_poses_reach_all_poses_of_a_straight_pull() -> None:
    """The arm pulls straight along its telescope, and from few other base poses."""
    ik, rng = build_ik(CHAIN), np.random.default_rng(1)
    states = np.tile([0.2, 0.0, 0.3, 0.2, 0.1], (3, 1))
    states[:, 1] = [0.1, 0.25, 0.4]
    there = np.array([0.7, -0.4, 2.1])
    Ts = pose_planar(there) @ CHAIN.tool_poses(states)
    begin = there + rng.uniform(-0.3, 0.3, (60, 3))
    moved, met = fit_bases(CHAIN, ik, begin, Ts)
    assert met.mean() > 0.3
    for base in moved[met]:
        _, counts = solve_ik(CHAIN, ik, invert(pose_planar(base)) @ Ts)
        assert (counts > 0).all()
    # At the initial base poses, the arm reaches none of the poses.
    counts = [solve_ik(CHAIN, ik, invert(pose_planar(base)) @ Ts)[1].max() for base in begin]
    assert max(counts) == 0


def test_poses_that_are_too_high_have_no_fit() -> None:
    T = np.eye(4)
    T[2, 3] = 5.0
    _, met = fit_bases(CHAIN, build_ik(CHAIN), np.zeros((5, 3)), T[None])
    assert not met.any()


def test_an_arm_with_a_closed_form_can_be_fitted() -> None:
    """The arm has a yaw, three parallel pitches and a roll; with the tool turn like a UR arm."""
    five = arms.arm(
        [arms.UP, arms.LEFT, arms.LEFT, arms.LEFT, arms.AHEAD],
        [(0, 0, 0.3), (0, 0, 0), (0.3, 0, 0), (0.3, 0, 0), (0.1, 0, 0)],
        (0, 0, 0),
    )
    chain = with_tool_turn(five, np.array([0.0, 0.0, 1.0]), -1.0, 1.0)
    ik = build_ik(chain)
    assert ik.kind == THREE_PARALLEL
    assert len(ik.seeds) > 0
    q = np.array([0.2, -0.5, 0.8, 0.3, 0.4, 0.1]) + np.linspace(0.0, 0.2, 3)[:, None]
    there = np.array([0.7, -0.4, 2.1])
    Ts = pose_planar(there) @ chain.tool_poses(q)
    begin = there + np.random.default_rng(2).uniform(-0.2, 0.2, (20, 3))
    moved, met = fit_bases(chain, ik, begin, Ts)
    assert met.mean() > 0.5
    for base in moved[met]:
        _, counts = solve_ik(chain, ik, invert(pose_planar(base)) @ Ts)
        assert (counts > 0).all()


def test_the_base_moves_no_farther_than_necessary() -> None:
    """The telescope compensates offsets of the base along the pull."""
    ik, rng = build_ik(CHAIN), np.random.default_rng(3)
    states = np.tile([0.2, 0.0, 0.0, 0.0, 0.1], (3, 1))
    states[:, 1] = [0.1, 0.25, 0.4]
    there = np.array([0.7, -0.4, 2.1])
    Ts = pose_planar(there) @ CHAIN.tool_poses(states)
    begin = there + rng.uniform(-0.01, 0.01, (40, 3))
    moved, met = fit_bases(CHAIN, ik, begin, Ts, tries=8)
    assert met.all()
    pull = Ts[1, :2, 3] - Ts[0, :2, 3]
    along = (moved - begin)[:, :2] @ (pull / np.linalg.norm(pull))
    across = (moved - begin)[:, :2] @ np.array([-pull[1], pull[0]]) / np.linalg.norm(pull)
    assert np.abs(along).max() < 2e-3
    assert np.abs(across).max() > 5e-3
    assert np.abs(moved - begin).max() < 0.03


def test_an_arm_meets_what_it_can_reach_wherever_it_is_and_nothing_else() -> None:
    ik, there = build_ik(CHAIN), np.array([0.7, -0.4, 2.1])
    met = []
    for q in random_states(CHAIN, 20, np.random.default_rng(4)):
        Ts = pose_planar(there) @ CHAIN.tool_poses(q[None])
        elsewhere = pose_planar(np.array([5.0, 3.0, -1.0])) @ Ts
        met.append(meets_somewhere(CHAIN, ik, Ts, 24))
        assert meets_somewhere(CHAIN, ik, elsewhere, 24) == met[-1]
        raised = Ts.copy()
        raised[:, 2, 3] += 5.0
        assert not meets_somewhere(CHAIN, ik, np.concatenate([Ts, raised]), 24)
    assert all(met)
