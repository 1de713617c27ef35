"""Laws of `momapos scene check`, and of what `scene show` and the page say of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from tests.commands import error_of, json_of, output_of

from momapos.apps.cli.main import main
from momapos.apps.web.words import check_lines
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.workflows.scene_check.checks import check_scene

CRATE: dict[str, Any] = {"name": "crate", "pose": {"xyz": [1, 0, 0.2]}, "box": [0.4, 0.4, 0.4]}


def write(folder: Path, *items: dict[str, Any], **members: Any) -> str:
    path = folder / "room.json"
    head = {"format": "momapos-scene", "version": 1, "objects": items}
    path.write_text(json.dumps({**head, **members}))
    return str(path)


def test_a_sane_kitchen_has_a_table_of_joints_and_no_findings() -> None:
    lines = output_of("scene", "check", "kitchen_small").splitlines()
    assert lines[0].endswith("17 objects, 13 joints")
    assert lines[1].split()[:4] == ["joint", "closed", "to", "open"]
    assert len(lines) == 1 + 1 + 13 + 1
    assert "fetch: the scene's start" in lines[-1]


def test_json_is_one_object_with_the_findings(tmp_path: Path) -> None:
    path = write(tmp_path, {**CRATE, "pose": {"xyz": [1, 0, 0.2], "quat": [1, 0, 0, 0]}})
    facts = json_of("scene", "check", path, "--json")
    assert facts["usable"] is True
    assert facts["counts"] == {"error": 0, "warning": 1, "note": 0}
    (found,) = facts["findings"]
    assert (found["kind"], found["severity"], found["object"]) == (
        "unknown key", "warning", "crate",
    )  # fmt: skip
    assert facts["floor"]["robot"] == "fetch"


@pytest.mark.parametrize("shown", [[], ["--json"]])
@pytest.mark.parametrize("start", [{"x": 1, "y": 0, "yaw": 0}, {"x": 1.3, "y": 0.2, "yaw": 1}])
def test_a_scene_that_planning_refuses_has_status_2(
    start: dict[str, float], shown: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path, CRATE, start=start)
    assert main(["scene", "check", path, *shown]) == 2
    assert "mm in crate" in capsys.readouterr().out


def test_what_cannot_be_loaded_is_one_line(tmp_path: Path) -> None:
    huge = {"name": "fridge", "category": "fridge", "pose": {"xyz": [0, 0, 900]}}
    path = write(tmp_path, {**huge, "box": [600, 700, 1800]})
    for args in (["scene", "check", path], ["scene", "check", "kitchen_smal"],
                 ["scene", "check", "kitchen_small", "--robot", "fetsch"]):  # fmt: skip
        error_of(*args)
    assert "are these millimeters (factor 0.001" in error_of("scene", "check", path)


def test_show_and_the_page_begin_with_the_warnings(tmp_path: Path, kitchen: Scene) -> None:
    floating = {**CRATE, "name": "mug", "pose": {"xyz": [2, 0, 0.5]}, "box": [0.08, 0.08, 0.1]}
    path = write(tmp_path, CRATE, floating, colour="red")
    lines = output_of("scene", "show", path).splitlines()
    assert lines[1].startswith("  check: 2 warnings; 'momapos scene check ")
    assert "'colour' is not known" in lines[2]
    assert "'mug' is in the air" in lines[3]
    assert [one["kind"] for one in json_of("scene", "show", path, "--json")["findings"]] == [
        "unknown key",
        "in the air",
    ]
    lines = check_lines(check_scene(load_scene(path)))
    assert [line.partition(":")[0] for line in lines] == ["warning", "warning"]
    assert check_lines(check_scene(kitchen)) == []
