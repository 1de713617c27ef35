"""momapos scan refuses unusable input before the work."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

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
        (["--predictor", "urdformer"], "--checkpoint"),
        (["--models", "fridge=none.urdf"], "NAME=FILE"),
        (["--detections", "pipe"], "fifo"),
        (["--detector", "pipe.onnx"], "no such file"),
        (["--detector", "pipe"], "fifo"),
        (["--detector", "other.onnx"], "80 classes of COCO"),
        (["--detector", "yolox_nano"], "momapos models get yolox_nano"),
        (["--detector", "other.onnx", "--detections", "pipe"], "exclude each other"),
        (["--label", "fridge"], "OBJECT=LABEL"),
        (["--label", "a=fridge", "--label", "a=oven"], "names 'a' twice"),
        (["--target-at", "1,2"], "X,Y,Z in meters"),
        (["--target-at", "1,2,nan"], "X,Y,Z in meters"),
        (["--target-pixel", "frame-000000,3"], "FRAME,U,V"),
        (["--target", "a", "--target-at", "1,2,3"], "exclude each other"),
    ],
)
def test_an_option_out_of_range_is_one_line_with_the_bounds(
    words: list[str],
    hint: str,
    room: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    Path("other.onnx").write_bytes(FRONT.read_bytes())
    monkeypatch.setenv("MOMAPOS_CACHE", str(tmp_path / "cache"))
    assert main(["scan", str(room), "--out", "new/scene.json", *words]) == 2
    shown = capsys.readouterr()
    assert hint in shown.err
    assert shown.err.count("\n") == 1
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
    out: str,
    hint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("taken").mkdir()
    Path("file").write_text("mine")
    Path("report/scan_report.json").mkdir(parents=True)
    Path("models").mkdir()
    Path("models/scene_urdf").write_text("mine")
    # There is no such scan: the line about --out comes first.
    assert main(["scan", "no_scan", "--out", out]) == 2
    shown = capsys.readouterr()
    assert hint in shown.err
    assert shown.err.count("\n") == 1


def test_a_scan_that_is_a_fifo_is_refused_without_waiting(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(tmp_path / "scan.ply")
    assert main(["scan", str(tmp_path / "scan.ply"), "--out", str(tmp_path / "a.json")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (ScanOptions(), {"Detectron2": "projections", "URDFormer": "networks"}),
        (ScanOptions(detections=Path("coco.json")), {"Detectron2": "coco.json"}),
        (ScanOptions(detector="yolox_nano"), {"Detectron2": "yolox_nano"}),
        (ScanOptions(instances=Path("masks.npy")), {"Mask3D": "masks.npy"}),
        (
            ScanOptions(predictor="urdformer", checkpoint=Path("part.pth")),
            {"URDFormer": "part.pth"},
        ),
        (ScanOptions(predictor="template"), {"URDFormer": "templates"}),
    ],
)
def test_what_stands_in_for_each_network_of_the_paper_is_named(
    options: ScanOptions, names: dict[str, str]
) -> None:
    named = stand_ins(options)
    assert list(named) == ["Detectron2", "ResNet50", "URDFormer", "Mask3D"]
    assert all(text in named[network] for network, text in names.items())
