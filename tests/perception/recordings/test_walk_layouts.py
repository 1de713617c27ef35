"""Folders with one file of poses are read as written, by time and by number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tests.commands import error_of
from tests.perception.recordings.recorded import K, shots, write_export, write_open3d, write_tum

from momapos.core.errors import FileFormatError
from momapos.perception.recordings.scan_reader import poses_at, read_scan


@pytest.mark.parametrize("write", [write_tum, write_open3d], ids=["TUM", "Open3D"])
def test_a_folder_with_one_file_of_poses_is_read_as_written(write, tmp_path: Path) -> None:
    taken = shots(5)
    scan = read_scan(write(tmp_path / "walk", taken))
    assert (scan.warnings, len(scan.frames)) == ((), 5)
    for frame, shot in zip(scan.frames, taken, strict=True):
        np.testing.assert_array_equal(frame.color, shot.color)
        np.testing.assert_allclose(frame.depth, shot.depth / 1000, atol=1e-6)
        np.testing.assert_allclose(frame.T_world_camera, shot.T_world_camera, atol=1e-6)
        np.testing.assert_allclose(frame.intrinsics, K)


@given(
    turn=st.tuples(*[st.floats(-2.0, 2.0)] * 3), move=st.tuples(*[st.floats(-1.0, 1.0)] * 3),
    share=st.floats(0.0, 1.0),
)  # fmt: skip
def test_poses_are_interpolated_evenly(
    turn: tuple[float, ...], move: tuple[float, ...], share: float
) -> None:
    times, poses = np.array([10.0, 10.08]), np.tile(np.eye(4), (2, 1, 1))
    poses[1, :3, :3], poses[1, :3, 3] = Rotation.from_rotvec(turn).as_matrix(), move
    if np.linalg.norm(turn) > 3.1:  # either way round
        return
    ((found,), (known,)) = poses_at(times, poses, np.array([10.0 + 0.08 * share]))
    assert known
    R = Rotation.from_rotvec(share * np.array(turn)).as_matrix()
    np.testing.assert_allclose(found[:3, :3], R, atol=1e-5)
    np.testing.assert_allclose(found[:3, 3], share * np.array(move), atol=1e-5)


def test_poses_are_not_interpolated_over_long_gaps() -> None:
    times, poses = np.array([1.0, 1.05, 2.0]), np.tile(np.eye(4), (3, 1, 1))
    _, known = poses_at(times, poses, np.array([0.9, 0.99, 1.0, 1.02, 1.5, 2.0, 2.02, 2.2]))
    assert known.tolist() == [False, True, True, True, False, True, True, False]
    _, alone = poses_at(times[:1], poses[:1], np.array([0.5, 1.0, 1.04]))
    assert alone.tolist() == [False, True, True]


def test_color_without_depth_or_pose_is_dropped_with_a_warning(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "walk", shots(6))
    rows = (folder / "depth.txt").read_text().splitlines()
    (folder / "depth.txt").write_text("\n".join(rows[:2] + rows[3:]))
    rows = (folder / "groundtruth.txt").read_text().splitlines()
    (folder / "groundtruth.txt").write_text("\n".join(rows[:9]))
    scan = read_scan(folder)
    assert len(scan.frames) == 3
    (warning,) = scan.warnings
    assert "3 of 6 color images have no depth or pose" in warning


def test_the_cameras_of_the_benchmark_are_known_and_others_assumed(tmp_path: Path) -> None:
    from PIL import Image

    for name, focal in (("rgbd_dataset_freiburg2_desk", 520.9), ("mine", 525.0)):
        folder = write_tum(tmp_path / name, shots(1))
        for image in folder.glob("*/*.png"):
            Image.open(image).resize((640, 480), 0).save(image)
        (folder / "camera-intrinsics.txt").unlink()
        scan = read_scan(folder)
        assert scan.frames[0].intrinsics[0, 0] == focal
        assert f"assumed focal length {focal:g}" in scan.warnings[0]


def test_a_folder_of_poses_takes_precedence_over_a_trajectory(tmp_path: Path) -> None:
    taken = shots(3)
    folder = write_export(tmp_path / "scan", taken, {"intrinsic_color.txt": K})
    (folder / "trajectory.log").write_text("nothing")
    assert len(read_scan(folder).frames) == 3


def spoilt(folder: Path, file: str, text: str | None) -> None:
    if text is None:
        (folder / file).unlink()
    else:
        (folder / file).write_text(text)


TUM = [
    ("groundtruth.txt", None, "has no poses; expected groundtruth.txt"),
    ("groundtruth.txt", "1 2 3\n", "groundtruth.txt:1: must have 8 columns, not 3"),
    ("groundtruth.txt", "# none\n", "has no rows"),
    ("groundtruth.txt", "1305031102 0 0 0 0 0 0 x\n", "must be numbers"),
    ("groundtruth.txt", "1305031102 0 0 nan 0 0 0 1\n", "not finite"),
    ("groundtruth.txt", "1305031102 0 0 0 0 0 0 2\n", "length is not 1"),
    ("groundtruth.txt", "7 0 0 0 0 0 0 1\n", "no pose at the time of any image"),
    ("depth.txt", "7 depth/a.png\n", "within 0.02 s"),
    ("rgb.txt", "1305031102 ../../secret.png\n", "not inside the folder"),
]
OPEN3D = [
    ("trajectory.log", "0 0 1\n1 0 0 0\n", "has 2 rows; a trajectory has five"),
    ("trajectory.log", "0 0 1\n" + "1 0 0\n" * 4, "must be a row of integers and a 4 x 4 matrix"),
    ("trajectory.log", "9 9 10\n" + "1 0 0 0\n" * 4, "of frame 9, but there are 2"),
    ("trajectory.log", "0 0 1\n" + "nan nan nan nan\n" * 4, "not finite"),
    ("trajectory.log", "0 0 1\n" + "2 0 0 0\n" * 4, "not a rigid transform"),
    ("camera_intrinsic.json", "[]", "intrinsic_matrix must be"),
    ("camera_intrinsic.json", "{", "damaged JSON"),
    ("camera_intrinsic.json", '{"intrinsic_matrix": [1,2,3,4,5,6,7,8,"a"]}', "must be numbers"),
    ("depth/00001.png", None, "2 images in color but 1 in depth"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("write", "file", "text", "message"),
    [(write_tum, *case) for case in TUM] + [(write_open3d, *case) for case in OPEN3D],
)
def test_an_unusable_folder_is_refused_in_one_line(
    write, file: str, text: str | None, message: str, tmp_path: Path
) -> None:
    folder = write(tmp_path / "walk", shots(2))
    spoilt(folder, file, text)
    with pytest.raises(FileFormatError, match=message):
        read_scan(folder)
    error_of("scan", str(folder), "--out", str(tmp_path / "scene.json"))
    assert not (tmp_path / "scene.json").exists()
