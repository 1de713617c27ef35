"""The format of a scan is detected from its content; other files are refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.perception.recordings.recorded import shots, write_ply, write_seven_scenes

from momapos.core.errors import FileFormatError, InputError
from momapos.perception.recordings.scan_reader import read_scan


def test_a_cloud_is_recognized_by_content_and_not_by_name(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(30, 3))
    path = write_ply(tmp_path / "room.dat", points)
    scan = read_scan(path)
    assert (scan.name, scan.frames) == ("room", ())
    np.testing.assert_allclose(scan.cloud.points, points, atol=1e-6)


def test_a_folder_with_one_cloud_is_that_cloud_and_with_two_is_refused(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(30, 3))
    write_ply(tmp_path / "a.ply", points)
    scan = read_scan(tmp_path)
    assert scan.name == tmp_path.name
    assert scan.cloud is not None
    write_ply(tmp_path / "b.ply", points)
    with pytest.raises(FileFormatError, match=r"a\.ply, b\.ply"):
        read_scan(tmp_path)


def test_several_clouds_next_to_frames_are_refused(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "scan", shots(1))
    write_ply(folder / "a.ply", np.eye(3))
    write_ply(folder / "b.ply", np.eye(3))
    with pytest.raises(FileFormatError, match=r"scene\.ply"):
        read_scan(folder)


@pytest.mark.parametrize("content", [b"", b"hello", b"\x00" * 100, b"PK\x03\x04"])
def test_an_error_about_another_file_lists_the_accepted_formats(
    tmp_path: Path, content: bytes
) -> None:
    (tmp_path / "chest.ply").write_bytes(content)
    for path in (tmp_path / "chest.ply", tmp_path / "none"):
        with pytest.raises(FileFormatError, match=r"expected .*frame-000000") as caught:
            read_scan(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="not a scan"):
        read_scan(tmp_path)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_an_invalid_depth_scale_is_refused(tmp_path: Path, scale: float) -> None:
    with pytest.raises(InputError, match="depth_scale"):
        read_scan(tmp_path, depth_scale=scale)
