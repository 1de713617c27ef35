"""Areas of the floor: named, in a file, or given by corners."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from momapos.apps.cli.main import main
from momapos.core.errors import MomaposError, SceneError
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.scene.scene import Scene, find_area
from momapos.model.scene.scene_files import load_scene, save_scene

TRIANGLE = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0))


@pytest.fixture
def room() -> Scene:
    return Scene("room", (), areas={"aisle": TRIANGLE})


def test_a_scene_file_keeps_the_names_of_its_areas(room: Scene, tmp_path: Path) -> None:
    save_scene(room, tmp_path / "room.json")
    again = load_scene(tmp_path / "room.json")
    assert again.areas == {"aisle": TRIANGLE}
    assert again.warnings == ()


def test_an_area_is_found_by_name_in_a_file_or_by_its_corners(room: Scene, tmp_path: Path) -> None:
    (tmp_path / "area.json").write_text(json.dumps(TRIANGLE))
    for words in ("aisle", str(tmp_path / "area.json"), "0,0 2,0 2,1"):
        assert find_area(words, room, "--keep-in") == TRIANGLE


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        ("asle", "aisle"),
        ("0,0 1,1", "3 to"),
        ("0,0 1,1 2,2", "no area"),
        ("0,0 1,nan 2,2", "must be 2 numbers from"),
        ("0,0 1,0,3 2,2", "must be 2 numbers from"),
        ("nowhere.json", "nowhere.json"),
    ],
)
def test_an_invalid_area_is_refused_in_one_line(words: str, hint: str, room: Scene) -> None:
    with pytest.raises(MomaposError, match=hint) as refused:
        find_area(words, room, "--keep-in")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("value", [[], {"": TRIANGLE}, {"a": [[0, 0], [1, 0], [True, 1]]}, 3])
def test_areas_of_another_form_are_refused(value: object, tmp_path: Path) -> None:
    path = tmp_path / "room.json"
    head = {"format": "momapos-scene", "version": 1, "objects": []}
    path.write_text(json.dumps({**head, "areas": value}))
    with pytest.raises(SceneError, match=r"room\.json: areas"):
        load_scene(path)


def test_the_base_pose_respects_the_areas_and_the_plan_contains_them(
    tmp_path: Path, kitchen: Scene
) -> None:
    question = ["place", "open", "kitchen_small", "fridge/door_hinge", "--robot", "segway_ur5e"]
    assert main([*question, "--out", str(tmp_path / "free.json")]) == 0
    free = read_plan(tmp_path / "free.json")
    x, y, _ = free.base_pose
    area = f"{x - 0.2},{y - 0.2} {x + 0.2},{y - 0.2} {x + 0.2},{y + 0.2} {x - 0.2},{y + 0.2}"
    assert main([*question, "--keep-out", area, "--out", str(tmp_path / "plan.json")]) == 0
    plan = read_plan(tmp_path / "plan.json")
    assert plan.region.keep_out == (find_area(area, kitchen, "--keep-out"),)
    assert max(abs(plan.base_pose[0] - x), abs(plan.base_pose[1] - y)) > 0.2
    assert replace(plan.region, keep_out=()) == free.region
