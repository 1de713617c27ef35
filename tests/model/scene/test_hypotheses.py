"""Motion hypotheses of parts are saved in scenes and checked."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from momapos.core.errors import SceneError, UnknownNameError
from momapos.model.records.scans import Hypothesis
from momapos.model.scene.object_reader import hypotheses_to_json
from momapos.model.scene.scene_files import load_scene, save_scene

LEFT = Hypothesis("door_left", 0.75, (-0.3, -0.2, 0.0), (0.0, 0.0, -1.0), 1.5)
RIGHT = Hypothesis("door_right", 0.25, (0.3, -0.2, 0.0), (0.0, 0.0, 1.0), 1.5)
DOOR = """<robot name="cupboard">
  <link name="body"><collision><geometry><box size="0.4 0.6 0.8"/></geometry></collision></link>
  <link name="door"><collision><geometry><box size="0.02 0.6 0.8"/></geometry></collision></link>
  <joint name="hinge" type="revolute"><parent link="body"/><child link="door"/>
    <origin xyz="-0.21 -0.3 0"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1.5" effort="1" velocity="1"/></joint>
</robot>"""


def written(folder: Path, hypotheses: Any) -> Path:
    """Write a scene of one cupboard with hypotheses of its hinge."""
    (folder / "cupboard.urdf").write_text(DOOR)
    item = {
        "name": "cupboard", "pose": {"xyz": [0, 0, 0.4]}, "urdf": "cupboard.urdf",
        "hypotheses": hypotheses,
    }  # fmt: skip
    path = folder / "room.json"
    data = {"format": "momapos-scene", "version": 1, "objects": [item]}
    path.write_text(json.dumps(data))
    return path


def test_hypotheses_round_trip(tmp_path: Path) -> None:
    path = written(tmp_path, {"hinge": hypotheses_to_json([LEFT, RIGHT])})
    scene = load_scene(path)
    assert scene.warnings == ()
    assert scene.object("cupboard").hypotheses == {"hinge": (LEFT, RIGHT)}
    save_scene(scene, tmp_path / "again.json")
    again = load_scene(tmp_path / "again.json").object("cupboard")
    assert again.hypotheses == scene.object("cupboard").hypotheses


def row(**changes: Any) -> dict[str, Any]:
    return {**hypotheses_to_json([replace(LEFT, probability=1.0)])[0], **changes}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([], "must be {name: a list"),
        ({"hinge": []}, "a list of values of length 1 to 16"),
        ({"hinge": [3]}, "must be {kind: ..., "),
        ({"hinge": [row(kind="lid")]}, "kind must be one of door_left"),
        ({"hinge": [row(kind=["door_left"])]}, "must be one of door_left"),
        ({"hinge": [row(probability=0.6)]}, "sum to 0.6; they must sum to 1"),
        ({"hinge": [row(), row()]}, "sum to 2; they must sum to 1"),
        ({"hinge": [row(probability=-1.0)]}, "must be a number from 0 to 1"),
        ({"hinge": [row(probability="1")]}, "probability must be a number"),
        ({"hinge": [row(axis=[0, 0, 2])]}, "axis must have length 1"),
        ({"hinge": [row(axis=[0, 0])]}, "axis must be 3 numbers"),
        ({"hinge": [row(point=[0, 0, 10**400])]}, "point must be 3 numbers from"),
        ({"hinge": [row(upper=-1)]}, "upper must be a number from 0 to 1000, not -1"),
        (
            {"hinge": [row(probability=0.3), row(kind="drawer", probability=0.7)]},
            "drawer (0.7) stands after the less probable door_left (0.3)",
        ),
        ({"hinge": [row(kind="drawer")]}, "the first is a drawer, but the joint of the URDF is"),
    ],
)
def test_invalid_hypotheses_are_refused_in_one_line(
    tmp_path: Path, value: Any, message: str
) -> None:
    with pytest.raises(SceneError) as error:
        load_scene(written(tmp_path, value))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_hypotheses_of_an_unknown_joint_suggest_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="hinge"):
        load_scene(written(tmp_path, {"hinges": [row()]}))
