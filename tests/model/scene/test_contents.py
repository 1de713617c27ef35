"""Laws of what rests on a part: it moves along, in the scene, in plans and in the exact check."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.commands import json_of
from tests.cupboards import SLIDE, carcass, furniture_room, joint, link, tray

from momapos.core.errors import SceneError, UnknownNameError
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.robots.robot import Robot
from momapos.model.scene.contents import resting_on
from momapos.model.scene.other_motion import as_planned
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.plan import plan_to_value
from momapos.planning.query import PlacementQuery
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.plan_check import verify_files

BOTTOM = 0.53
"""Height of the tray's upper face [m]."""
SHELF = joint("hinge", "revolute", ("body", "door"), (-0.262, -0.295, 0.45), (0, 0, 1), (0, 1.6))
DOOR = link(
    "door", ((0.02, 0.59, 0.88), (0, 0.295, 0)), ((0.08, 0.5, 0.02), (0.05, 0.295, -0.1)),
    handle=((0.02, 0.02, 0.16), (-0.04, 0.53, 0.1)),
)  # fmt: skip
FLAP = link("flap", ((0.02, 0.58, 0.5), (0, 0, 0.25)), handle=((0.02, 0.2, 0.02), (-0.05, 0, 0.45)))
LID = joint("lid", "revolute", ("body", "flap"), (-0.27, 0, 0.3), (0, -1, 0), (0, 1.57))


def item(
    name: str, height: float, xyz: tuple[float, float, float], edge: float = 0.1
) -> SceneObject:
    """Return an upright box, given the middle of its base."""
    x, y, z = xyz
    return SceneObject.box(name, (edge, edge, height), (x, y, z + height / 2))


def drawer_room(folder: Path, *items: SceneObject) -> Scene:
    """Return a room with a drawer, and items in it."""
    room = furniture_room(folder, [carcass(), tray(), SLIDE])
    return replace(room, objects=(*room.objects, *items))


def names_on(scene: Scene, name: str, joint: str) -> dict[str, str]:
    item = scene.object(name)
    return resting_on(scene.objects, item, item.model.moved_by(joint))


def test_what_rests_on_a_part_moves_with_it_also_on_something_else(tmp_path: Path) -> None:
    box = item("box", 0.05, (0.8, 0.0, BOTTOM), 0.2)
    cup = item("cup", 0.05, (0.8, 0.0, BOTTOM + 0.05), 0.06)
    above = item("above", 0.1, (0.8, 0.0, 0.9))
    floating = item("floating", 0.05, (0.65, 0.15, BOTTOM + 0.02))
    scene = drawer_room(tmp_path, box, cup, above, floating)
    assert names_on(scene, "cupboard", "slide") == {"box": "tray", "cup": "tray"}
    moved = scene.with_joint("cupboard", "slide", 0.3)
    shifts = {
        item.name: item.T_world_object[:3, 3] - scene.object(item.name).T_world_object[:3, 3]
        for item in moved.objects
    }
    for name in ("box", "cup"):
        np.testing.assert_allclose(shifts[name], [-0.3, 0.0, 0.0], atol=1e-12)
    for name in ("above", "floating", "cupboard"):
        np.testing.assert_allclose(shifts[name], 0.0, atol=1e-12)
    back = moved.with_joint("cupboard", "slide", 0.0)
    np.testing.assert_allclose(back.object("cup").T_world_object, cup.T_world_object, atol=1e-12)


def test_a_scene_may_state_what_a_thing_rests_on(tmp_path: Path) -> None:
    hung = replace(item("hung", 0.05, (0.8, 0.1, BOTTOM + 0.03)), on="cupboard/tray")
    loose = replace(item("loose", 0.05, (0.8, -0.1, BOTTOM)), on="")
    scene = save_scene(drawer_room(tmp_path, hung, loose), tmp_path / "room.json")
    entries = json.loads((tmp_path / "room.json").read_text())["objects"]
    assert [entry.get("on", "by contact") for entry in entries] == [
        "by contact", "cupboard/tray", None,
    ]  # fmt: skip
    assert names_on(load_scene(scene.path), "cupboard", "slide") == {"hung": "tray"}


@pytest.mark.parametrize(
    ("on", "words"),
    [
        ("cup", "it rests on itself, by cup on cup"),
        ("box", "it rests on itself, by box on cup on box"),
        ("cupbord/tray", "object 'cup': on; did you mean cupboard"),
        ("cupboard/trai", "no part 'trai' in cupboard; did you mean tray"),
    ],
)
def test_a_wrong_support_is_named(tmp_path: Path, on: str, words: str) -> None:
    box = replace(item("box", 0.05, (0.8, 0.1, BOTTOM)), on="cup" if on == "box" else None)
    cup = replace(item("cup", 0.05, (0.8, -0.1, BOTTOM)), on=on)
    save_scene(drawer_room(tmp_path, box, cup), tmp_path / "room.json")
    with pytest.raises((SceneError, UnknownNameError), match=words):
        load_scene(tmp_path / "room.json")


def test_a_drawer_opens_and_closes_with_what_is_in_it(tmp_path: Path, segway: Robot) -> None:
    scene = drawer_room(tmp_path, item("box", 0.2, (0.75, 0.1, BOTTOM)))
    save_scene(scene, tmp_path / "room.json")
    scene = load_scene(tmp_path / "room.json")
    opened = plan_base_placement(scene, segway, make_task(scene, "open", "cupboard/slide"))
    assert opened.plan.status == "solved"
    assert "box moves with cupboard/slide" in opened.notes
    write_plan(opened.plan, tmp_path / "plan.json")
    assert verify_files(tmp_path / "plan.json").valid
    after = scene.with_joint("cupboard", "slide", 0.4)
    closed = plan_base_placement(after, segway, make_task(after, "close", "cupboard/slide"))
    assert closed.plan.status == "solved"
    write_plan(closed.plan, tmp_path / "close.json")
    assert verify_files(tmp_path / "close.json").valid


def test_a_drawer_does_not_close_on_what_is_too_high_for_it(tmp_path: Path, segway: Robot) -> None:
    scene = drawer_room(tmp_path).with_joint("cupboard", "slide", 0.4)
    high = item("vase", 0.45, (0.35, 0.0, BOTTOM))
    scene = replace(scene, objects=(*scene.objects, high))
    answer = plan_base_placement(scene, segway, make_task(scene, "close", "cupboard/slide"))
    assert answer.plan.status == "infeasible"
    assert "vase" in str(answer.plan.candidates.rejections)


def test_a_bottle_in_the_shelf_of_a_door_swings_with_it(tmp_path: Path, segway: Robot) -> None:
    room = furniture_room(tmp_path, [carcass(), DOOR, SHELF])
    bottle = item("bottle", 0.2, (0.585, -0.1, 0.36), 0.06)
    scene = replace(room, objects=(*room.objects, bottle))
    assert names_on(scene, "cupboard", "hinge") == {"bottle": "door"}
    answer = plan_base_placement(scene, segway, make_task(scene, "open", "cupboard/hinge"))
    assert answer.plan.status == "solved"
    query = PlacementQuery.of(scene, segway, answer.plan.task)
    loaded = query.scene.object("cupboard")
    assert loaded.model.contents == {"bottle"}
    poses = loaded.link_poses({"hinge": 1.0})
    there = scene.with_joint("cupboard", "hinge", 1.0).object("bottle")
    np.testing.assert_allclose(poses["bottle"], there.T_world_object, atol=1e-12)


def test_the_hand_may_touch_the_part_and_nothing_that_rests_on_it(
    tmp_path: Path, segway: Robot
) -> None:
    room = furniture_room(tmp_path, [carcass(), DOOR, SHELF])
    bottle = item("bottle", 0.2, (0.585, -0.1, 0.36), 0.06)
    scene = replace(room, objects=(*room.objects, bottle))
    plan = plan_base_placement(scene, segway, make_task(scene, "open", "cupboard/hinge")).plan
    assert plan.base_pose is not None
    assert plan.motion is not None
    # A box where the fingers are, on the part by statement.
    x, y, z = plan.motion.Ts_world_tool[0, :3, 3].tolist()
    near = replace(item("near", 0.1, (x, y, z - 0.05), 0.05), on="cupboard/door")
    loaded = as_planned(replace(room, objects=(*room.objects, near)), plan)
    report = PlanVerifier(loaded, segway, plan.task).check(plan.base_pose, plan.motion)
    assert [check.name for check in report.violations] == ["arm collision with the scene"]


def test_what_stands_on_a_flap_would_fall(tmp_path: Path, fetch: Robot) -> None:
    room = furniture_room(tmp_path, [carcass(), FLAP, LID]).with_joint("cupboard", "lid", 1.57)
    scene = replace(room, objects=(*room.objects, item("jar", 0.1, (0.3, 0.0, 0.31))))
    assert names_on(scene, "cupboard", "lid") == {"jar": "flap"}
    answer = plan_base_placement(scene, fetch, make_task(scene, "close", "cupboard/lid"))
    assert answer.plan.status == "solved"
    assert "jar moves with cupboard/lid; it tilts by 90 deg, so it would fall" in answer.notes


def test_without_contents_the_scene_stays_the_same(tmp_path: Path, segway: Robot) -> None:
    scene = drawer_room(tmp_path, item("apart", 0.2, (0.0, 2.0, 0.0)))
    assert scene.with_contents("cupboard", "slide") is scene
    query = PlacementQuery.of(scene, segway, make_task(scene, "open", "cupboard/slide"))
    assert query.scene is scene
    assert plan_to_value(query).plan.status == "solved"


def test_the_scene_check_names_what_rests_on_parts(
    tmp_path: Path,
) -> None:
    save_scene(drawer_room(tmp_path, item("box", 0.1, (0.8, 0.1, BOTTOM))), tmp_path / "room.json")
    found = json_of("scene", "check", str(tmp_path / "room.json"), "--json")["findings"]
    assert "'box' rests on cupboard/tray and moves with cupboard/slide" in [
        one["text"] for one in found
    ]
