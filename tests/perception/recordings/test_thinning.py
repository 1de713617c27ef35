"""Large clouds are thinned, far ones are moved, sparse ones are reported, and masks still fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.furnished import cloud_of, kitchen
from tests.perception.recordings.recorded import K, shots, write_export, write_ply

from momapos.apps.cli.scan_options import ScanOptions, tools_for
from momapos.model.records.scans import Scan
from momapos.perception.pipeline import survey
from momapos.perception.recordings import ply
from momapos.perception.recordings.clouds import read_cloud
from momapos.perception.recordings.scan_reader import read_scan

UTM = np.array([691_608.0, 5_334_760.0, 519.0])
"""Munich in UTM coordinates, which are usual for laser scanners [m]."""


def write_double(path: Path, points: np.ndarray) -> Path:
    """Write points as text with enough digits, as a property of type double."""
    write_ply(path, points)
    path.write_text(path.read_text().replace("property float", "property double"))
    return path


def test_a_large_cloud_keeps_one_point_per_cell_and_tells_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform((0, 0, 0), (1, 1, 0.004), (6000, 3)), [[np.nan] * 3]])
    monkeypatch.setattr(ply, "MAX_KEPT_POINTS", 5000)
    monkeypatch.setattr(ply, "SPACING", 0.05)
    monkeypatch.setattr(ply, "_ROWS", 1000)
    cloud, warnings = read_cloud(write_ply(tmp_path / "a.ply", points))
    assert len(cloud.points) == 400
    cells = np.unique(np.floor(cloud.points[:, :2] / 0.05), axis=0)
    assert len(cells) == 400
    assert any("thinned from 6,001 to 400 points" in line for line in warnings)
    assert cloud.rows[-1] == -1
    near = np.abs(cloud.points[cloud.rows[:-1]] - points[:-1]).max(axis=1)
    assert near.max() < 0.05, "each point of the file belongs to the point of its cell"


def test_cells_grow_until_the_cloud_is_small(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    columns = dict(zip("xyz", rng.uniform(-1, 1, (3, 4000)), strict=True))
    monkeypatch.setattr(ply, "MAX_KEPT_POINTS", 300)
    kept, rows, spacing = ply.thinned(columns, np.zeros(3))
    assert len(kept) <= 300
    assert spacing > ply.SPACING
    assert (np.diff(kept) > 0).all()
    assert rows.max() == len(kept) - 1
    np.testing.assert_array_equal(rows[kept], np.arange(len(kept)))


@pytest.mark.parametrize("origin", [UTM, -UTM, np.array([0.0, 4e6, 0.0])])
def test_a_far_cloud_is_moved_and_gives_the_same_room(tmp_path: Path, origin: np.ndarray) -> None:
    points = cloud_of(kitchen(), np.random.default_rng(0), 0.05).points
    cloud, warnings = read_cloud(write_double(tmp_path / "a.ply", points + origin))
    assert cloud.origin is not None
    assert np.abs(cloud.points).max() < 10
    np.testing.assert_allclose(cloud.points + cloud.origin, points + origin, atol=1e-4)
    assert any("far from the origin" in line for line in warnings)
    seen = survey(read_scan(tmp_path / "a.ply"), tools_for_masks())
    back = np.linalg.inv(seen.T_scene_scan)
    assert np.abs(back[:3, 3] - origin).max() < 10, "the transform to the scan's frame is known"


def tools_for_masks() -> object:
    return tools_for(Scan("none", ()), ScanOptions(), None)


def test_rounded_coordinates_of_a_far_cloud_are_reported(tmp_path: Path) -> None:
    points = cloud_of(kitchen(), np.random.default_rng(0), 0.1).points
    _, warnings = read_cloud(write_ply(tmp_path / "a.ply", points + UTM))
    assert any("rounded to 0.50 m" in line and "double" in line for line in warnings)


def test_frames_move_with_their_cloud(tmp_path: Path) -> None:
    taken = [
        replace(shot, T_world_camera=shot.T_world_camera + np.pad(UTM[:, None], ((0, 1), (3, 0))))
        for shot in shots(3)
    ]
    folder = write_export(tmp_path / "scan", taken, {"intrinsic_color.txt": K})
    points = cloud_of(kitchen(), np.random.default_rng(0), 0.1).points
    write_double(folder / "scene.ply", points + UTM)
    scan = read_scan(folder)
    assert scan.origin is not None
    for frame, shot in zip(scan.frames, taken, strict=True):
        place = frame.T_world_camera[:3, 3] + scan.origin
        np.testing.assert_allclose(place, shot.T_world_camera[:3, 3], atol=1e-6)
        assert np.abs(frame.T_world_camera[:3, 3]).max() < 100
    (folder / "scene.ply").unlink()
    assert np.abs(read_scan(folder).frames[0].T_world_camera[:3, 3]).max() < 100
    assert Image.open(folder / "depth" / "0.png").size == (32, 24)


@pytest.mark.parametrize(("spacing", "is_sparse"), [(0.015, False), (0.045, True)])
def test_a_sparse_cloud_is_reported(tmp_path: Path, spacing: float, is_sparse: bool) -> None:
    points = cloud_of(kitchen(), np.random.default_rng(0), spacing).points
    _, warnings = read_cloud(write_ply(tmp_path / "a.ply", points))
    assert any("cloud is sparse" in line for line in warnings) == is_sparse


def test_masks_of_the_file_fit_a_thinned_cloud(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cloud = cloud_of(kitchen(), np.random.default_rng(0), 0.02)
    points = np.concatenate([[[np.inf] * 3], cloud.points])
    on_fridge = (cloud.points < [-2.25, 1.05, 1.8]).all(axis=1) & (cloud.points[:, 1] > 0.2)
    on_fridge &= cloud.points[:, 2] > 0.05
    labels = np.concatenate([[1], np.where(on_fridge, 7, 0)])
    np.save(tmp_path / "labels.npy", labels)
    monkeypatch.setattr(ply, "MAX_KEPT_POINTS", 20_000)
    monkeypatch.setattr(ply, "SPACING", 0.03)
    scan = read_scan(write_ply(tmp_path / "a.ply", points))
    assert len(scan.cloud.points) < 0.7 * len(points)
    tools = tools_for(scan, ScanOptions(instances=tmp_path / "labels.npy"), None)
    fridge = max(tools.segment(scan.cloud), key=lambda item: len(item.members))
    own = scan.cloud.points[fridge.members]
    assert len(np.unique(fridge.members)) == len(fridge.members)
    assert (own[:, 0] < -2.2).all()
    assert (own[:, 1] > 0.12).all()
