"""Laws of the keys of scene files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from momapos.core.file_records import keys_of
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_members import MAX_IGNORED_KEYS, SceneFile, ignored_keys

SCENE_KEYS = keys_of(SceneFile)

BOX: dict[str, Any] = {"name": "crate", "pose": {"xyz": [1, 0, 0.2]}, "box": [0.4, 0.4, 0.4]}


def write(folder: Path, **members: Any) -> Path:
    path = folder / "room.json"
    head = {"format": "momapos-scene", "version": 1, "objects": [BOX]}
    path.write_text(json.dumps({**head, **members}))
    return path


@pytest.mark.parametrize(
    ("members", "where", "meant"),
    [
        ({"flor": [[0, 0], [1, 0], [1, 1]]}, "'flor'", "did you mean 'floor'?"),
        ({"Objekts": []}, "'Objekts'", "did you mean 'objects'?"),
        ({"start": {"x": 0, "y": 0, "yaw": 0, "theta": 1}}, "start: 'theta'", "'yaw'"),
        ({"objects": [{**BOX, "colour": "red"}]}, "object 0 ('crate'): 'colour'", ""),
        (
            {"objects": [{**BOX, "pose": {"xyz": [0, 0, 0], "rpy": [0, 0, 90]}}]},
            "object 0 ('crate'): pose: 'rpy'",
            "did you mean 'wxyz', a unit quaternion?",
        ),
        (
            {"objects": [{**BOX, "pose": {"xyz": [0, 0, 0], "wxzy": [1, 0, 0, 0]}}]},
            "pose: 'wxzy'",
            "did you mean 'wxyz'?",
        ),
        (
            {"objects": [{**BOX, "confidence": {"object": 1, "label": 1, "lable": 1}}]},
            "confidence: 'lable'",
            "did you mean 'label'?",
        ),
    ],
)
def test_an_unknown_key_at_any_depth_is_reported_with_its_place(
    members: dict[str, Any], where: str, meant: str, tmp_path: Path
) -> None:
    scene = load_scene(write(tmp_path, **members))
    (warning,) = scene.warnings
    assert f"{where} is not known and was ignored" in warning
    assert meant in warning
    assert [str(key) for key in scene.ignored_keys] == [warning]


def test_an_unknown_key_of_a_hypothesis_is_found() -> None:
    row = {"kind": "drawer", "probability": 1, "point": [0, 0, 0], "axis": [1, 0, 0], "uper": 1}
    data = {"objects": [{**BOX, "hypotheses": {"slide": [row]}}]}
    (found,) = ignored_keys(data, SCENE_KEYS, "room.json")
    assert str(found).startswith("room.json: object 0 ('crate'): hypotheses: 'slide' 0: 'uper' is")
    assert found.object == "crate"
    assert "'upper'" in found.advice


def test_what_is_saved_has_no_unknown_key(tmp_path: Path) -> None:
    for name in ("kitchen_small", "kitchen_island"):
        scene = load_scene(name)
        assert scene.warnings == ()
        data = json.loads(scene.path.read_text()) if scene.path else {}
        assert ignored_keys(data, SCENE_KEYS, "") == ()
    saved = save_scene(load_scene(write(tmp_path)), tmp_path / "again.json")
    assert ignored_keys(json.loads(saved.path.read_text()), SCENE_KEYS, "") == ()


def test_a_million_unknown_keys_give_a_bounded_report(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path, **{f"k{i}": 0 for i in range(5_000)}))
    assert len(scene.warnings) == MAX_IGNORED_KEYS + 1
    assert "more than" in scene.warnings[-1]


@pytest.mark.parametrize("value", [None, 3, "text", [1, [2]], {"a": {"b": []}}])
def test_values_of_any_kind_are_searched_without_an_error(value: object) -> None:
    data = dict.fromkeys(SCENE_KEYS, value)
    assert len(ignored_keys(data, SCENE_KEYS, "room.json")) <= 4
    item = {"pose": value, "hypotheses": value, "confidence": value}
    assert len(ignored_keys({"objects": [item, value]}, SCENE_KEYS, "room.json")) <= 4


def test_a_scene_may_name_its_schema(tmp_path: Path) -> None:
    assert load_scene(write(tmp_path, **{"$schema": "scene.schema.json"})).warnings == ()
