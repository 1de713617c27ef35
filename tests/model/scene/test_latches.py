"""Laws of latches in scene files: what they say, when they count, and what is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.cupboards import (
    DOOR,
    HINGE,
    LATCHES,
    carcass,
    furniture_room,
    joint,
    latched_room,
    link,
    turning,
)

from momapos.core.errors import MomaposError
from momapos.model.records.plans import JointResistance, Latch
from momapos.model.scene.latches import latch_guess, latch_to_turn, loose_joints, part_values
from momapos.model.scene.model_copies import copied
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.grasps.task_requests import make_task, parts_of


def written(folder: Path, latch: Any, parts: list[str] | None = None) -> Path:
    """Write a room whose object has a latch, and return its file."""
    scene = furniture_room(folder, parts or LATCHES["a lever"][0])
    path = folder / "scene.json"
    save_scene(scene, path)
    data = json.loads(path.read_text())
    data["objects"][0]["latch"] = latch
    path.write_text(json.dumps(data))
    return path


@pytest.mark.parametrize("kind", LATCHES)
def test_a_latch_is_written_and_read_again(tmp_path: Path, kind: str) -> None:
    scene = load_scene(latched_room(tmp_path, kind).path or "")
    held = "slide" if kind.endswith("drawer") else "hinge"
    assert scene.object("cupboard").latch == Latch("turn", LATCHES[kind][1], held)
    assert not scene.warnings


@pytest.mark.parametrize("to", [-0.7, "-0.7rad", f"{math.degrees(-0.7):.12f}deg"])
def test_the_held_joint_is_the_one_that_moves_the_latch(tmp_path: Path, to: float | str) -> None:
    scene = load_scene(written(tmp_path, {"joint": "turn", "to": to}))
    latch = scene.object("cupboard").latch
    assert (latch.joint, latch.holds) == ("turn", "hinge")
    assert latch.to == pytest.approx(-0.7)


FOLDED = [
    carcass(), DOOR, link("flap", ((0.02, 0.3, 0.3), (0, 0.3, 0))),
    link("grip", ((0.05, 0.02, 0.02), (-0.035, 0, 0))), HINGE,
    joint("fold", "revolute", ("door", "flap"), (-0.03, 0, 0), (0, 0, 1), (0, 1)),
    joint("turn", "revolute", ("flap", "grip"), (0, 0.4, 0), (1, 0, 0), (-0.8, 0)),
    link("cam", ((0.02, 0.02, 0.02), (0, 0, 0))),
    joint(
        "follows", "revolute", ("body", "cam"), (0.2, 0, 0), (1, 0, 0), (-0.8, 0), 'joint="turn"',
    ),
]  # fmt: skip


@pytest.mark.parametrize(
    ("latch", "parts", "says"),
    [
        ({"joint": "trun", "to": -0.7}, None, "did you mean turn"),
        ({"joint": "turn", "to": 0.7}, None, "outside the limits of 'turn', -0.8 to 0"),
        ({"joint": "turn", "to": "40deg"}, None, "40deg is outside the limits"),
        ({"joint": "turn", "to": "5cm"}, None, "5cm is not an angle"),
        ({"joint": "turn", "to": "far"}, None, "latch: to: 'far' is not a value"),
        ({"joint": "turn", "to": True}, None, "must be a number"),
        ({"joint": "turn", "to": [1]}, None, "must be a number"),
        ({"joint": "turn"}, None, "latch: to is missing"),
        (["turn", -0.7], None, "must be {"),
        ({"joint": 3, "to": -0.7}, None, "joint must be text, not 3"),
        ({"joint": "turn", "to": -0.7, "holds": "turn"}, None, "cannot hold itself"),
        ({"joint": "turn", "to": -0.7, "holds": "hing"}, None, "did you mean hinge"),
        ({"joint": "turn", "to": -0.7, "holds": 1}, None, "holds must be text"),
        ({"joint": "hinge", "to": 0.7, "holds": "turn"}, None, "not on the part that 'turn' moves"),
        ({"joint": "hinge", "to": 0.7}, None, "no other joint moves 'door'"),
        ({"joint": "turn", "to": -0.7}, FOLDED, "'holds', one of hinge, fold"),
        ({"joint": "follows", "to": -0.7}, FOLDED, "follows 'turn'; name that joint"),
    ],
)
def test_what_is_no_latch_is_refused_in_one_line(
    tmp_path: Path, latch: Any, parts: list[str] | None, says: str
) -> None:
    with pytest.raises(MomaposError) as error:
        load_scene(written(tmp_path, latch, parts))
    assert says in str(error.value)
    assert "cupboard" in str(error.value)
    assert "\n" not in str(error.value)


def test_an_unknown_key_of_a_latch_is_named(tmp_path: Path) -> None:
    scene = load_scene(written(tmp_path, {"joint": "turn", "to": -0.7, "hold": "hinge"}))
    assert "did you mean 'holds'" in " ".join(scene.warnings)


def changed(scene: Scene, **values: float) -> Latch | None:
    """Return the latch to turn before the hinge, with other joint values."""
    item = scene.object("cupboard")
    return latch_to_turn(replace(item, joints={**item.joints, **values}), "hinge")


def test_a_latch_counts_only_while_its_part_is_closed_and_it_is_not_turned(tmp_path: Path) -> None:
    scene = latched_room(tmp_path, "a lever")
    latch = scene.object("cupboard").latch
    assert changed(scene) == changed(scene, turn=-0.3) == latch
    assert changed(scene, turn=-0.7) is None
    assert changed(scene, turn=-0.8) is None
    assert changed(scene, hinge=0.2) is None
    assert latch_to_turn(scene.object("cupboard"), "turn") is None


def test_a_task_without_a_joint_means_the_held_part_and_never_its_latch(tmp_path: Path) -> None:
    scene = latched_room(tmp_path, "a lever")
    assert parts_of(scene.object("cupboard")) == ["hinge"]
    assert make_task(scene, "open", "cupboard").joint == "hinge"
    assert make_task(scene, "open", "cupboard/turn").joint == "turn"


def test_values_of_a_part_include_those_of_its_latch(tmp_path: Path) -> None:
    item = latched_room(tmp_path, "a lever").object("cupboard")
    assert part_values(item, "hinge", 0.5, -0.7) == {"hinge": 0.5, "turn": -0.7}
    assert part_values(item, "hinge", 0.5) == {"hinge": 0.5}
    assert part_values(item, None, 0.0) == {}


KNOWN: Mapping[str, JointResistance] = {"hinge": JointResistance(friction=2.0)}


def test_a_copy_of_a_scene_keeps_closed_values_latches_and_resistances(tmp_path: Path) -> None:
    scene = latched_room(tmp_path, "a lever", KNOWN)
    item = scene.object("cupboard")
    shut = replace(item, model=item.model.changed(closed={"hinge": 1.6}), joints={"hinge": 1.6})
    target = tmp_path / "copy" / "scene.json"
    with copied(replace(scene, objects=(shut,)), target, tmp_path) as near:
        found = save_scene(near, target)
    again = load_scene(found.path or "").object("cupboard")
    assert again.model.closed == {"hinge": 1.6}
    assert (again.latch, again.resistance, again.joints) == (item.latch, KNOWN, {"hinge": 1.6})


def test_a_copy_of_a_scene_keeps_rest_values(tmp_path: Path) -> None:
    scene = latched_room(tmp_path, "a lever")
    item = scene.object("cupboard")
    resting = replace(item, model=item.model.changed(held={"turn": -0.2}))
    with copied(replace(scene, objects=(resting,)), tmp_path / "c/scene.json", tmp_path) as near:
        assert near.object("cupboard").model.rest["turn"] == -0.2


def _with_small_part(folder: Path, joint_text: str, size: str, at: str) -> SceneObject:
    grip = (
        f'<link name="grip"><collision><origin xyz="{at}"/><geometry><box size="{size}"/>'
        "</geometry></collision></link>"
    )
    return furniture_room(folder, [carcass(), DOOR, HINGE, grip, joint_text]).object("cupboard")


@pytest.mark.parametrize(
    ("joint_text", "size", "guessed"),
    [
        (turning("revolute", (1, 0, 0), (-0.35, 0.35)), "0.04 0.05 0.05", True),  # a knob, 40 deg
        (turning("prismatic", (0, -1, 0), (0, 0.08)), "0.02 0.16 0.02", True),  # a bolt
        (turning("revolute", (1, 0, 0), (0, 0.7)).replace("0.52", "0.1"), "0.04 0.05 0.05", False),
        (turning("revolute", (0, 0, 1), (0, 1.5)), "0.02 0.3 0.6", False),  # another leaf
        (turning("prismatic", (-1, 0, 0), (0, 0.3)), "0.04 0.05 0.05", False),  # a long travel
        (turning("revolute", (1, 0, 0), (-3.1, 3.1)), "0.04 0.05 0.05", False),  # a dial
    ],
)  # fmt: skip
def test_a_small_joint_with_a_short_range_near_the_free_edge_may_be_a_latch(
    tmp_path: Path, joint_text: str, size: str, guessed: bool
) -> None:
    item = _with_small_part(tmp_path, joint_text, size, "-0.03 0 0")
    assert latch_guess(item, "hinge") == ("turn" if guessed else "")
    assert latch_guess(item, "turn") == ""
    assert loose_joints(item, "hinge") == (["turn"] if size == "0.02 0.3 0.6" else [])
    declared = replace(item, latch=Latch("turn", 0.3, "hinge"))
    assert latch_guess(declared, "hinge") == ""
