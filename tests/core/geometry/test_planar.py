"""Planar poses agree with rigid transforms in three dimensions."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from momapos.core.geometry.transforms import (
    apply,
    compose,
    local_points,
    place_points,
    pose_planar,
    wrap_angle,
)

RNG = np.random.default_rng(0)
POSES = RNG.uniform(-4, 4, (30, 3))
POINTS = RNG.normal(size=(9, 2))


def test_points_are_placed_as_by_rigid_transforms() -> None:
    lifted = np.column_stack([POINTS, np.zeros(len(POINTS))])
    expected = apply(pose_planar(POSES), lifted)[..., :2]
    assert_allclose(place_points(POSES, POINTS), expected, atol=1e-12)


def test_local_points_inverts_place_points() -> None:
    for pose in POSES:
        placed = place_points(pose[None], POINTS)[0]
        assert_allclose(local_points(pose, placed), POINTS, atol=1e-12)


def test_poses_compose_as_rigid_transforms_do() -> None:
    frame = POSES[0]
    poses = compose(frame, POSES)
    assert_allclose(pose_planar(poses), pose_planar(frame) @ pose_planar(POSES), atol=1e-12)
    assert_allclose(poses[:, 2], wrap_angle(poses[:, 2]))


def test_composing_with_one_frame_each_equals_composing_one_by_one() -> None:
    poses = POSES[::-1]
    each = [compose(POSES[k], poses[k : k + 1])[0] for k in range(len(poses))]
    assert_allclose(compose(POSES, poses), each, atol=1e-12)
