"""Laws of the steps of inverse kinematics: angles solve their equation, slopes predict motions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from tests.model.collision.exact_hulls import directions, random_states, rotations
from tests.model.kinematics import arms

from momapos.core.geometry.transforms import pose, rotation_about
from momapos.model.kinematics.chain import forward, stand_at_origin
from momapos.model.kinematics.closed_forms import mul, mul_t, rot, sp1, sp3, sp4
from momapos.model.kinematics.ik import (
    arm_arrays,
    build_ik,
    ik_scratch,
    jacobian,
    nearest_seeds,
    one_turn,
    pose_features,
    rotation_error,
    solve_spd,
)

seeds = st.integers(0, 2**32 - 1)


def turn(axis: np.ndarray, angle: float, v: np.ndarray) -> np.ndarray:
    return np.asarray(rotation_about(axis, np.array(angle)) @ v)


@settings(max_examples=50)
@given(seeds)
def test_angles_solve_the_equation_of_their_subproblem(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k, h = directions(2, rng)
    p = rng.normal(size=3)
    angle, length = rng.uniform(-np.pi, np.pi), rng.uniform(0.1, 2.0)
    there = turn(k, angle, p)
    assert_allclose(rot(tuple(k), angle, tuple(p)), there, atol=1e-12)
    assert_allclose(turn(k, sp1(tuple(p), tuple(there), tuple(k)), p), there, atol=1e-9)
    count, *found = sp4(tuple(h), tuple(p), tuple(k), float(h @ there))
    assert count == 2
    assert_allclose([h @ turn(k, one, p) for one in found], h @ there, atol=1e-6)
    assert np.abs(np.exp(1j * np.array(found)) - np.exp(1j * angle)).min() < 1e-3
    other = there + length * directions(1, rng)[0]
    count, *found = sp3(tuple(p), tuple(other), tuple(k), length)
    assert count == 2
    away = [np.linalg.norm(turn(k, one, p) - other) for one in found]
    assert_allclose(away, length, atol=1e-6)
    beyond = float(np.linalg.norm(p) + np.linalg.norm(other)) + 0.01
    assert sp3(tuple(p), tuple(other), tuple(k), beyond)[0] == 0
    assert sp4(tuple(h), tuple(p), tuple(k), float(np.linalg.norm(p)) + 0.01)[0] == 0
    assert sp4(tuple(h), tuple(p), tuple(k), -float(np.linalg.norm(p)) - 0.01)[0] == 0


@pytest.mark.parametrize(("off", "count"), [(0.0, 2), (0.01, 0), (-0.01, 0)])
def test_a_point_on_the_axis_has_all_angles_or_none(off: float, count: int) -> None:
    h, k = directions(2, np.random.default_rng(0))
    p = 0.7 * k
    assert sp4(tuple(h), tuple(p), tuple(k), float(h @ p) + off)[0] == count


@pytest.mark.parametrize("seed", range(5))
def test_small_systems_and_matrices_agree_with_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    M, b, v = rng.normal(size=(6, 6)), rng.normal(size=6), rng.normal(size=3)
    A = M @ M.T + 0.1 * np.eye(6)
    x = b.copy()
    solve_spd(A.copy(), x)
    assert_allclose(x, np.linalg.solve(A, b), atol=1e-9)
    R = rotations(1, rng)[0]
    assert_allclose(mul(R, tuple(v)), R @ v)
    assert_allclose(mul_t(R, tuple(v)), R.T @ v)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.0, np.pi - 1e-6, np.pi])
def test_the_rotation_error_turns_the_tool_to_its_target(angle: float) -> None:
    rng = np.random.default_rng(1)
    R, tool = rotations(2, rng)
    target = rotation_about(directions(1, rng)[0], np.array(angle)) @ R @ tool
    error = np.zeros(6)
    rotation_error(R, tool, target, error)
    assert np.linalg.norm(error[3:]) == pytest.approx(angle, abs=1e-6)
    if angle < np.pi:
        assert_allclose(Rotation.from_rotvec(error[3:]).as_matrix() @ R @ tool, target, atol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_the_jacobian_of_geared_joints_predicts_small_motions(seed: int) -> None:
    """A column of -1 is a degree of freedom that does not move."""
    rng, chain = np.random.default_rng(seed), arms.geared(seed)
    q = rng.uniform(-1.0, 1.0, chain.size)
    scratch = ik_scratch(arm_arrays(chain, build_ik(chain)))
    R, p = scratch.newton.R, scratch.newton.p
    stand_at_origin(R, p)
    forward(q, chain.arrays, R, p)
    T = chain.tool_poses(q)
    column, J = np.array([0, -1, 1, 2]), np.full((6, 3), np.nan)
    jacobian(chain.arrays, R, p, tuple(T[:3, 3]), column, 3, J)
    for freedom, a in ((0, 0), (2, 1), (3, 2)):
        step = 1e-6 * np.eye(chain.size)[freedom]
        before, after = chain.tool_poses(np.stack([q - step, q + step]))
        moved = (after[:3, 3] - before[:3, 3]) / 2e-6
        turned = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec() / 2e-6
        assert_allclose(J[:, a], np.concatenate([moved, turned]), atol=1e-6)


def test_the_seeds_of_a_pose_are_those_with_the_nearest_features() -> None:
    rng, chain = np.random.default_rng(0), arms.skew(6, 7)
    ik = build_ik(chain)
    scratch = ik_scratch(arm_arrays(chain, ik))
    for T in chain.tool_poses(random_states(chain, 10, rng)):
        nearest_seeds(
            np.ascontiguousarray(T[:3, :3]), T[:3, 3].copy(), arm_arrays(chain, ik).ik,
            scratch.order, scratch.distance,
        )  # fmt: skip
        apart = ((ik.seed_poses - pose_features(T[None])) ** 2).sum(1)
        expected = np.argsort(apart)[: len(scratch.order)]
        assert_allclose(scratch.order, expected)
        assert_allclose(scratch.distance, apart[expected])


def test_30_cm_count_like_a_turn_of_43_degrees_about_an_axis_of_the_tool() -> None:
    here, moved = np.eye(4), pose((0.3, 0.0, 0.0))
    turned = pose((0.0, 0.0, 0.0), rotation_about(np.array([0.0, 0.0, 1.0]), np.array(0.75)))
    a, b, c = pose_features(np.stack([here, moved, turned]))
    assert np.linalg.norm(b - a) == pytest.approx(1.0)
    assert np.linalg.norm(c - a) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("lower", "upper", "expected"),
    [
        (-1.0, 2.0, (-1.0, 2.0)),
        (-2 * np.pi, 2 * np.pi, (-np.pi, np.pi)),
        (-np.inf, np.inf, (-np.pi, np.pi)),
        (1.0, 9.0, (1.0, 1.0 + 2 * np.pi)),
        (-9.0, -1.0, (-1.0 - 2 * np.pi, -1.0)),
        (4.0, 6.0, (4.0, 6.0)),
    ],
)
def test_one_turn_of_a_joint_contains_each_of_its_postures_once(
    lower: float, upper: float, expected: tuple[float, float]
) -> None:
    chain = arms.skew(6, 0, slides=(1,))
    low, high = chain.lower.copy(), chain.upper.copy()
    low[:3], high[:3] = (lower, 0.0, -0.5), (upper, 8.0, 0.5)  # the second one slides 8 m
    found = np.array(one_turn(replace(chain, lower=low, upper=high)))
    assert_allclose(found[:, 0], expected)
    assert_allclose(found[:, 1:3], [[0.0, -0.5], [8.0, 0.5]])
