"""Confidences of a scan round-trip through scene files, and invalid ones are refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from momapos.core.errors import SceneError, UnknownNameError
from momapos.model.records.scans import Confidence
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject

BOX = SceneObject.box("a", (1, 1, 1), (0, 0, 0.5), category="cabinet")


def test_confidences_round_trip(tmp_path: Path) -> None:
    sure = Confidence(0.62, 0.94)
    save_scene(
        Scene("room", (replace(BOX, confidence=sure), replace(BOX, name="b"))), tmp_path / "s.json"
    )
    first, second = load_scene(str(tmp_path / "s.json")).objects
    assert first.confidence == sure
    assert second.confidence is None


def test_confidences_of_parts_are_read_by_joint(tmp_path: Path, kitchen: Scene) -> None:
    door = kitchen.object("fridge")
    joint = next(iter(door.model.joints))
    path = tmp_path / "s.json"
    entry = {"name": "f", "category": "fridge", "pose": {"xyz": [0, 0, 0]}, "urdf": "f.urdf"}
    (tmp_path / "f.urdf").write_bytes(door.model.urdf.path.read_bytes())
    sure = {"object": 0.5, "label": 1, "joints": {joint: 0.7}, "handles": {joint: 0.25}}
    head = {"format": "momapos-scene", "version": 1, "name": "room"}
    path.write_text(json.dumps({**head, "objects": [{**entry, "confidence": sure}]}))
    (item,) = load_scene(str(path)).objects
    assert item.confidence == Confidence(0.5, 1.0, {joint: 0.7}, {joint: 0.25})
    assert load_scene(str(path)).warnings == ()


@pytest.mark.parametrize(
    ("value", "error", "hint"),
    [
        ([], SceneError, "confidence must be"),
        ({"object": 0.5}, SceneError, "label is missing; it must be a number"),
        ({"object": 2, "label": 0}, SceneError, "a number from 0 to 1"),
        ({"object": True, "label": 0}, SceneError, "a number from 0 to 1"),
        ({"object": 0, "label": 0, "joints": [1]}, SceneError, "joints must be"),
        ({"object": 0, "label": 0, "handles": {"door": 1}}, UnknownNameError, "'door'"),
    ],
)
def test_an_invalid_confidence_is_refused(value, error, hint: str, tmp_path: Path) -> None:
    path = tmp_path / "s.json"
    save_scene(Scene("room", (BOX,)), path)
    data = json.loads(path.read_text())
    data["objects"][0]["confidence"] = value
    path.write_text(json.dumps(data))
    with pytest.raises(error, match=hint):
        load_scene(str(path))
