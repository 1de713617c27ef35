"""Conventions of poses, camera axes and depth are found where surfaces agree, and said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests import optional
from tests.furnished import Camera, cloud_of, kitchen, look_at, photograph
from tests.perception.recordings.recorded import shots, write_seven_scenes

from momapos.core.errors import InputError
from momapos.core.geometry.transforms import invert
from momapos.model.records.scans import Frame
from momapos.perception.fusion.gravity import align_to_gravity, axis_up
from momapos.perception.recordings.conventions import (
    Conventions,
    Stated,
    check_poses,
    with_conventions,
)
from momapos.perception.recordings.scan_reader import UP_AXES, read_scan

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
CAMERA = Camera(320, 240, 280.0)
NOTHING = Stated()


@pytest.fixture(scope="module")
def walk() -> list[Frame]:
    """Return a walk along a kitchen, with the noise of a depth camera."""
    rng = np.random.default_rng(1)
    frames = []
    for k, along in enumerate(np.linspace(-1.8, 1.2, 14)):
        eye = (along, -2.0 + 0.3 * np.sin(2 * along), 1.4 + 0.1 * np.cos(3 * along))
        T = look_at(eye, (0.8 * along - 0.3, 0.6, 0.8))
        frame = photograph(kitchen(), T, CAMERA, noise=0.008, rng=rng)
        frames.append(replace(frame, name=f"{k:02d}"))
    return frames


def wrong(frames: list[Frame], how: Conventions) -> list[Frame]:
    """Return frames as a reader of the usual conventions gets those of others."""
    out = []
    for frame in frames:
        T = frame.T_world_camera @ (OPENGL if how.axes == "opengl" else np.eye(4))
        T = invert(T) if how.poses == "inverted" else T
        depth = (frame.depth * (how.scale / 1000)).astype(np.float32)
        out.append(replace(frame, T_world_camera=T, depth=depth))
    return out


def assert_right(found: tuple[Frame, ...], frames: list[Frame]) -> None:
    for one, other in zip(found, frames, strict=True):
        np.testing.assert_allclose(one.T_world_camera, other.T_world_camera, atol=1e-9)
        np.testing.assert_allclose(one.depth, other.depth, rtol=1e-5)


def test_usual_conventions_are_kept_without_a_word(walk: list[Frame]) -> None:
    found, said = with_conventions(walk, 1000.0, NOTHING, "scan")
    assert_right(found, walk)
    assert said == ()


@pytest.mark.parametrize(
    ("poses", "axes", "scale"),
    [
        ("inverted", "opencv", 1000.0), ("given", "opengl", 1000.0), ("inverted", "opengl", 1000.0),
        ("given", "opencv", 5000.0), ("given", "opencv", 256.0), ("given", "opencv", 1.0),
        ("inverted", "opengl", 5000.0), ("given", "opengl", 256.0),
    ],
)  # fmt: skip
def test_other_conventions_are_found_and_said(
    walk: list[Frame], poses: str, axes: str, scale: float
) -> None:
    how = Conventions(poses, axes, scale)  # type: ignore[arg-type]
    found, (line,) = with_conventions(wrong(walk, how), 1000.0, NOTHING, "scan")
    assert_right(found, walk)
    assert line.startswith(f"scan: read with {how.text()}")
    assert "\n" not in line


@pytest.mark.parametrize("factor", [10.0, 2.0, 0.5, 0.4])
def test_a_unit_of_depth_that_nobody_uses_is_refused_with_the_option(
    walk: list[Frame], factor: float
) -> None:
    how = Conventions(scale=1000 * factor)
    with pytest.raises(InputError, match=r"^scan: .*--depth-scale") as caught:
        with_conventions(wrong(walk, how), 1000.0, NOTHING, "scan")
    assert "\n" not in str(caught.value)
    found, said = with_conventions(walk, how.scale, Stated(scale=how.scale), "scan")
    assert_right(found, walk)
    assert said == ()


def test_poses_of_another_recording_are_refused_with_the_options(walk: list[Frame]) -> None:
    rng = np.random.default_rng(0)
    frames = [
        replace(frame, T_world_camera=walk[k].T_world_camera)
        for frame, k in zip(walk, rng.permutation(len(walk)), strict=True)
    ]
    T_camera_body = np.eye(4)  # of ROS: x forward, y left, z up
    T_camera_body[:3, :3] = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
    body = [replace(f, T_world_camera=f.T_world_camera @ T_camera_body) for f in walk]
    for bad in (frames, body):
        with pytest.raises(InputError) as caught:
            with_conventions(bad, 1000.0, NOTHING, "scan")
        for option in ("--poses", "--camera-axes", "--depth-scale", "--up"):
            assert option in str(caught.value)
        assert "\n" not in str(caught.value)


def test_stated_conventions_are_not_doubted(walk: list[Frame]) -> None:
    stated = Stated("inverted", "opengl", None)
    how = Conventions("inverted", "opengl", 5000.0)
    found, _ = with_conventions(wrong(walk, how), 1000.0, stated, "scan")
    assert_right(found, walk)
    with pytest.raises(InputError, match="--poses"):
        with_conventions(wrong(walk, how), 1000.0, Stated("given", "opencv"), "scan")


def test_what_cannot_be_compared_is_kept(walk: list[Frame]) -> None:
    alone = [replace(frame, depth=None) for frame in walk]
    for frames in (alone, walk[:1], [walk[0], walk[-1]], [walk[3]] * 5):
        found, said = with_conventions(frames, 1000.0, NOTHING, "scan")
        assert [one.T_world_camera is not None for one in found] == [True] * len(frames)
        np.testing.assert_allclose(found[0].T_world_camera, frames[0].T_world_camera)
        assert said == ()


def test_a_folder_with_inverted_poses_is_read_right(walk: list[Frame], tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "scan", shots(len(walk)))
    for k, frame in enumerate(walk):
        stem = folder / f"frame-{k:06d}"
        Image.fromarray(frame.color).save(f"{stem}.color.png")
        Image.fromarray(np.rint(5000 * frame.depth).astype(np.uint16)).save(f"{stem}.depth.png")
        np.savetxt(f"{stem}.pose.txt", invert(frame.T_world_camera))
    np.savetxt(folder / "camera-intrinsics.txt", CAMERA.K)
    scan = read_scan(folder)
    assert "depth in 1/5000 m" in scan.warnings[-1]
    np.testing.assert_allclose(scan.frames[3].T_world_camera, walk[3].T_world_camera, atol=1e-6)
    assert scan.frames[3].depth == pytest.approx(walk[3].depth, abs=2e-4)
    stated = read_scan(folder, poses="inverted", depth_scale=5000.0)
    assert not any("read with" in line for line in stated.warnings)
    np.testing.assert_array_equal(scan.frames[3].T_world_camera, stated.frames[3].T_world_camera)


@pytest.mark.parametrize("jump", [(0.0, 0.0, 0.7), (0.1, 0.7, 0.1), (0.0, -0.5, 0.3)])
def test_a_jump_splits_a_recording_and_is_said(
    walk: list[Frame], tmp_path: Path, jump: tuple[float, float, float]
) -> None:
    T = np.eye(4)
    T[:3, 3] = jump
    moved = [
        replace(f, T_world_camera=T @ f.T_world_camera) if k >= 8 else f for k, f in enumerate(walk)
    ]
    assert check_poses(walk).jumps == ()  # type: ignore[union-attr]
    assert check_poses(moved).jumps == (8,)  # type: ignore[union-attr]
    folder = write_seven_scenes(tmp_path / "scan", shots(len(walk)))
    for k, frame in enumerate(moved):
        stem = folder / f"frame-{k:06d}"
        Image.fromarray(frame.color).save(f"{stem}.color.png")
        Image.fromarray(np.rint(1000 * frame.depth).astype(np.uint16)).save(f"{stem}.depth.png")
        np.savetxt(f"{stem}.pose.txt", frame.T_world_camera)
    np.savetxt(folder / "camera-intrinsics.txt", CAMERA.K)
    scan = read_scan(folder)
    assert [frame.name for frame in scan.frames] == [f"frame-{k:06d}" for k in range(8)]
    assert any("jump" in line and "frame-000008" in line for line in scan.warnings)


@pytest.mark.parametrize("axis", list(UP_AXES))
@pytest.mark.parametrize("spacing", [0.02, 0.045])
def test_a_cloud_is_turned_upright_whichever_axis_is_up(axis: str, spacing: float) -> None:
    cloud = cloud_of(kitchen(), np.random.default_rng(0), spacing)
    up = np.array(UP_AXES[axis])  # type: ignore[index]
    other = np.roll(np.abs(up), 1)
    R = np.stack([other, np.cross(up, other), up], axis=1)  # from z up to this axis
    turned = replace(cloud, points=cloud.points @ R.T, normals=cloud.normals @ R.T)
    np.testing.assert_array_equal(axis_up(turned.points, turned.normals), up)
    for T in (align_to_gravity(turned, ()), align_to_gravity(turned, (), up)):
        np.testing.assert_allclose(T[2, :3], up, atol=0.02)


def test_the_real_kitchen_tells_its_conventions(shared: Path) -> None:
    scan = read_scan(optional.there(shared / "redkitchen"))
    assert scan.warnings == ()
    for how in (Conventions("inverted"), Conventions("given", "opengl"), Conventions(scale=5000.0)):
        found, (line,) = with_conventions(wrong(list(scan.frames), how), 1000.0, NOTHING, "scan")
        assert_right(found, list(scan.frames))
        assert how.text() in line
