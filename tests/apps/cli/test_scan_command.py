"""momapos scan refuses unusable input before the work."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of
from tests.furnished import cloud_of, kitchen
from tests.perception.recordings.recorded import write_ply

import momapos.perception.reconstruction
from momapos.apps.cli.main import main
from momapos.apps.cli.scan_options import ScanOptions, stand_ins
from momapos.apps.synthetic_scans.recording import synthetic_scan, write_scan
from momapos.model.scene.scene_files import load_scene

FRONT = Path(momapos.perception.reconstruction.__file__).parent / "weights" / "front_face.onnx"
"""A network that is no detector."""


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("room") / "scan"
    write_scan(synthetic_scan(load_scene("kitchen_small"), frames=2, seed=0), folder)
    return folder


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["--set", "scan.voxel=nan"], "scan.voxel must be a number"),
        (["--set", "scan.voxel=0"], "scan.voxel must be a number from 0.001 to 1"),
        (["--set", "scan.voxel=-0.01"], "scan.voxel must be a number from 0.001 to 1"),
        (["--set", "scan.voxel=inf"], "scan.voxel must be a number from 0.001 to 1"),
        (["--depth-scale", "nan"], "--depth-scale must be between"),
        (["--depth-scale", "0"], "--depth-scale must be between"),
        (["--max-frames", "0"], "--max-frames must be between"),
        (["--models", "fridge=none.urdf"], "NAME=FILE"),
        (["--detections", "pipe"], "fifo"),
        (["--detector", "pipe.onnx"], "no such file"),
        (["--detector", "pipe"], "fifo"),
        (["--detector", "other.onnx"], "80 classes of COCO"),
        (["--detector", "yolox_nano"], "momapos models get yolox_nano"),
        (["--detector", "other.onnx", "--detections", "pipe"], "exclude each other"),
        (["--categories", "names.json"], "--categories names the categories of --detections"),
        (["--detections", "a.json", "--categories", "names.json"], "category 3 is not among"),
        (["--detections", "b.json"], "category 95 is not among COCO's"),
        (["--detections", "c.json", "--instances", "l.npy"], "has 3-D boxes of the objects"),
        (["--instances", "l.npy"], "masks need a scan with a point cloud"),
        (["--up", "w"], "--up must be x, -x, y, -y, z or -z, not 'w'"),
        (["--poses", "sideways"], "--poses"),
        (["--camera-axes", "blender"], "--camera-axes"),
        (["--label", "fridge"], "OBJECT=LABEL"),
        (["--label", "a=fridge", "--label", "a=oven"], "names 'a' twice"),
        (["--target-at", "1,2"], "X,Y,Z in meters"),
        (["--target-at", "1,2,nan"], "X,Y,Z in meters"),
        (["--target-pixel", "frame-000000,3"], "FRAME,U,V"),
        (["--target", "a", "--target-at", "1,2,3"], "exclude each other"),
    ],
)
def test_an_option_out_of_range_is_one_line_with_the_bounds(
    words: list[str], hint: str, room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    Path("other.onnx").write_bytes(FRONT.read_bytes())
    result = {"image_id": 0, "category_id": 3, "bbox": [1, 2, 30, 40], "score": 0.9}
    corners = [[x, y, z] for z in (1, 2) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    Path("a.json").write_text(json.dumps([result]))
    Path("b.json").write_text(json.dumps([{**result, "category_id": 95}]))
    Path("c.json").write_text(json.dumps([{**result, "bbox3D": corners}]))
    Path("names.json").write_text(json.dumps([{"id": 1, "name": "oven"}]))
    if "c.json" in words:  # it has no labels, which is said on a line of its own
        words = [*words, "--categories", "three.json"]
        Path("three.json").write_text(json.dumps([{"id": 3, "name": "oven"}]))
    np.save("l.npy", np.ones(5, int))
    monkeypatch.setenv("MOMAPOS_CACHE", str(tmp_path / "cache"))
    assert hint in error_of("scan", str(room), "--out", "new/scene.json", *words)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("out", "hint"),
    [
        ("taken", "is a folder"),
        ("file/scene.json", "is not a folder"),
        ("report/scene.json", "is a folder"),
        ("models/scene.json", "is not a folder"),
    ],
)
def test_an_unwritable_output_is_refused_before_the_scan_is_read(
    out: str, hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("taken").mkdir()
    Path("file").write_text("mine")
    Path("report/scan_report.json").mkdir(parents=True)
    Path("models").mkdir()
    Path("models/scene_urdf").write_text("mine")
    # There is no such scan: the line about --out comes first.
    assert hint in error_of("scan", "no_scan", "--out", out)


def test_a_scan_that_is_a_fifo_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "scan.ply")
    error_of("scan", str(tmp_path / "scan.ply"), "--out", str(tmp_path / "a.json"))


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (ScanOptions(), {"Detectron2": "projections", "URDFormer": "networks"}),
        (ScanOptions(detections=Path("coco.json")), {"Detectron2": "coco.json"}),
        (ScanOptions(detector="yolox_nano"), {"Detectron2": "yolox_nano"}),
        (ScanOptions(instances=Path("masks.npy")), {"Mask3D": "masks.npy"}),
        (ScanOptions(predictor="template"), {"URDFormer": "templates"}),
        (ScanOptions(models=("fridge=out.urdf",)), {"URDFormer": "fridge=out.urdf, else momapos"}),
    ],
)
def test_what_stands_in_for_each_network_of_the_paper_is_named(
    options: ScanOptions, names: dict[str, str]
) -> None:
    named = stand_ins(options)
    assert list(named) == ["Detectron2", "ResNet50", "URDFormer", "Mask3D"]
    assert all(text in named[network] for network, text in names.items())


def test_instances_of_another_cloud_are_refused_with_both_counts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points = cloud_of(kitchen(), np.random.default_rng(0), 0.1).points
    cloud = write_ply(tmp_path / "a.ply", points)
    np.save(tmp_path / "labels.npy", np.ones(40, int))
    words = ["scan", str(cloud), "--instances", str(tmp_path / "labels.npy")]
    assert main([*words, "--out", str(tmp_path / "new" / "s.json")]) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert f"is for a cloud of 40 points, but this one has {len(points)}" in last
    assert not (tmp_path / "new").exists()


def test_a_cloud_with_instances_of_mask3d_says_what_was_dropped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cloud = cloud_of(kitchen(), np.random.default_rng(0), 0.06)
    fridge = (cloud.points < [-2.25, 1.05, 1.8]).all(axis=1) & (cloud.points[:, 1] > 0.2)
    fridge &= cloud.points[:, 2] > 0.03
    wall = cloud.points[:, 1] > 0.97
    masks = [(fridge, 24), (fridge, 3), (wall, 1), (np.zeros(len(wall), bool), 5)]
    (tmp_path / "pred_mask").mkdir()
    for k, (mask, _) in enumerate(masks):
        np.savetxt(tmp_path / f"pred_mask/s_{k}.txt", mask, fmt="%d")
    rows = [f"pred_mask/s_{k}.txt {number} 0.{9 - k}" for k, (_, number) in enumerate(masks)]
    (tmp_path / "s.txt").write_text("\n".join(rows) + "\n")
    source = write_ply(tmp_path / "a.ply", cloud.points)
    out = tmp_path / "new" / "s.json"
    words = ["scan", str(source), "--instances", str(tmp_path / "s.txt"), "--out", str(out)]
    assert main([*words, "--no-pictures", "--json"]) == 0
    shown = capsys.readouterr()
    data = json.loads(shown.out)
    assert [o["label"] for o in data["objects"] if o["label"] != "wall"] == ["refrigerator"]
    said = (
        "dropped 3 of 4 instances: 1 masks that repeat another, 1 parts of the building, "
        "1 with fewer than 10 points"
    )
    assert said in shown.err
    assert said in data["warnings"]
    assert load_scene(out).start is not None
