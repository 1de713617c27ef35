"""The paper's table on modeling takes the result files of a user's networks."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from tests import optional
from tests.real import DATA

from momapos.model.scene.scene import Scene

ROOT = Path(__file__).parents[2]
FRIDGE = "Fridge/10144"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("modeling_error")


def run(script: ModuleType, monkeypatch: pytest.MonkeyPatch, out: Path, *words: str) -> int:
    line = ["modeling_error.py", "--fridges", FRIDGE, "--out", str(out), *words]
    monkeypatch.setattr(sys, "argv", line)
    status: int = script.main()
    return status


def results(out: Path, name: str, data: Any) -> None:
    """Write a result file where the script looks for that of the fridge."""
    folder = out / "modeling" / FRIDGE.replace("/", "_")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(json.dumps(data))


@pytest.mark.parametrize(
    ("option", "data", "why"),
    [
        ("frontal", {"frame-000000": 1.5}, "must be from 0 to 1"),
        ("frontal", {"frame-000900": 0.5}, "none of its images"),
        (
            "detections",
            [{"image_id": 900, "category_id": 82, "bbox": [1, 2, 30, 40], "score": 0.9}],
            "none of its image_id",
        ),
        ("instances", {"format": "momapos-boxes", "version": 9, "boxes": []}, '"version": 1'),
    ],
)
def test_results_of_another_scan_or_version_end_with_one_line(
    script: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    option: str,
    data: Any,
    why: str,
    kitchen: Scene,
) -> None:
    monkeypatch.setattr(script, "room", lambda _: kitchen)
    results(tmp_path, "own.json", data)
    words = ("--frames", "2", f"--{option}", "own.json")
    assert run(script, monkeypatch, tmp_path, *words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert why in line
    assert "own.json" in line


@pytest.mark.slow
def test_true_boxes_in_place_of_a_network_give_the_true_sides(
    script: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    optional.there(DATA / "bestman")
    low, high = script.room(FRIDGE).object("fridge").bounds
    box = {
        "label": "fridge", "center": ((low + high) / 2).tolist(), "size": (high - low).tolist(),
    }  # fmt: skip
    results(tmp_path, "own.json", {"format": "momapos-boxes", "version": 1, "boxes": [box]})
    assert run(script, monkeypatch, tmp_path, "--instances", "own.json") == 0
    rows = json.loads((tmp_path / "modeling_error.json").read_text())
    assert rows[FRIDGE]["box from points"] < 0.02
