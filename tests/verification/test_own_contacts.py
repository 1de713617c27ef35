"""A part is stopped by its own object, except where it turns at a hinge or slides along a rail."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.meshes import Box, triangles_of, write_obj

from momapos.model.records.plans import Task
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.verification.moved_part import split
from momapos.verification.part_sweep import obstructing_links, part_sweep_check
from momapos.verification.report import DEFAULT

CARCASS: tuple[Box, ...] = (
    ((-0.25, -0.6, 0.0), (0.25, 0.6, 0.02)),
    ((-0.25, -0.6, 0.78), (0.25, 0.6, 0.8)),
    ((-0.25, 0.58, 0.02), (0.25, 0.6, 0.78)),
    ((-0.25, -0.6, 0.02), (0.25, -0.58, 0.78)),
    ((0.23, -0.58, 0.02), (0.25, 0.58, 0.78)),
)
"""A cabinet that is open to -x."""


def shapes(boxes: Sequence[Box], mesh: str = "") -> str:
    """Return boxes as collision elements, or the mesh that holds them."""
    if mesh:
        return f'<collision><geometry><mesh filename="{mesh}"/></geometry></collision>'
    found = []
    for low, high in boxes:
        middle, size = (np.array(low) + high) / 2, np.array(high) - low
        found.append(
            f'<collision><origin xyz="{middle[0]} {middle[1]} {middle[2]}"/><geometry>'
            f'<box size="{size[0]} {size[1]} {size[2]}"/></geometry></collision>'
        )
    return "".join(found)


def joint(name: str, kind: str, xyz: str, axis: str, upper: float) -> str:
    return (
        f'<joint name="{name}_joint" type="{kind}"><parent link="body"/><child link="{name}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>'
        f'<limit lower="0" upper="{upper}" effort="9" velocity="1"/></joint>'
    )


def scene_of(folder: Path, text: str, **values: float) -> Scene:
    folder.mkdir(exist_ok=True)
    file = folder / "target.urdf"
    file.write_text(f'<robot name="target">{text}</robot>')
    item = SceneObject.from_urdf("target", file, (0.0, 0.0, 0.0), joints=values)
    return Scene("room", (item,))


def hit(scene: Scene, name: str, to: float, verb: str = "open") -> str | None:
    task = Task(verb, "target", f"{name}_joint", to)  # type: ignore[arg-type]
    part, fixed, own = split(scene, task)
    return part_sweep_check(part, fixed, own, DEFAULT).first_hit(to)


def sliding(
    folder: Path, gap: float, offset: float = 0.0, thick: float = 0.02, **at: float
) -> Scene:
    """Two sliding panels: the edge gap in one plane, and how far apart their planes are [m]."""
    panel = ((-thick / 2, -0.28, -0.37), (thick / 2, 0.28, 0.37))
    text = f'<link name="body">{shapes(CARCASS)}</link>'
    for name, side, x in (("a", 1, -0.27), ("b", -1, -0.27 - offset)):
        y = side * (0.28 + gap / 2)
        text += f'<link name="{name}">{shapes([panel])}</link>'
        text += joint(name, "prismatic", f"{x} {y} 0.4", f"0 {-side} 0", 0.5)
    return scene_of(folder, text, **at)


@pytest.mark.parametrize("gap", [0.0, -0.003, 0.005])
@pytest.mark.parametrize("thick", [0.02, 0.004])
def test_a_panel_does_not_slide_through_its_neighbor(
    gap: float, thick: float, tmp_path: Path
) -> None:
    words = hit(sliding(tmp_path, gap, thick=thick), "a", 0.5)
    assert words is not None
    assert re.match(r"target/a \d+ mm in target/b at worst, first", words)


def test_a_panel_slides_past_a_neighbor_in_another_plane(tmp_path: Path) -> None:
    assert hit(sliding(tmp_path, 0.0, offset=0.0205), "a", 0.5) is None


def test_an_open_panel_closes_past_a_neighbor_in_another_plane(tmp_path: Path) -> None:
    scene = sliding(tmp_path, 0.0, offset=0.0205, a_joint=0.45)
    assert hit(scene, "a", 0.0, "close") is None


def test_a_panel_does_not_close_into_a_neighbor_that_was_opened(tmp_path: Path) -> None:
    """The neighbor has moved to where the panel closes; in the scene they are apart."""
    text = f'<link name="body">{shapes(CARCASS)}</link>'
    panel = ((-0.01, -0.18, -0.37), (0.01, 0.18, 0.37))
    for name, y, way in (("a", 0.39, -1), ("b", 0.0, 1)):
        text += f'<link name="{name}">{shapes([panel])}</link>'
        text += joint(name, "prismatic", f"-0.27 {y} 0.4", f"0 {way} 0", 0.78)
    words = hit(scene_of(tmp_path, text, a_joint=0.78, b_joint=0.38), "a", 0.0, "close")
    assert words is not None
    assert re.match(r"target/a \d+ mm in target/b at worst, first", words)


@pytest.mark.parametrize(("moved", "counts"), [(0.0007, False), (0.0013, True)])
def test_a_neighbor_is_displaced_from_one_millimeter_on(
    moved: float, counts: bool, tmp_path: Path
) -> None:
    scene = sliding(tmp_path, 0.0, offset=0.0205, b_joint=moved)
    _, _, own = split(scene, Task("open", "target", "a_joint", 0.5))
    assert own.displaced.any() == counts


def test_a_displaced_neighbor_stops_a_part_that_closes(tmp_path: Path) -> None:
    """A tray that was pulled out stands where the door's closed panel is."""
    text = f'<link name="body">{shapes(CARCASS)}</link>'
    door = ((-0.01, -1.16, -0.37), (0.01, 0.0, 0.37))
    text += f'<link name="door">{shapes([door])}</link>'
    text += joint("door", "revolute", "-0.262 0.58 0.4", "0 0 -1", 1.9)
    tray = ((0.0, -0.5, -0.1), (0.4, 0.5, 0.1))
    text += f'<link name="tray">{shapes([tray])}</link>'
    text += joint("tray", "prismatic", "-0.245 0 0.4", "-1 0 0", 0.35)
    inside = scene_of(tmp_path / "in", text, door_joint=1.6)
    out = scene_of(tmp_path / "out", text, door_joint=1.6, tray_joint=0.3)
    assert hit(inside, "door", 0.0, "close") is None
    words = hit(out, "door", 0.0, "close")
    assert words is not None
    assert re.search(r"\d mm in target/tray at worst", words)


@pytest.mark.parametrize("overlap", [0.0, 0.001, 0.004])
def test_a_drawer_does_not_pull_its_front_through_a_lip(overlap: float, tmp_path: Path) -> None:
    front = ((-0.01, -0.29, -0.15), (0.01, 0.29, 0.15))
    lip = ((-0.022 + overlap, -0.29, -0.2), (-0.01 + overlap, 0.29, -0.14))
    text = (
        f'<link name="body">{shapes(CARCASS)}</link><link name="top">{shapes([front, lip])}</link>'
    )
    text += joint("top", "prismatic", "-0.262 0 0.57", "-1 0 0", 0.35)
    text += f'<link name="low">{shapes([front])}</link>'
    text += joint("low", "prismatic", "-0.262 0 0.25", "-1 0 0", 0.35)
    scene = scene_of(tmp_path, text)
    assert hit(scene, "top", 0.35) is None
    words = hit(scene, "low", 0.35)
    assert words is not None
    assert re.match(r"target/low \d+ mm in target/top at worst, first", words)


def in_one_mesh(folder: Path, pane: Box | None) -> Scene:
    """A sliding panel before a cabinet, which is one mesh with a pane that stands still."""
    folder.mkdir(exist_ok=True)
    write_obj(folder / "body.obj", triangles_of((*CARCASS, *([] if pane is None else [pane]))))
    panel = ((-0.01, -0.28, -0.37), (0.01, 0.28, 0.37))
    text = (
        f'<link name="body">{shapes((), "body.obj")}</link><link name="a">{shapes([panel])}</link>'
    )
    return scene_of(folder, text + joint("a", "prismatic", "-0.262 0.282 0.4", "0 -1 0", 0.5))


@pytest.mark.parametrize("thick", [0.02, 0.008])
def test_a_pane_in_the_mesh_of_the_body_stops_a_panel(thick: float, tmp_path: Path) -> None:
    pane = ((-0.262 - thick / 2, -0.58, 0.02), (-0.262 + thick / 2, 0.0, 0.78))
    words = hit(in_one_mesh(tmp_path / "pane", pane), "a", 0.5)
    assert words is not None
    assert re.match(r"target/a \d+ mm in target/body at worst, first", words)
    assert hit(in_one_mesh(tmp_path / "open", None), "a", 0.5) is None


def test_a_part_moves_in_the_space_that_the_hull_of_its_body_fills(tmp_path: Path) -> None:
    """A tray on a post in a tunnel moves up until it meets the top."""
    write_obj(tmp_path / "body.obj", triangles_of(CARCASS[:4]))
    tray = ((-0.2, -0.5, 0.0), (0.2, 0.5, 0.1))
    text = f'<link name="body">{shapes((), "body.obj")}</link>'
    text += f'<link name="tray">{shapes([tray])}</link>'
    scene = scene_of(tmp_path, text + joint("tray", "prismatic", "0 0 0.02", "0 0 1", 0.7))
    assert hit(scene, "tray", 0.65) is None
    words = hit(scene, "tray", 0.7)
    assert words is not None
    assert re.match(r"target/tray \d+ mm in target/body at worst, first at 0.6", words)


@pytest.mark.parametrize("kind", ["box", "mesh"])
@pytest.mark.parametrize(("away", "free"), [(0.0, True), (0.03, True), (0.1, False), (0.3, False)])
def test_a_door_may_turn_into_its_object_at_the_hinge_and_nowhere_else(
    away: float, free: bool, kind: str, tmp_path: Path
) -> None:
    post = ((-0.29, away, 0.02), (-0.272, away + 0.02, 0.78))
    body = (*CARCASS, post)
    if kind == "mesh":
        write_obj(tmp_path / "body.obj", triangles_of(body))
    door = ((-0.01, 0.0, -0.37), (0.01, 0.55, 0.37))
    text = f'<link name="body">{shapes(body, "body.obj" if kind == "mesh" else "")}</link>'
    text += f'<link name="door">{shapes([door])}</link>'
    text += joint("door", "revolute", "-0.262 0 0.4", "0 0 1", 1.57)
    words = hit(scene_of(tmp_path, text), "door", 1.57)
    assert (words is None) == free


def test_only_what_stands_in_the_way_is_an_obstruction(tmp_path: Path) -> None:
    task = Task("open", "target", "a_joint", 0.5)
    assert obstructing_links(sliding(tmp_path / "one", 0.0), task) == {"target/b"}
    assert not obstructing_links(sliding(tmp_path / "two", 0.0, offset=0.0205), task)


def folding(folder: Path, knob: float, follows: float = 2.0, mesh: bool = False) -> Scene:
    """A door of two leaves with a hinge between them, which the second one's joint follows.

    Args:
        folder: Where the files go.
        knob: x of a knob at the free edge of the second leaf; at -x it is outside [m].
        follows: Angle of the second leaf against the first one, by the first one's angle.
        mesh: Whether the second leaf is one mesh, whose hull fills the space around the knob.
    """
    leaf = ((-0.01, 0.0, -0.37), (0.01, 0.28, 0.37))
    low, high = sorted((knob, np.sign(knob) * 0.01))
    second = (leaf, ((low, 0.22, -0.02), (high, 0.26, 0.02)))
    folder.mkdir(exist_ok=True)
    if mesh:
        write_obj(folder / "second.obj", triangles_of(second))
    text = f'<link name="body">{shapes(CARCASS)}</link><link name="a">{shapes([leaf])}</link>'
    text += f'<link name="b">{shapes(second, "second.obj" if mesh else "")}</link>'
    text += joint("a", "revolute", "-0.262 -0.575 0.4", "0 0 1", 1.5)
    fold = joint("b", "revolute", "0 0.285 0", "0 0 -1", 3.5).replace('"body"', '"a"')
    mimic = f'<mimic joint="a_joint" multiplier="{follows}"/></joint>'
    return scene_of(folder, text + fold.replace("</joint>", mimic))


@pytest.mark.parametrize("mesh", [False, True])
def test_a_leaf_does_not_fold_its_knob_through_the_other_leaf(mesh: bool, tmp_path: Path) -> None:
    assert hit(folding(tmp_path / "out", -0.05, mesh=mesh), "a", 1.4) is None
    words = hit(folding(tmp_path / "in", 0.09, mesh=mesh), "a", 1.4)
    assert words is not None
    assert re.match(r"target/b \d+ mm in target/a at worst, first at 78 deg", words)


def test_a_leaf_does_not_fold_through_the_other_leaf(tmp_path: Path) -> None:
    words = hit(folding(tmp_path, -0.05, follows=2.4), "a", 1.4)
    assert words is not None
    assert re.match(r"target/b \d+ mm in target/a at worst, first at 68 deg", words)
    assert hit(folding(tmp_path, -0.05, follows=2.4), "a", 1.1) is None
