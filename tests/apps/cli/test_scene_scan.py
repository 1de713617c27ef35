"""momapos scene scan: its output, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.commands import error_of

from momapos.apps.cli.main import main

WORDS = ["scene", "scan", "kitchen_small", "--frames", "3", "--seed", "7"]


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scans") / "a"
    assert main([*WORDS, "--out", str(out), "--tilt", "--json"]) == 0
    return out


def test_a_scan_has_color_depth_and_pose_of_every_frame(scan: Path) -> None:
    assert np.loadtxt(scan / "camera-intrinsics.txt").shape == (3, 3)
    assert len(list(scan.iterdir())) == 3 * 3 + 2
    for k in range(3):
        color = np.array(Image.open(scan / f"frame-{k:06d}.color.jpg"))
        depth = np.array(Image.open(scan / f"frame-{k:06d}.depth.png"))
        T = np.loadtxt(scan / f"frame-{k:06d}.pose.txt")
        assert color.shape == (480, 640, 3)
        assert depth.shape == (480, 640)
        assert depth.dtype == np.uint16
        assert 300 <= np.median(depth[depth > 0]) <= 6000
        np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-9)
        assert np.linalg.det(T[:3, :3]) > 0


def test_the_ground_truth_lists_every_object_with_box_and_joints(scan: Path) -> None:
    facts = json.loads((scan / "truth.json").read_text())
    assert (facts["format"], facts["version"]) == ("momapos-scan-truth", 1)
    fridge = next(item for item in facts["objects"] if item["name"] == "fridge")
    assert fridge["category"] == "fridge"
    assert 0.5 < max(fridge["size"]) < 2.5
    assert "door_hinge" in fridge["joints"]


def test_points_of_a_tilted_scan_lie_on_the_floor_of_the_scene(scan: Path) -> None:
    T_scan_scene = np.array(json.loads((scan / "truth.json").read_text())["T_scan_scene"])
    K = np.loadtxt(scan / "camera-intrinsics.txt")
    assert np.degrees(np.arccos(T_scan_scene[2, 2])) > 5
    heights = []
    for k in range(3):
        depth = np.array(Image.open(scan / f"frame-{k:06d}.depth.png")) / 1000
        v, u = np.nonzero(depth)
        rays = np.column_stack([u, v, np.ones(len(u))]) @ np.linalg.inv(K).T * depth[v, u][:, None]
        T = np.linalg.inv(T_scan_scene) @ np.loadtxt(scan / f"frame-{k:06d}.pose.txt")
        heights.append(rays @ T[:3, :3].T[:, 2] + T[2, 3])
    height = np.concatenate(heights)
    assert (np.abs(height) < 0.05).mean() > 0.05
    assert (height < -0.15).mean() < 0.001


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path, scan: Path) -> None:
    assert main([*WORDS, "--out", str(tmp_path / "b"), "--tilt", "--json"]) == 0
    for file in scan.iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


def test_without_noise_no_depth_is_missing_on_the_furniture(tmp_path: Path) -> None:
    out = tmp_path / "exact"
    assert main([*WORDS, "--out", str(out), "--no-noise", "--json"]) == 0
    depths = [np.array(Image.open(out / f"frame-{k:06d}.depth.png")) for k in range(3)]
    assert all((depth[200:280] > 0).mean() > 0.95 for depth in depths)


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["kitchen_smal", "--out", "new"], "kitchen_small"),
        (["kitchen_small", "--out", "new", "--frames", "0"], "between 1 and"),
        (["kitchen_small", "--out", "new", "--seed", "-1"], "between 0 and"),
        (["kitchen_small", "--out", "used"], "is not empty"),
        (["kitchen_small", "--out", "used/file"], "is not a folder"),
    ],
)
def test_unusable_input_is_one_line_and_nothing_is_written(
    words: list[str], hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "file").write_text("mine")
    assert hint in error_of("scene", "scan", *words)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["file", "used"]
