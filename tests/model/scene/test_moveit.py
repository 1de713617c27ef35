"""MoveIt planning scenes round-trip, and old files are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.commands import json_of

from momapos.apps.cli.main import main
from momapos.apps.export.ros2 import write_scene
from momapos.core.errors import MomaposError
from momapos.core.geometry.transforms import apply, pose_planar
from momapos.model.scene.formats.importing import write_room
from momapos.model.scene.formats.kinds import kind_of_file
from momapos.model.scene.formats.moveit import read_room
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene

SCENE = """(noname)+
* the table
1 2 0.4
0 0 0.70710678118 0.70710678118
2
box
0.8 1.6 0.8
0 0 0
0 0 0 1
0.7 0.7 0.7 1
cylinder
0.1 0.2
0.2 0 0.5
0 0 0 1
0 0 0 0
1
handle
0 0 0
0 0 0 1
* wedge
0 0 0
0 0 0 1
1
mesh
4 4
0 0 0
0.3 0 0
0 0.2 0
0 0 0.1
0 2 1
0 1 3
1 2 3
0 3 2
0 0 1
0 0 0 1
0 0 0 0
0
* ground
0 0 0
0 0 0 1
2
plane
0 0 1 0
0 0 0
0 0 0 1
0 0 0 0
cone
0.1 0.4
1 1 1
0 0 0 1
0 0 0 0
0
.
"""
OLD = """room
* table
1
sphere
0.25
1 2 0.4
0 0 0 1
0 0 0 0
* box
1
box
1 1 1
0 0 0.5
0 0 0 1
0.5 0.5 0.5 1
.
"""


def read(folder: Path, text: str) -> Scene:
    (folder / "room.scene").write_text(text)
    room = read_room(folder / "room.scene", folder)
    return write_room(room, folder / "room.scene", folder / "out.json")


def test_poses_of_objects_and_of_their_shapes_are_kept(tmp_path: Path) -> None:
    scene = read(tmp_path, SCENE)
    assert [item.name for item in scene.objects] == ["the table", "wedge", "ground"]
    low, high = scene.object("the table").bounds
    assert_allclose((low + high)[:2] / 2, [1, 2], atol=1e-6)  # 0.8 x 1.6, turned by 90 degrees
    assert_allclose(high - low, [1.6, 0.8, 1.0], atol=1e-6)
    assert_allclose(scene.object("wedge").bounds, [[0, 0, 1], [0.3, 0.2, 1.1]], atol=1e-9)


def test_dropped_elements_of_a_planning_scene_are_counted(tmp_path: Path) -> None:
    (tmp_path / "room.scene").write_text(SCENE)
    report = read_room(tmp_path / "room.scene", tmp_path).final_report()
    assert report.dropped == {"subframes": 1, "floors": 1, "colors": 1}
    assert report.approximated["cones as cylinders"] == 1
    assert report.kept["collision shapes"] == 4


def test_files_without_poses_of_objects_are_read(tmp_path: Path) -> None:
    scene = read(tmp_path, OLD)
    assert_allclose(scene.object("table").bounds.mean(0), [1, 2, 0.4], atol=1e-3)
    assert_allclose(scene.object("box").bounds, [[-0.5, -0.5, 0], [0.5, 0.5, 1]])


@pytest.mark.parametrize("name", ["kitchen_small", "kitchen_island"])
def test_a_kitchen_round_trips_with_all_its_hulls(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    T = pose_planar(np.array([0.3, -0.2, 0.7]))
    write_scene(scene, T, tmp_path / "room.scene")
    again = read(tmp_path, (tmp_path / "room.scene").read_text())
    assert len(again.objects) > len(scene.objects)
    expected = [
        apply(T @ pose, hull.vertices)
        for item in scene.objects
        for link, pose in item.link_poses().items()
        for hull in item.model.hulls[link]
    ]
    found = [
        apply(pose, hull.vertices)
        for item in again.objects
        for link, pose in item.link_poses().items()
        for hull in item.model.hulls[link]
    ]
    for a, b in zip(expected, found, strict=True):
        assert_allclose(b, a, atol=1e-6)


def test_the_command_converts_both_ways(tmp_path: Path) -> None:
    there, back = tmp_path / "room.scene", tmp_path / "room.json"
    assert main(["scene", "convert", "kitchen_small", str(there)]) == 0
    assert kind_of_file(there) == "MoveIt"
    printed = json_of("scene", "convert", str(there), str(back), "--json")
    assert printed["report"]["kept"]["objects"] == len(load_scene(back).objects)


BAD = {
    "cut": (SCENE[:60], "line 4: the file ends before"),
    "no object": (
        "a\n* b\n1\nbox\n1 1 1\n0 0 0\n0 0 0 1\n0 0 0 0\nc\n", "'c' instead of an object",
    ),
    "a shape of another kind": ("a\n* b\n1\ntorus\n1\n.\n", "line 4: unknown shape 'torus'"),
    "too few numbers": ("a\n* b\n1\nbox\n1 1\n.\n", "line 5: '1 1' is not the size of a box"),
    "no number": ("a\n* b\n1\nbox\n1 1 x\n.\n", "line 5: '1 1 x' instead of"),
    "nothing finite": ("a\n* b\n1\nbox\n1 1 nan\n.\n", "3 finite numbers"),
    "no size": ("a\n* b\n1\nbox\n1 1 0\n0 0 0\n0 0 0 1\n0 0 0 0\n.\n", "must be > 0"),
    "no orientation": ("a\n* b\n1\nbox\n1 1 1\n0 0 0\n0 0 0 0\n0 0 0 0\n.\n", "has length 0"),
    "a mesh without end": ("a\n* b\n1\nmesh\n999999 9\n0 0 0\n.\n", "has no 999999 lines"),
    "corners that are not there": (
        "a\n* b\n1\nmesh\n3 1\n0 0 0\n1 0 0\n0 1 0\n0 1 3\n0 0 0\n0 0 0 1\n0 0 0 0\n.\n",
        "a triangle names vertex 3 of 3",
    ),
    "shapes without end": ("a\n* b\n1e5\nbox\n", "the file ends"),
    "half a shape": ("a\n* b\n1.5\nbox\n", "a number of shapes"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_refused_in_one_line_and_leave_nothing(tmp_path: Path, case: str) -> None:
    text, message = BAD[case]
    with pytest.raises(MomaposError, match=message):
        read(tmp_path, text)
    assert not list(tmp_path.glob("*out*"))
