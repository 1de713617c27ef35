"""Laws of rigid transforms and angles."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from momapos.core.geometry.transforms import (
    apply,
    invert,
    orthonormal,
    pose,
    pose_planar,
    pose_rpy,
    pose_wxyz,
    rotation_about,
    rotation_angle,
    rotation_of,
    wrap_angle,
)

angles = st.floats(-1e4, 1e4)
small = st.floats(-3.0, 3.0)
vectors = st.tuples(small, small, small)
axes = vectors.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))


def random_poses(count: int, rng: np.random.Generator) -> np.ndarray:
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    T[:, :3, 3] = rng.normal(size=(count, 3))
    return T


def test_the_inverse_of_a_transform_undoes_it_on_any_batch() -> None:
    Ts = random_poses(24, np.random.default_rng(0)).reshape(2, 3, 4, 4, 4)
    assert_allclose(invert(Ts) @ Ts, np.broadcast_to(np.eye(4), Ts.shape), atol=1e-12)
    assert_allclose(invert(Ts), np.linalg.inv(Ts), atol=1e-12)


def test_applying_two_transforms_equals_applying_their_product() -> None:
    rng = np.random.default_rng(1)
    A, B = random_poses(1, rng)[0], random_poses(7, rng)
    points = rng.normal(size=(5, 3))
    one_by_one = np.stack([apply(A, apply(T, points)) for T in B])
    assert_allclose(apply(A @ B, points), one_by_one, atol=1e-12)
    homogeneous = np.column_stack([points, np.ones(5)]) @ A.T
    assert_allclose(apply(A, points), homogeneous[:, :3], atol=1e-12)


@given(base=st.tuples(small, small, angles))
def test_a_planar_pose_rotates_x_by_its_yaw_and_stays_on_the_floor(
    base: tuple[float, float, float],
) -> None:
    T = pose_planar(np.array(base))
    assert_allclose(T @ [1, 0, 0, 1], [base[0] + np.cos(base[2]), base[1] + np.sin(base[2]), 0, 1])
    assert_allclose(T[:3, :3], Rotation.from_euler("z", base[2]).as_matrix(), atol=1e-9)


def test_pose_planar_accepts_batches() -> None:
    bases = np.random.default_rng(2).normal(size=(2, 3, 3))
    for index in np.ndindex(2, 3):
        assert_allclose(pose_planar(bases)[index], pose_planar(bases[index]))


@given(xyz=vectors, rpy=vectors)
def test_roll_pitch_yaw_rotate_about_fixed_axes(
    xyz: tuple[float, ...], rpy: tuple[float, ...]
) -> None:
    x, y, z = np.eye(3)
    R = rotation_about(z, rpy[2]) @ rotation_about(y, rpy[1]) @ rotation_about(x, rpy[0])
    assert_allclose(pose_rpy(xyz, rpy), pose(xyz, R), atol=1e-12)


@given(axis=axes, angle=small, length=st.floats(0.1, 10))
def test_a_quaternion_of_any_length_and_sign_gives_its_rotation(
    axis: np.ndarray, angle: float, length: float
) -> None:
    wxyz = length * np.r_[np.cos(angle / 2), np.sin(angle / 2) * axis]
    for sign in (1, -1):
        T = pose_wxyz((0.0, 0.0, 0.0), tuple(sign * wxyz))
        assert_allclose(T[:3, :3], rotation_about(axis, angle), atol=1e-9)


@given(axis=axes, angle=small, v=vectors)
def test_rotating_about_an_axis_agrees_with_rodrigues(
    axis: np.ndarray, angle: float, v: tuple[float, ...]
) -> None:
    c, s = np.cos(angle), np.sin(angle)
    expected = c * np.array(v) + s * np.cross(axis, v) + (1 - c) * (axis @ v) * axis
    assert_allclose(rotation_about(axis, angle) @ v, expected, atol=1e-9)
    batch = rotation_about(axis, np.full((2, 3), angle))
    assert_allclose(batch[1, 2] @ v, expected, atol=1e-9)


@given(axis=axes, angle=st.one_of(st.floats(0, np.pi), st.floats(1e-12, 1e-6)))
@example(axis=np.array([0.0, 0.0, 1.0]), angle=0.0)
@example(axis=np.array([0.0, 0.6, 0.8]), angle=np.pi)
def test_small_angles_between_rotations_are_exact(axis: np.ndarray, angle: float) -> None:
    """The arccos of the trace has no precision below 1e-8."""
    A = Rotation.from_rotvec([0.3, -1.0, 0.4]).as_matrix()
    B = A @ rotation_about(axis, angle)
    assert_allclose(rotation_angle(A, B), angle, rtol=1e-6, atol=1e-15 if angle == 0 else 4e-16)
    assert_allclose(rotation_angle(B, A), rotation_angle(A, B), rtol=1e-6, atol=1e-15)


@given(angle=angles)
@example(angle=np.pi)
@example(angle=-np.pi)
@example(angle=np.nextafter(np.pi, 4))
@example(angle=-np.nextafter(np.pi, 4))
@example(angle=3 * np.pi)
def test_a_wrapped_angle_is_in_range_and_equivalent(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -np.pi < wrapped <= np.pi
    assert_allclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-9)


@given(angle=st.floats(-3.14, 3.14))
def test_wrapping_preserves_an_angle_in_range(angle: float) -> None:
    assert_allclose(wrap_angle(angle), angle, atol=1e-15)
    assert_allclose(wrap_angle(np.array([[angle]]) + 2 * np.pi), [[angle]], atol=1e-14)


@given(axis=axes)
def test_an_orthonormal_vector_is_orthogonal_unit_and_deterministic(axis: np.ndarray) -> None:
    v = orthonormal(axis)
    assert abs(v @ axis) < 1e-12
    assert_allclose(np.linalg.norm(v), 1.0)
    assert_allclose(orthonormal(axis.copy()), v, atol=0)


def test_rotations_equal_those_of_scipy_to_the_last_bit() -> None:
    rng = np.random.default_rng(3)
    turns = rng.normal(size=(2000, 3)) * rng.choice([1e-5, 1e-3, 1.0, 5.0], size=(2000, 1))
    turns[:500, :2], turns[0] = 0.0, 0.0
    assert_array_equal(rotation_of(turns), Rotation.from_rotvec(turns).as_matrix())
    angles = rng.uniform(-4, 4, size=(500, 3))
    angles[:200] = np.round(angles[:200] / (np.pi / 2)) * np.pi / 2
    for rpy in angles:
        expected = Rotation.from_euler("xyz", rpy).as_matrix()
        assert_array_equal(pose_rpy((0, 0, 0), tuple(rpy))[:3, :3], expected)
    for wxyz in rng.normal(size=(500, 4)):
        expected = Rotation.from_quat(wxyz, scalar_first=True).as_matrix()
        assert_array_equal(pose_wxyz((0, 0, 0), tuple(wxyz))[:3, :3], expected)
