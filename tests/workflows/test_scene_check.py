"""Laws of the scene check: each kind of mistake is found, and sane rooms have none."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests import cupboards, optional, real
from tests.meshes import Box, triangles_of

from momapos.core.errors import InputError
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.workflows.scene_check.checks import check_scene
from momapos.workflows.scene_check.report import (
    Finding,
    FindingKind,
    SceneReport,
    Severity,
    finding_lines,
    report_lines,
    report_to_dict,
)

FLOOR = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])
ROBOT = load_robot("fetch")


def box(name: str, size: tuple[float, ...], xyz: tuple[float, ...], category: str = "") -> Any:
    return SceneObject.box(name, size, xyz, category=category)


def room(*items: SceneObject, **members: Any) -> Scene:
    return Scene("room", items, **{"floor_polygon": FLOOR, **members})


def urdf(folder: Path, *parts: str, name: str = "chest") -> SceneObject:
    path = folder / f"{name}.urdf"
    path.write_text(f'<robot name="{name}">{"".join(parts)}</robot>')
    return SceneObject.from_urdf(name, path, (0.5, 0.0, 0.0))


def of_kind(report: SceneReport, kind: FindingKind) -> list[Finding]:
    return [one for one in report.findings if one.kind is kind]


TABLE = box("table", (1.0, 1.0, 0.7), (0, 0, 0.35), "table")
WRONG = {
    "a crate in a table": (
        [TABLE, box("crate", (0.3, 0.3, 0.3), (0.2, 0.1, 0.75))],
        FindingKind.OVERLAP, Severity.WARNING, "crate", "overlap by 10 cm; move 'crate' by that",
    ),
    "two cabinets at one place": (
        [box("a", (0.6, 0.6, 0.9), (1, 0, 0.45)), box("b", (0.6, 0.5, 0.9), (1.1, 0, 0.45))],
        FindingKind.OVERLAP, Severity.WARNING, "b", "a/box and b/box overlap by 50 cm",
    ),
    "a shelf sunk into the floor": (
        [box("shelf", (0.8, 0.3, 1.8), (1, 0, 0.8))],
        FindingKind.BELOW_FLOOR, Severity.WARNING, "shelf", "10 cm below the floor",
    ),
    "a chair below the floor": (
        [box("chair", (0.5, 0.5, 0.9), (1, 0, -0.7))],
        FindingKind.BELOW_FLOOR, Severity.WARNING, "chair", "raise it by 115 cm to pose z 0.450",
    ),
    "a mug above a table": (
        [TABLE, box("mug", (0.08, 0.08, 0.1), (0, 0, 0.8), "mug")],
        FindingKind.IN_THE_AIR, Severity.WARNING, "mug", "lower it by 5 cm onto what is below it",
    ),
    "a tray with a cup in the air": (
        [
            box("tray", (0.4, 0.3, 0.02), (2, 0, 0.5)),
            box("cup", (0.08, 0.08, 0.1), (2, 0, 0.56), "cup"),
        ],
        FindingKind.IN_THE_AIR, Severity.WARNING, "tray", "'tray' and 'cup' are in the air, 49 cm",
    ),
    "a wall cabinet without a wall": (
        [box("cabinet", (0.3, 0.8, 0.6), (2, 0, 1.7), "cabinet")],
        FindingKind.IN_THE_AIR, Severity.NOTE, "cabinet", "right for what hangs on a wall",
    ),
    "a cup in centimeters": (
        [box("cup", (8, 8, 9.5), (0, 0, 4.75), "cup")],
        FindingKind.SIZE, Severity.WARNING, "cup", "centimeters (factor 0.01: 0.08 x 0.08 x 0.095",
    ),
    "a fridge that was scaled twice": (
        [box("fridge", (6e-4, 7e-4, 1.8e-3), (0, 0, 9e-4), "fridge")],
        FindingKind.SIZE, Severity.WARNING, "fridge", "millimeters (factor 1000: 0.6 x 0.7 x 1.8",
    ),
    "no objects": (
        [], FindingKind.NO_OBJECTS, Severity.ERROR, "", "add at least the object of a task",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_mistake_is_found_with_advice(case: str) -> None:
    items, kind, severity, name, words = WRONG[case]
    report = check_scene(room(*items))
    (found,) = [one for one in report.findings if one.kind is kind]
    assert (found.severity, found.object) == (severity, name)
    assert words in str(found)
    assert found.advice
    assert report.usable is (severity is not Severity.ERROR)


def test_what_is_normal_in_a_room_is_no_finding() -> None:
    wall = box("wall", (0.1, 6.0, 2.5), (3.05, 0, 1.25), "wall")
    other = box("back", (6.0, 0.1, 2.5), (0.05, 3.0, 1.25), "wall")
    items = [
        wall, other, TABLE,
        box("floor_tiles", (6, 6, 0.1), (0, 0, -0.05), "floor"),
        box("carpet", (2, 1, 0.01), (0, -2, 0.005)),
        box("flush", (0.6, 0.6, 0.9), (2.7, -1, 0.45), "cabinet"),
        box("beside", (0.6, 0.6, 0.9), (2.7, -1.585, 0.45), "cabinet"),
        box("upper", (0.3, 0.6, 0.6), (2.84, -1, 1.7), "cabinet"),
        box("plate", (0.2, 0.2, 0.02), (0.1, 0.1, 0.713), "plate"),
        box("apple", (0.07, 0.07, 0.07), (0.1, 0.1, 0.758), "apple"),
    ]  # fmt: skip
    assert check_scene(room(*items)).findings == ()


@pytest.mark.parametrize("name", ["kitchen_small", "kitchen_island"])
def test_the_built_in_kitchens_have_no_finding(name: str) -> None:
    report = check_scene(load_scene(name), ROBOT)
    assert report.findings == ()
    assert report.floor.is_free
    assert report.floor.reachable_share == 1.0
    assert all(one.has_handle and one.pull and one.base_reaches for one in report.joints)


# -------------------------------------------------------------------------------------- shapes


@pytest.mark.parametrize(("solid", "severity"), [("", Severity.WARNING), ("<s/>", Severity.NOTE)])
def test_what_is_only_drawn_is_found(solid: str, severity: Severity, tmp_path: Path) -> None:
    shape = '<geometry><box size="0.5 0.5 0.5"/></geometry>'
    drawn = f'<link name="top"><visual>{shape}</visual></link>'
    base = f'<link name="base">{solid and f"<collision>{shape}</collision>"}</link>'
    joint = '<joint name="j" type="fixed"><parent link="base"/><child link="top"/></joint>'
    found = of_kind(check_scene(room(urdf(tmp_path, base, drawn, joint))), FindingKind.NO_SHAPE)
    if found:  # a reader that lets drawn shapes stand in leaves none
        assert found[0].severity is severity
        assert "only drawn" in found[0].text


def test_an_object_without_any_shape_is_found(tmp_path: Path) -> None:
    report = check_scene(room(TABLE, urdf(tmp_path, '<link name="base"/>')))
    (found,) = of_kind(report, FindingKind.NO_SHAPE)
    assert "'chest' has no shape" in found.text
    assert "<collision>" in found.advice


U_SHAPE: tuple[Box, ...] = (
    ((0, 0, 0), (1, 0.05, 0.8)), ((0, 0.95, 0), (1, 1, 0.8)), ((0, 0, 0.75), (1, 1, 0.8)),
)  # fmt: skip
TRAY: tuple[Box, ...] = (
    ((0, 0, 0), (0.5, 0.5, 0.02)), ((0, 0, 0), (0.02, 0.5, 0.2)), ((0.48, 0, 0), (0.5, 0.5, 0.2)),
    ((0, 0, 0), (0.5, 0.02, 0.2)), ((0, 0.48, 0), (0.5, 0.5, 0.2)),
)  # fmt: skip
SOLID: tuple[Box, ...] = (((0, 0, 0), (1, 1, 0.8)),)


@pytest.mark.parametrize(
    ("boxes", "ratio"), [(U_SHAPE, 0.8 / 0.125), (TRAY, 0.05 / 0.0126), (SOLID, None)]
)
def test_a_hull_that_fills_free_space_is_found(
    boxes: tuple[Box, ...], ratio: float | None, tmp_path: Path
) -> None:
    corners = triangles_of(boxes).reshape(-1, 3)
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}" for k in range(len(corners) // 3)]
    (tmp_path / "body.obj").write_text("\n".join(lines))
    mesh = '<geometry><mesh filename="body.obj"/></geometry>'
    still = f'<link name="base"><collision>{mesh}</collision></link>'
    assert not of_kind(check_scene(room(urdf(tmp_path, still))), FindingKind.HULL)
    slide = (
        '<link name="rail"/><joint name="slide" type="prismatic"><parent link="rail"/>'
        '<child link="base"/><axis xyz="-1 0 0"/><limit lower="0" upper="0.3"/></joint>'
    )
    item = urdf(tmp_path, still + slide)
    found = of_kind(check_scene(room(item)), FindingKind.HULL)
    if ratio is None:
        assert not found
        return
    assert "chest/base: the convex hull of collision element 0 (body.obj) is" in found[0].text
    stated = float(found[0].text.partition(") is ")[2].split()[0])
    assert stated == pytest.approx(ratio, rel=0.15)


@pytest.mark.parametrize("size", [0.005, 0.4])
def test_a_tiny_floor_is_found(size: float) -> None:
    (found,) = of_kind(
        check_scene(replace(room(TABLE), floor_polygon=FLOOR / 6 * size)), FindingKind.ROOM_SIZE
    )
    assert "the floor measures" in found.text
    assert found.advice


# ---------------------------------------------------------------------------------------- file


def test_unknown_keys_and_assumptions_of_the_reader_are_findings(tmp_path: Path) -> None:
    item = {"name": "crate", "pose": {"xyz": [1, 0, 0.2], "rpy": [0, 0, 1]}, "box": [0.4] * 3}
    head = {"format": "momapos-scene", "version": 1, "objects": [item], "flor": []}
    (tmp_path / "room.json").write_text(json.dumps(head))
    scene = load_scene(tmp_path / "room.json")
    keys = of_kind(check_scene(scene), FindingKind.UNKNOWN_KEY)
    assert [str(key) for key in keys] == [
        "'flor' is not known and was ignored; did you mean 'floor'?",
        "object 0 ('crate'): pose: 'rpy' is not known and was ignored; did you mean 'wxyz', a unit "
        "quaternion?",
    ]
    assert [key.object for key in keys] == ["", "crate"]
    assumed = replace(scene, warnings=(*scene.warnings, "something was assumed"))
    (note,) = of_kind(check_scene(assumed), FindingKind.READER)
    assert (note.severity, note.text) == (Severity.NOTE, "something was assumed")


# -------------------------------------------------------------------------------------- joints


def only_joint(report: SceneReport, name: str) -> Any:
    return next(one for one in report.joints if one.joint == name)


def test_a_door_has_its_ends_handle_and_pull(tmp_path: Path) -> None:
    handle: cupboards.Box = ((0.02, 0.02, 0.16), (-0.05, 0.55, 0.1))
    door = cupboards.link("door", cupboards.LEAF, handle=handle)
    scene = cupboards.furniture_room(tmp_path, [cupboards.carcass(), door, cupboards.HINGE])
    one = only_joint(check_scene(scene), "hinge")
    assert (one.closed, one.wide, one.value) == (0.0, 1.6, 0.0)
    assert one.has_handle
    assert "'handle', by its name" in one.handle
    assert one.handle_xyz == pytest.approx((0.8 - 0.262 - 0.05, -0.295 + 0.55, 0.45 + 0.1))
    assert 1.0 < one.pull < 60.0


def test_a_part_without_a_handle_is_a_note(tmp_path: Path) -> None:
    for parts, joint in (
        ([cupboards.carcass(), cupboards.DOOR, cupboards.HINGE], "hinge"),
        ([cupboards.carcass(), cupboards.half_door("right", -1), cupboards.RIGHT], "right"),
    ):
        report = check_scene(cupboards.furniture_room(tmp_path, parts, name=joint))
        (found,) = of_kind(report, FindingKind.NO_HANDLE)
        assert found.severity is Severity.NOTE
        assert found.joint == joint
        assert not only_joint(report, joint).has_handle


@pytest.mark.parametrize("case", cupboards.FOLLOWERS)
def test_a_follower_names_its_leader_and_nothing_else(case: str, tmp_path: Path) -> None:
    parts, follower, leader = cupboards.FOLLOWERS[case]
    report = check_scene(cupboards.furniture_room(tmp_path, parts))
    one = only_joint(report, follower)
    assert one.follows
    assert one.pull is None
    assert not only_joint(report, leader).follows
    assert any(f"follows {one.follows}" in line for line in report_lines(report))
    assert not [f for f in report.findings if f.joint == follower]


@pytest.mark.parametrize(
    ("kind", "limits", "words"),
    [("revolute", (0, 0), "range of zero"), ("prismatic", (0, 0.3), "")],
)
def test_a_joint_that_moves_nothing_is_found(
    kind: str, limits: tuple[float, float], words: str, tmp_path: Path
) -> None:
    ghost = '<link name="ghost"/>'
    joint = cupboards.joint("odd", kind, ("body", "ghost"), (0, 0, 0.5), (0, 0, 1), limits)
    report = check_scene(cupboards.furniture_room(tmp_path, [cupboards.carcass(), ghost, joint]))
    (found,) = of_kind(report, FindingKind.JOINT)
    assert "cupboard/odd" in found.text
    assert words in found.text
    assert found.advice


# --------------------------------------------------------------------------------------- start


def test_a_blocked_start_makes_a_scene_unusable() -> None:
    for at in ((0.3, 0.0), (2.9, 0.0)):  # in the table, and over the edge of the floor
        report = check_scene(room(TABLE, start=np.array([*at, 0.0])), ROBOT)
        (found,) = of_kind(report, FindingKind.START)
        assert found.severity is Severity.ERROR
        assert report.findings[0] is found
        assert not report.usable
        assert not report.floor.is_free


def test_a_room_in_which_the_robot_fits_nowhere_is_unusable() -> None:
    report = check_scene(replace(room(TABLE), floor_polygon=FLOOR / 6), ROBOT)
    (found,) = of_kind(report, FindingKind.START)
    assert "fits nowhere" in found.text
    assert report.floor.start is None
    assert json.dumps(report_to_dict(report), allow_nan=False)


@pytest.mark.parametrize("gap", [0.3, 0.5])
def test_what_is_behind_a_narrow_passage_is_out_of_reach(gap: float, tmp_path: Path) -> None:
    length = 3.0 - gap / 2
    sides = [box(f"w{s}", (0.1, length, 2.0), (-0.8, s * (gap + length) / 2, 1.0)) for s in (1, -1)]
    scene = cupboards.furniture_room(
        tmp_path, [cupboards.carcass(), cupboards.tray(), cupboards.SLIDE]
    )
    start = np.array([-2.0, 0.0, 0.0])
    whole = replace(scene, floor_polygon=FLOOR, start=start)
    behind = replace(whole, objects=(*whole.objects, *sides))
    driving = of_kind(check_scene(behind, ROBOT), FindingKind.DRIVING)
    assert "% of the free floor" in driving[0].text
    assert driving[1].joint == "slide"
    assert not of_kind(check_scene(whole, ROBOT), FindingKind.DRIVING)


# -------------------------------------------------------------------------------------- report


def test_findings_are_sorted_limited_per_kind_and_counted() -> None:
    mugs = [box(f"m{k}", (0.08, 0.08, 0.1), (k, 0, 0.8), "mug") for k in range(9)]
    lower = box("shelf", (0.8, 0.3, 1.8), (-1, 0, 0.8))
    report = check_scene(room(*mugs, lower, start=np.array([-1.0, 0.0, 0.0])), ROBOT)
    order = list(Severity)
    ranks = [order.index(one.severity) for one in report.findings]
    assert ranks == sorted(ranks)
    lines = finding_lines(report.findings, most=4)
    assert sum("'m" in line for line in lines) == 4
    assert "  warning: 5 more of this kind (in the air)" in lines
    assert report.counts[Severity.WARNING] == 10


def test_a_report_is_plain_json_also_without_limits(tmp_path: Path) -> None:
    knob = cupboards.joint("turn", "continuous", ("body", "door"), (0, 0, 0.4), (0, 0, 1), (0, 0))
    scene = cupboards.furniture_room(tmp_path, [cupboards.carcass(), cupboards.DOOR, knob])
    facts = json.loads(json.dumps(report_to_dict(check_scene(scene, ROBOT)), allow_nan=False))
    (one,) = facts["joints"]
    assert one["wide"] is None
    assert isinstance(one["opens_up"], bool)
    assert facts["usable"] is True


def test_a_wrong_argument_is_named() -> None:
    with pytest.raises(InputError, match="scene"):
        check_scene("kitchen_small")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="robot"):
        check_scene(room(TABLE), "fetch")  # type: ignore[arg-type]


# ------------------------------------------------------------------------------------ real data

KITCHENS = (
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("Kitchen", "Kitchen_1")),
    "Kitchen_anygrasp", "b512",
)  # fmt: skip


@pytest.mark.parametrize("name", KITCHENS)
def test_real_kitchens_are_usable(name: str) -> None:
    path = optional.there(real.DATA / f"bestman/Asset/Scene/Scene/{name}.json")
    report = check_scene(load_scene(path), ROBOT)
    assert report.usable
    assert not of_kind(report, FindingKind.SIZE)
    assert not of_kind(report, FindingKind.DRIVING)
    overlaps = of_kind(report, FindingKind.OVERLAP)
    assert not overlaps or name == "Kitchen_anygrasp"  # its objects fall into place in a simulation


def test_rooms_and_furniture_of_other_people_have_the_findings_that_they_stand_for(
    husky: Robot,
) -> None:
    cases = optional.there(real.CASES)
    keys = of_kind(check_scene(load_scene(cases / "rooms/typo2.json")), FindingKind.UNKNOWN_KEY)
    assert [key.object for key in keys] == ["", "fridge", "fridge"]
    for name, hollow in (("overhang_mesh", []), ("tray_mesh", ["chest"])):
        hulls = check_scene(load_scene(cases / f"furniture/{name}.json"))
        assert [one.object for one in of_kind(hulls, FindingKind.HULL)] == hollow
    narrow = load_scene(cases / "furniture/narrow_door.json")
    assert of_kind(check_scene(narrow, husky), FindingKind.DRIVING)
    assert not of_kind(check_scene(narrow, ROBOT), FindingKind.DRIVING)
