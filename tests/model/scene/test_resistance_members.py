"""Resistance of joints in scene files and plans, and inertial data in URDFs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.commands import error_of
from tests.cupboards import DOOR, FOLLOWERS, HINGE, carcass, furniture_room

from momapos.core.errors import FileFormatError, InputError, MomaposError, UrdfError
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.plans import JointResistance, PlacementPlan, Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.reader import read_urdf

KNOWN = {"seal_force": 20.0, "friction": 2.0, "mass": 6.0, "balanced": True}


def written(folder: Path, resistance: Any, *, parts: list[str] | None = None) -> Path:
    """Write a scene file whose cupboard has known resistances."""
    scene = furniture_room(folder, parts or [carcass(), DOOR, HINGE])
    save_scene(scene, folder / "room.json")
    data = json.loads((folder / "room.json").read_text())
    data["objects"][0]["resistance"] = resistance
    (folder / "room.json").write_text(json.dumps(data))
    return folder / "room.json"


def test_known_resistances_are_read_and_saved(tmp_path: Path) -> None:
    scene = load_scene(written(tmp_path, {"hinge": KNOWN}))
    assert not scene.warnings
    assert scene.object("cupboard").resistance == {"hinge": JointResistance(**KNOWN)}  # type: ignore[arg-type]
    save_scene(scene, tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text())["objects"][0]["resistance"] == {
        "hinge": KNOWN
    }
    again = load_scene(tmp_path / "again.json")
    assert again.object("cupboard").resistance == scene.object("cupboard").resistance


def test_a_scene_without_known_resistances_is_saved_as_before(tmp_path: Path) -> None:
    save_scene(furniture_room(tmp_path, [carcass(), DOOR, HINGE]), tmp_path / "room.json")
    assert "resistance" not in (tmp_path / "room.json").read_text()


@pytest.mark.parametrize(
    ("resistance", "message"),
    [
        ([], "resistance must be {name: {...}}"),
        ({"hinge": 3}, "resistance: 'hinge' must be {...}"),
        ({"hinges": {}}, "no movable joint 'hinges'"),
        ({"hinges": {}}, "did you mean hinge"),
        ({"hinge": {"frictoin": 1}}, "did you mean friction"),
        ({"hinge": {"mass": -1}}, "resistance: 'hinge': mass must be"),
        ({"hinge": {"mass": "6kg"}}, "resistance: 'hinge': mass must be a number"),
        ({"hinge": {"friction": 1e9}}, "friction must be"),
        ({"hinge": {"balanced": "yes"}}, "balanced must be true or false"),
    ],
)
def test_unusable_resistances_are_refused_in_one_line_that_names_the_object(
    tmp_path: Path, resistance: Any, message: str
) -> None:
    path = written(tmp_path, resistance)
    with pytest.raises(MomaposError) as error:
        load_scene(path)
    assert message in str(error.value)
    assert "cupboard" in str(error.value)
    error_of("scene", "show", str(path))


def test_the_resistance_of_a_follower_is_that_of_its_leader(tmp_path: Path) -> None:
    parts, follower, leader = FOLLOWERS["a folding door"]
    path = written(tmp_path, {follower: {"friction": 1.0}}, parts=parts)
    with pytest.raises(MomaposError, match=f"follows '{leader}'; give the resistance of"):
        load_scene(path)


def test_a_scene_is_given_resistances_in_code(tmp_path: Path) -> None:
    scene = furniture_room(tmp_path, [carcass(), DOOR, HINGE])
    one, other = JointResistance(friction=1.0), JointResistance(mass=2.0)
    changed = scene.with_resistance({"cupboard": {"hinge": one}})
    assert changed.object("cupboard").resistance == {"hinge": one}
    assert not scene.object("cupboard").resistance
    again = changed.with_resistance({"cupboard": {"hinge": other}})
    assert again.object("cupboard").resistance == {"hinge": other}
    with pytest.raises(InputError, match="no movable joint 'lid'"):
        scene.with_resistance({"cupboard": {"lid": one}})


def test_resistances_travel_in_plans_and_old_plans_have_none(tmp_path: Path, fetch: Robot) -> None:
    path = written(tmp_path, {})
    plan = PlacementPlan(
        scene=str(path), robot_name="fetch", robot_urdf=str(fetch.model.urdf.path),
        base_link="base_link", tool_link="gripper_link",
        task=Task("open", "cupboard", "hinge", 1.0), status="infeasible", joints=("a",),
        resistance={"cupboard": {"hinge": JointResistance(**KNOWN)}},  # type: ignore[arg-type]
    )  # fmt: skip
    write_plan(plan, tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json").resistance == plan.resistance
    data = json.loads((tmp_path / "plan.json").read_text())
    assert data["resistance"] == {"cupboard": {"hinge": KNOWN}}
    del data["resistance"]
    (tmp_path / "old.json").write_text(json.dumps(data))
    assert read_plan(tmp_path / "old.json").resistance == {}
    for wrong in (-1.0, "much"):
        data["resistance"] = {"cupboard": {"hinge": {"friction": wrong}}}
        (tmp_path / "wrong.json").write_text(json.dumps(data))
        with pytest.raises(FileFormatError, match=r"wrong\.json: .*friction"):
            read_plan(tmp_path / "wrong.json")


def link_with(inertial: str, folder: Path) -> Path:
    shape = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
    path = folder / "box.urdf"
    path.write_text(f'<robot name="r"><link name="a">{inertial}{shape}</link></robot>')
    return path


def test_masses_and_their_centers_are_read_and_scaled_as_lengths(tmp_path: Path) -> None:
    text = '<inertial><origin xyz="0.1 0.2 -0.4"/><mass value="7.5"/></inertial>'
    link = read_urdf(link_with(text, tmp_path), scale=2.0).links["a"]
    assert link.mass == 7.5  # a scale is a factor of lengths
    np.testing.assert_allclose(link.center, [0.2, 0.4, -0.8])
    item = SceneObject.from_urdf("a", tmp_path / "box.urdf", (0, 0, 0))
    assert item.model.urdf.links["a"].mass == 7.5
    save_scene(replace(load_scene(tmp_path / "box.urdf"), objects=(item,)), tmp_path / "s.json")
    assert load_scene(tmp_path / "s.json").object("a").model.urdf.links["a"].mass == 7.5


@pytest.mark.parametrize("text", ["", '<inertial/>', *(
    f'<inertial><mass value="{v}"/></inertial>' for v in ("0", "-3", ".0")
)])  # fmt: skip
def test_zero_and_negative_masses_are_none(tmp_path: Path, text: str) -> None:
    assert read_urdf(link_with(text, tmp_path)).links["a"].mass == 0.0


@pytest.mark.parametrize("value", ["heavy", "nan", "inf", "1e9"])
def test_a_mass_that_is_no_number_is_refused(tmp_path: Path, value: str) -> None:
    path = link_with(f'<inertial><mass value="{value}"/></inertial>', tmp_path)
    with pytest.raises(UrdfError, match=f"link 'a': value='{value}' in <mass> must be"):
        read_urdf(path)
