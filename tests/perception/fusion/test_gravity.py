"""Rooms in any pose are aligned with gravity."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from tests import optional
from tests.furnished import cloud_of, kitchen, look_at, photograph

from momapos.core.errors import InputError
from momapos.core.geometry.transforms import apply, pose
from momapos.model.records.scans import Cloud, Frame
from momapos.perception.fusion.gravity import align_to_gravity
from momapos.perception.fusion.tsdf import fuse
from momapos.perception.recordings.scan_reader import read_scan

EYES = [(-1.5, -2.0, 1.5), (0.0, -2.4, 1.4), (1.5, -1.9, 1.5), (0.3, -0.5, 1.6)]
ROOM = cloud_of(kitchen(), np.random.default_rng(0), spacing=0.03)


def moved(T: Float[np.ndarray, "4 4"]) -> tuple[Cloud, list[Frame]]:
    """Return the kitchen and cameras that look down at it, in another world."""
    cloud = Cloud(apply(T, ROOM.points), ROOM.normals @ T[:3, :3].T, ROOM.colors)
    frames = [photograph([], T @ look_at(eye, (0.0, 0.5, 0.4))) for eye in EYES]
    return cloud, frames


@settings(max_examples=15)
@given(st.integers(0, 10_000))
def test_a_room_in_any_pose_is_aligned_upright_on_its_floor(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = pose(tuple(rng.uniform(-3, 3, 3)), Rotation.random(rng=rng).as_matrix())
    cloud, frames = moved(T)
    back = align_to_gravity(cloud, frames) @ T
    # The room is restored up to quarter turns about z and its origin.
    assert np.degrees(np.arccos(np.clip(back[2, 2], -1, 1))) < 0.3
    turn = np.degrees(np.arctan2(back[1, 0], back[0, 0]))
    assert abs((turn + 45) % 90 - 45) < 0.4
    assert back[2, 3] == pytest.approx(0.0, abs=0.012)


@pytest.mark.parametrize("turns", [(1, 1, 1, 1), (-1, -1, -1, -1), (0, 1, 0, -1), (0, 0, 1, 1)])
def test_the_camera_may_be_held_on_its_side(turns: tuple[int, ...]) -> None:
    T = pose((1.0, 2.0, 0.3), Rotation.from_euler("xyz", [70, 20, -40], degrees=True).as_matrix())
    cloud, frames = moved(T)
    rolled = [
        replace(
            frame,
            T_world_camera=frame.T_world_camera
            @ pose((0, 0, 0), Rotation.from_euler("z", 90.0 * turn, degrees=True).as_matrix()),
        )
        for frame, turn in zip(frames, turns, strict=True)
    ]
    back = align_to_gravity(cloud, rolled) @ T
    assert np.degrees(np.arccos(np.clip(back[2, 2], -1, 1))) < 0.3
    assert back[2, 3] == pytest.approx(0.0, abs=0.012)


@settings(max_examples=20, derandomize=True)  # 1 in 500 such walks is ambiguous
@given(
    st.integers(0, 10_000), st.floats(0.2, 0.5), st.floats(0.2, 0.4), st.sampled_from([0.0, 0.5])
)
def test_cameras_that_face_a_single_wall_are_still_taken_as_upright(
    seed: int, turning: float, nodding: float, on_side: float
) -> None:
    rng = np.random.default_rng(seed)
    frames = []
    for yaw, pitch in rng.normal((np.pi / 2, -0.4), (turning, nodding), (40, 2)):
        way = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
        roll = rng.normal(0.0, 2.0) + (90.0 if rng.random() < on_side else 0.0)
        T = look_at((0.0, -2.4, 1.4), tuple(np.array([0.0, -2.4, 1.4]) + way))
        T = T @ pose((0, 0, 0), Rotation.from_euler("z", roll, degrees=True).as_matrix())
        frames.append(photograph([], T))
    back = align_to_gravity(ROOM, frames)
    assert np.degrees(np.arccos(np.clip(back[2, 2], -1, 1))) < 0.3


def test_an_upright_room_stays_unchanged() -> None:
    cloud, frames = moved(np.eye(4))
    T = align_to_gravity(cloud, frames)
    np.testing.assert_array_equal(T[:3, :3], np.eye(3))
    np.testing.assert_allclose(T[:3, 3], 0.0, atol=0.005)


@pytest.mark.parametrize("angle", [-3.0, 2.0, 30.0])
def test_a_turned_room_gets_the_smallest_rotation_that_aligns_it(angle: float) -> None:
    cloud, frames = moved(
        pose((0, 0, 0), Rotation.from_euler("z", angle, degrees=True).as_matrix())
    )
    T = align_to_gravity(cloud, frames)
    assert np.degrees(np.arctan2(T[1, 0], T[0, 0])) == pytest.approx(-angle, abs=0.1)


def test_yaw_follows_planes_where_normals_are_biased() -> None:
    turn = Rotation.from_euler("z", 20.0, degrees=True).as_matrix()
    cloud, frames = moved(pose((0, 0, 0), turn))
    bias = Rotation.from_euler("z", 2.0, degrees=True).as_matrix()
    T = align_to_gravity(replace(cloud, normals=cloud.normals @ bias.T), frames)
    assert np.degrees(np.arctan2(T[1, 0], T[0, 0])) == pytest.approx(-20.0, abs=0.1)


def test_a_cloud_without_frames_is_assumed_to_be_roughly_upright() -> None:
    tilt = Rotation.from_euler("xy", [8.0, -5.0], degrees=True).as_matrix()
    cloud, _ = moved(pose((0, 0, 0.7), tilt))
    T = align_to_gravity(cloud, ())
    np.testing.assert_allclose((T[:3, :3] @ tilt)[2, 2], 1.0, atol=1e-4)


def test_too_few_points_are_refused() -> None:
    with pytest.raises(InputError, match="10 points"):
        align_to_gravity(
            Cloud(np.zeros((10, 3)), np.zeros((10, 3)), np.zeros((10, 3), np.uint8)), ()
        )


def test_the_real_kitchen_is_upright_within_1_5_degrees(shared: Path) -> None:
    folder = optional.there(shared / "redkitchen")
    frames = read_scan(folder).frames[::2]
    cloud = fuse(frames, voxel=0.03)
    T = align_to_gravity(cloud, frames)
    down = np.loadtxt(folder / "gravity-direction.txt")
    assert np.degrees(np.arccos(abs(T[2, :3] @ down / np.linalg.norm(down)))) < 1.5
    table = apply(T, cloud.points)
    flat = (cloud.normals @ T[2, :3] > 0.95) & (table[:, 2] > 0.65) & (table[:, 2] < 0.8)
    assert flat.sum() > 500
