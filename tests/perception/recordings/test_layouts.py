"""Folders of posed images are read as written, and broken frames are counted."""

from __future__ import annotations

from contextlib import suppress
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests import optional
from tests.perception.recordings.recorded import (
    HEIGHT,
    WIDTH,
    K,
    Shot,
    shots,
    write_export,
    write_ply,
    write_seven_scenes,
)

from momapos.core.errors import FileFormatError, InputError
from momapos.perception.recordings import images, validation
from momapos.perception.recordings.images import match_color, read_depth, scaled_intrinsics
from momapos.perception.recordings.scan_reader import read_scan


def assert_same(frame: object, shot: Shot) -> None:
    np.testing.assert_array_equal(frame.color, shot.color)
    np.testing.assert_allclose(frame.depth, shot.depth / 1000, atol=1e-6)
    np.testing.assert_allclose(frame.T_world_camera, shot.T_world_camera, atol=1e-9)
    np.testing.assert_allclose(frame.intrinsics, K)


def test_every_layout_is_read_as_written(tmp_path: Path) -> None:
    taken = shots(12)
    folders = [
        write_seven_scenes(tmp_path / "seven", taken),
        write_export(
            tmp_path / "scannet", taken, {"intrinsic_color.txt": K, "intrinsic_depth.txt": K}
        ),
        write_export(tmp_path / "openmask3d", taken, {"intrinsic_color.txt": K}),
    ]
    for folder in folders:
        scan = read_scan(folder)
        assert (scan.name, scan.warnings, len(scan.frames)) == (folder.name, (), 12)
        for frame, shot in zip(scan.frames, taken, strict=True):
            assert_same(frame, shot)


def test_numbered_frames_are_sorted_by_number(tmp_path: Path) -> None:
    folder = write_export(tmp_path / "scan", shots(12), {"intrinsic_color.txt": K})
    assert [frame.name for frame in read_scan(folder).frames] == [str(i) for i in range(12)]


def test_chosen_frames_are_spread_over_the_walk_and_sharp(tmp_path: Path) -> None:
    taken = shots(21)
    for k, shot in enumerate(taken):
        if k % 5 != 2:
            shot.color[:] = 128  # nothing is sharp
    folder = write_seven_scenes(tmp_path / "scan", taken)
    names = [frame.name for frame in read_scan(folder, max_frames=5).frames]
    assert len(names) == 5
    assert names == sorted(names)
    assert {f"frame-{k:06d}" for k in (2, 7, 12, 17)} <= set(names)
    with pytest.raises(InputError, match="at least 1"):
        read_scan(folder, max_frames=0)


def test_a_sequence_of_7_scenes_without_intrinsics_gets_its_kinect_and_a_warning(
    tmp_path: Path,
) -> None:
    shot = shots(1)[0]
    large = Shot(
        np.tile(shot.color, (20, 20, 1)), np.tile(shot.depth, (20, 20)), shot.T_world_camera
    )
    large.depth[100, 100] = 65_535
    scan = read_scan(write_seven_scenes(tmp_path / "seq-01", [large], intrinsics=False))
    np.testing.assert_allclose(scan.frames[0].intrinsics, [[585, 0, 320], [0, 585, 240], [0, 0, 1]])
    assert "camera-intrinsics.txt" in scan.warnings[0]
    assert scan.frames[0].depth[100, 100] == 0


def test_intrinsics_next_to_the_sequences_are_found(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "seq-01", shots(1), intrinsics=False)
    np.savetxt(tmp_path / "camera-intrinsics.txt", K)
    scan = read_scan(folder)
    assert scan.warnings == ()
    np.testing.assert_allclose(scan.frames[0].intrinsics, K)


def image_of_rays(matrix: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return color that depends smoothly on the direction of a pixel."""
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    x, y = (u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1]
    return np.clip(128 + 120 * np.stack([x, y, x + y], -1), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("factor", [1.0, 2.0, 2.5])
def test_color_is_resampled_to_the_rays_of_depth(tmp_path: Path, factor: float) -> None:
    K_color = scaled_intrinsics(K, (WIDTH, HEIGHT), (int(WIDTH * factor), int(HEIGHT * factor)))
    K_color[0, 2] += 1.5
    color = image_of_rays(K_color, int(WIDTH * factor), int(HEIGHT * factor))
    shot = shots(1)[0]
    folder = write_export(
        tmp_path / "scan",
        [Shot(color, shot.depth, shot.T_world_camera)],
        {"intrinsic_color.txt": K_color, "intrinsic_depth.txt": K},
    )
    frame = read_scan(folder).frames[0]
    expected = image_of_rays(K, WIDTH, HEIGHT)
    inside = np.s_[3:-3, 3:-3]
    error = np.abs(frame.color[inside].astype(int) - expected[inside])
    assert frame.color.shape == (HEIGHT, WIDTH, 3)
    assert error.max() <= 4
    np.testing.assert_allclose(frame.intrinsics, K)


def test_one_matrix_belongs_to_color_and_is_scaled_to_smaller_depth(tmp_path: Path) -> None:
    shot = shots(1)[0]
    double = Shot(np.repeat(np.repeat(shot.color, 2, 0), 2, 1), shot.depth, shot.T_world_camera)
    K_double = scaled_intrinsics(K, (WIDTH, HEIGHT), (2 * WIDTH, 2 * HEIGHT))
    folder = write_export(tmp_path / "scan", [double], {"intrinsic.txt": K_double})
    frame = read_scan(folder).frames[0]
    np.testing.assert_allclose(frame.intrinsics, K)
    assert frame.color.shape[:2] == (HEIGHT, WIDTH)


def test_color_of_a_different_view_is_refused() -> None:
    aside = K.copy()
    aside[0, 2] += 25
    with pytest.raises(ValueError, match="different views"):
        match_color(np.zeros((HEIGHT, WIDTH, 3), np.uint8), aside, K, (WIDTH, HEIGHT))


def test_a_cloud_next_to_the_frames_is_read_with_them(tmp_path: Path) -> None:
    folder = write_export(tmp_path / "scan", shots(2), {"intrinsic_color.txt": K})
    points = np.random.default_rng(0).normal(size=(40, 3))
    write_ply(folder / "scene.ply", points)
    scan = read_scan(folder)
    np.testing.assert_allclose(scan.cloud.points, points, atol=1e-6)
    (folder / "depth").rename(tmp_path / "elsewhere")
    assert [frame.depth for frame in read_scan(folder).frames] == [None, None]
    (folder / "scene.ply").unlink()
    with pytest.raises(FileFormatError, match="neither depth images nor a cloud"):
        read_scan(folder)


def spoil_pose(stem: Path, text: str | None) -> None:
    file = Path(f"{stem}.pose.txt")
    file.unlink() if text is None else file.write_text(text)


BAD_POSES = {
    "absent": None,
    "not finite": "-inf " * 16,
    "not a number": "a b c d " * 4,
    "too short": "1 0 0",
    "scaled": "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1",
    "mirrored": "-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1",
    "huge": "1 " * 100_000,
    "far": "1 0 0 1e308 0 1 0 0 0 0 1 0 0 0 0 1",
    "no rotation": "1 0 1e308 0 0 1 0 0 1e308 0 1 0 0 0 0 1",
}


@pytest.mark.parametrize("text", BAD_POSES.values(), ids=BAD_POSES)
def test_a_frame_with_a_bad_pose_is_skipped_and_counted_and_all_bad_is_an_error(
    tmp_path: Path, text: str | None
) -> None:
    folder = write_seven_scenes(tmp_path / "scan", shots(4))
    spoil_pose(folder / "frame-000001", text)
    scan = read_scan(folder)
    assert [frame.name[-1] for frame in scan.frames] == ["0", "2", "3"]
    (warning,) = scan.warnings
    assert warning.startswith("skipped 1 of 4 frames because of their pose")
    assert "frame-000001.pose.txt" in warning
    for i in (0, 2, 3):
        spoil_pose(folder / f"frame-{i:06d}", text)
    with pytest.raises(FileFormatError, match="none of its 4 frames is usable"):
        read_scan(folder)


@pytest.mark.parametrize(
    ("kind", "harm"),  # a frame without its color image is not listed at all
    sorted({*product(("color", "depth"), ("cut", "empty", "text")), ("depth", "gone")}),
)
def test_a_broken_image_of_many_is_skipped_and_counted(
    tmp_path: Path, kind: str, harm: str
) -> None:
    folder = write_seven_scenes(tmp_path / "scan", shots(6))
    file = folder / f"frame-000002.{kind}.png"
    data = file.read_bytes()
    harmed = {"cut": data[: len(data) // 2], "empty": b"", "text": b"not an image"}
    file.unlink() if harm == "gone" else file.write_bytes(harmed[harm])
    scan = read_scan(folder)
    assert [frame.name[-1] for frame in scan.frames] == ["0", "1", "3", "4", "5"]
    assert scan.warnings[0].startswith("skipped 1 of 6 frames because of their images")
    assert file.name in scan.warnings[0]


@pytest.mark.parametrize(
    ("factor", "says"), [(0.001, "meters or centimeters"), (16, "a unit finer")]
)
def test_depth_in_another_unit_is_refused_unless_depth_scale_is_set(
    tmp_path: Path, factor: float, says: str
) -> None:
    taken = shots(2)
    spoilt = [
        Shot(s.color, (s.depth.astype(float) * factor).astype(np.uint16), s.T_world_camera)
        for s in taken
    ]
    folder = write_seven_scenes(tmp_path / "scan", spoilt)
    with pytest.raises(FileFormatError, match=rf"{says}.*16-bit millimeters"):
        read_scan(folder)
    assert len(read_scan(folder, depth_scale=1000 * factor).frames) == 2


def test_an_error_about_8_bit_depth_names_the_right_format(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "scan", shots(2))
    for i in range(2):
        Image.fromarray(np.full((HEIGHT, WIDTH), 7, np.uint8)).save(
            folder / f"frame-{i:06d}.depth.png"
        )
    with pytest.raises(FileFormatError, match=r"8 bits.*16-bit channel"):
        read_scan(folder)


def test_empty_depth_everywhere_is_an_error(tmp_path: Path) -> None:
    empty = [Shot(s.color, np.zeros_like(s.depth), s.T_world_camera) for s in shots(2)]
    with pytest.raises(FileFormatError, match="empty"):
        read_scan(write_seven_scenes(tmp_path / "scan", empty))


@pytest.mark.parametrize("odd", [1, 2])
def test_a_few_frames_of_another_size_are_skipped_and_a_fifth_is_an_error(
    tmp_path: Path, odd: int
) -> None:
    folder = write_seven_scenes(tmp_path / "scan", shots(10))
    for i in range(odd):
        Image.fromarray(np.zeros((9, 9, 3), np.uint8)).save(folder / f"frame-{i:06d}.color.png")
    if odd == 1:
        scan = read_scan(folder)
        assert len(scan.frames) == 9
        assert "skipped 1 of 10 frames because of their size" in scan.warnings[0]
    else:
        with pytest.raises(FileFormatError, match="different sizes"):
            read_scan(folder)


@pytest.mark.parametrize("text", ["", "1 2 3", "0 0 0 0 0 0 0 0 0", "nan " * 9, "x " * 9])
def test_bad_intrinsics_are_refused_by_name(tmp_path: Path, text: str) -> None:
    folder = write_seven_scenes(tmp_path / "scan", shots(1))
    (folder / "camera-intrinsics.txt").write_text(text)
    with pytest.raises(FileFormatError, match=r"camera-intrinsics\.txt"):
        read_scan(folder)


def test_intrinsics_of_another_size_are_refused(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "scan", shots(1))
    np.savetxt(folder / "camera-intrinsics.txt", [[585, 0, 320], [0, 585, 240], [0, 0, 1]])
    with pytest.raises(FileFormatError, match="another image size"):
        read_scan(folder)


def test_an_export_without_intrinsics_is_refused(tmp_path: Path) -> None:
    folder = write_export(tmp_path / "scan", shots(1), {})
    with pytest.raises(FileFormatError, match=r"intrinsic_color\.txt"):
        read_scan(folder)


def test_an_export_without_poses_is_refused(tmp_path: Path) -> None:
    folder = write_export(tmp_path / "scan", shots(1), {"intrinsic_color.txt": K})
    (folder / "pose").rename(tmp_path / "elsewhere")
    with pytest.raises(FileFormatError, match=r"no poses; expected pose/0\.txt"):
        read_scan(folder)


def test_images_too_large_for_memory_are_refused_before_they_are_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_seven_scenes(tmp_path / "scan", shots(4))
    monkeypatch.setattr(validation, "MAX_TOTAL_PIXELS", 3 * WIDTH * HEIGHT)
    with pytest.raises(InputError, match="max_frames=3"):
        read_scan(folder)
    monkeypatch.setattr(images, "MAX_PIXELS", WIDTH * HEIGHT - 1)
    with pytest.raises(FileFormatError, match="32 x 24 pixels"):
        read_scan(folder)


def test_integers_and_floats_become_meters_and_no_depth_becomes_zero(tmp_path: Path) -> None:
    raw = np.array([[0, 500, 65_535]], np.uint16)
    Image.fromarray(raw).save(tmp_path / "d.png")
    np.testing.assert_allclose(read_depth(tmp_path / "d.png", 500.0), [[0, 1, 0]])
    floats = np.array([[np.nan, np.inf, -1, 2]], np.float32)
    np.testing.assert_allclose(images.to_meters(floats, 1.0), [[0, 0, 0, 2]])


def test_the_real_kitchen_is_read_completely(shared: Path) -> None:
    scan = read_scan(optional.there(shared / "redkitchen"))
    assert (len(scan.frames), scan.warnings) == (50, ())
    seen = np.concatenate([f.depth[f.depth > 0] for f in scan.frames if f.depth is not None])
    assert 1.0 < np.median(seen) < 3.0
    assert seen.max() < 20


@pytest.mark.parametrize("kind", ["a file", "a folder", "a file in a folder"])
def test_a_link_out_of_the_folder_of_a_scan_is_refused(tmp_path: Path, kind: str) -> None:
    folder, outside = tmp_path / "scan", tmp_path / "outside"
    write_seven_scenes(folder, shots(6))
    outside.mkdir()
    (outside / "secret.ply").write_bytes(b"ply\n")
    link = folder / "more" / "link" if kind == "a file in a folder" else folder / "link"
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(outside if kind == "a folder" else outside / "secret.ply")
    with pytest.raises(FileFormatError, match="is a symbolic link out of the scan's folder"):
        read_scan(folder)


def test_a_link_within_the_folder_of_a_scan_is_followed(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "scan", shots(6))
    frame = next(folder.glob("*.pose.txt"))
    frame.rename(folder / "pose")
    frame.symlink_to("pose")
    assert len(read_scan(folder).frames) == len(shots(6))


def test_one_empty_depth_image_does_not_end_a_scan(tmp_path: Path) -> None:
    taken = shots(24)
    taken[5].depth[:] = 0
    scan = read_scan(write_seven_scenes(tmp_path / "scan", taken))
    assert len(scan.frames) == 23
    assert "left out 1 of 24 frames whose depth images are empty (frame-000005)" in scan.warnings
    for shot in taken:
        shot.depth[:] = 0
    with pytest.raises(FileFormatError, match="no depth image has a measured pixel"):
        read_scan(write_seven_scenes(tmp_path / "dark", taken))


def test_a_cycle_of_links_in_a_recording_is_no_error_of_the_program(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "scan", shots(12))
    (folder / "depth.txt").symlink_to("depth.txt")
    with suppress(FileFormatError):  # or the link is ignored
        read_scan(folder)
