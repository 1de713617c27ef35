"""Fused points lie on the surfaces in the images, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float
from tests.furnished import Corners, look_at, photograph
from tests.shapes import unchecked

from momapos.core.errors import InputError
from momapos.model.records.scans import Cloud, Frame
from momapos.perception.fusion.tsdf import FusionConfig, fuse

GROUND: Corners = ((-2.0, -2.0, -0.2), (2.0, 2.0, 0.0))
CRATE: Corners = ((-0.3, -0.3, 0.0), (0.3, 0.3, 0.5))
WORLD = [GROUND, CRATE]
EYES = [(1.6 * np.cos(a), 1.6 * np.sin(a), 1.3) for a in np.linspace(0, 2 * np.pi, 8, False)]


def around(noise: float = 0.0, seed: int = 0) -> list[Frame]:
    """Return images of the crate from all sides."""
    rng = np.random.default_rng(seed)
    return [photograph(WORLD, look_at(eye, (0, 0, 0.2)), noise=noise, rng=rng) for eye in EYES]


def off_surface(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Return the distance to the surface of ground and crate [m]."""
    low, high = np.array(CRATE)
    out = np.maximum(np.maximum(low - points, points - high), 0.0)
    inside = np.minimum(points - low, high - points).min(axis=1)
    crate = np.where(inside > 0, np.minimum(inside, 9), np.linalg.norm(out, axis=1))
    return np.minimum(crate, np.abs(points[:, 2]))


@pytest.fixture(scope="module")
def exact() -> Cloud:
    return fuse(around())


def test_points_lie_on_the_surfaces_seen(exact: Cloud) -> None:
    away = off_surface(exact.points)
    assert np.percentile(away, 95) < 0.004
    assert away.max() < 0.02


def test_every_visible_surface_gets_about_one_point_per_voxel(exact: Cloud) -> None:
    voxel = 0.015
    top = np.abs(exact.points[:, 2] - 0.5) < 0.005
    assert top.sum() == pytest.approx(0.6 * 0.6 / voxel**2, rel=0.15)


def test_normals_point_out_of_the_surface(exact: Cloud) -> None:
    top = np.abs(exact.points[:, 2] - 0.5) < 0.004
    top &= np.abs(exact.points[:, :2]).max(axis=1) < 0.25
    side = (np.abs(exact.points[:, 0] - 0.3) < 0.004) & (np.abs(exact.points[:, 1]) < 0.25)
    side &= (exact.points[:, 2] > 0.1) & (exact.points[:, 2] < 0.4)
    assert exact.normals[top, 2].min() > 0.95
    assert exact.normals[side, 0].min() > 0.9
    np.testing.assert_allclose(np.linalg.norm(exact.normals, axis=1), 1.0, atol=1e-9)


def test_colors_are_those_of_the_images(exact: Cloud) -> None:
    top = np.abs(exact.points[:, 2] - 0.5) < 0.004
    ground = np.abs(exact.points[:, :2]).max(axis=1) > 0.5
    assert np.abs(exact.colors[top].astype(int) - 50).max() <= 2
    assert np.abs(exact.colors[ground].astype(int) - 40).max() <= 2


def test_noise_of_single_images_averages_out() -> None:
    noise = 0.02
    points = fuse(around(noise)).points
    top = (np.abs(points[:, :2]).max(axis=1) < 0.25) & (points[:, 2] > 0.4)
    assert np.std(points[top, 2]) < noise / 2
    assert abs(np.mean(points[top, 2]) - 0.5) < 0.003


def test_unseen_space_behind_an_object_has_no_surface() -> None:
    frames = [photograph(WORLD, look_at((1.8, y, 0.9), (0, 0, 0.2))) for y in (-0.5, 0.0, 0.5)]
    assert off_surface(fuse(frames).points).max() < 0.025


def test_the_order_of_images_does_not_matter() -> None:
    frames = around(0.01)
    one, other = fuse(frames), fuse(frames[::-1])
    key = [np.sort(cloud.points[:, 0]) for cloud in (one, other)]
    assert abs(len(key[0]) - len(key[1])) < 0.002 * len(key[0])
    assert np.percentile(one.points, 99) == pytest.approx(np.percentile(other.points, 99), abs=1e-3)


def test_moving_the_world_moves_the_cloud() -> None:
    T = look_at((0.4, -0.2, 0.3), (1.0, 0.5, 0.2))
    frames = around()
    moved = [replace(frame, T_world_camera=T @ frame.T_world_camera) for frame in frames]
    back = (fuse(moved).points - T[:3, 3]) @ T[:3, :3]
    assert np.percentile(off_surface(back), 95) < 0.005


def test_images_without_depth_are_ignored(exact: Cloud) -> None:
    frames = around()
    more = [*frames, replace(frames[0], depth=None)]
    np.testing.assert_array_equal(fuse(more).points, exact.points)


def test_depth_that_is_not_a_number_is_ignored() -> None:
    frames = around()
    damaged = [replace(f, depth=np.where(f.depth > 2.0, np.nan, f.depth)) for f in frames]
    cloud = fuse(damaged)
    assert np.isfinite(cloud.points).all()
    assert np.isfinite(cloud.normals).all()


def test_scans_that_cannot_be_fused_are_refused_with_the_reason() -> None:
    frames = around()
    with pytest.raises(InputError, match="depth"):
        fuse([replace(frame, depth=None) for frame in frames])
    with pytest.raises(InputError, match="meters"):
        fuse([replace(frame, depth=frame.depth * 1000) for frame in frames])
    with pytest.raises(InputError, match="registered"), unchecked():
        fuse([replace(frames[0], depth=frames[0].depth[::2])])
    with pytest.raises(InputError, match="finite"):
        fuse([replace(frames[0], T_world_camera=np.full((4, 4), np.nan))])


def test_rooms_that_need_too_much_memory_are_refused() -> None:
    frames = around()
    with pytest.raises(InputError, match="larger voxels"):
        fuse(frames, config=FusionConfig(most_bytes=1_000_000))
    far = frames[0].T_world_camera.copy()
    far[:3, 3] += 1e6
    with pytest.raises(InputError, match="poses"):
        fuse([*frames, replace(frames[0], T_world_camera=far)])


@pytest.mark.parametrize("voxel", [float("nan"), 0.0, -0.01, float("inf"), 2.0])
def test_a_voxel_out_of_range_is_refused_with_the_bounds(voxel: float) -> None:
    with pytest.raises(InputError, match=r"a number from 0\.001 to 1, not"):
        fuse([photograph(WORLD, look_at(EYES[0], (0, 0, 0.2)))], voxel)
