"""MoveIt planning scenes in YAML: each shape stands where the message says."""

from __future__ import annotations

import tarfile
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests import optional
from tests.commands import error_of, output_of
from tests.real import DATA

from momapos.core.errors import MomaposError
from momapos.model.scene.formats.imported_room import ImportReport
from momapos.model.scene.formats.importing import write_room
from momapos.model.scene.formats.kinds import kind_of_file
from momapos.model.scene.formats.moveit import read_message
from momapos.model.scene.scene import Scene

SCENE = """
name: test
robot_model_name: fetch
fixed_frame_transforms:
  - header: {frame_id: room}
    child_frame_id: cell
    transform:
      translation: {x: 1, y: 0, z: 0}
      rotation: {x: 0, y: 0, z: 0.70710678, w: 0.70710678}
  - header: {frame_id: map}
    child_frame_id: room
    transform: {translation: [0, 2, 0], rotation: [0, 0, 0, 1]}
robot_state:
  joint_state: {name: [a, b], position: [0, 1]}
  multi_dof_joint_state:
    header: {frame_id: map}
    joint_names: [world_joint]
    transforms: [{translation: {x: -1, y: 1, z: 0}, rotation: {x: 0, y: 0, z: 1, w: 0}}]
  attached_collision_objects:
    - object: {id: tool}
world:
  collision_objects:
    - id: table
      header: {frame_id: map}
      pose:
        position: {x: 1, y: 2, z: 0.4}
        orientation: {x: 0, y: 0, z: 0.70710678, w: 0.70710678}
      primitives: [{type: 1, dimensions: [0.8, 1.6, 0.8]}, {type: cylinder, dimensions: [0.2, 0.1]}]
      primitive_poses:
        - {position: {x: 0, y: 0, z: 0}, orientation: {x: 0, y: 0, z: 0, w: 0}}
        - {position: [0.2, 0, 0.5], orientation: [0, 0, 0, 1]}
      subframe_names: [corner]
      subframe_poses: [{position: [0.4, 0.8, 0.4], orientation: [0, 0, 0, 1]}]
    - id: ball
      header: {frame_id: table/corner}
      primitives: [{type: 2, dimensions: [0.05]}]
      primitive_poses: [{position: [0, 0, 0.05], orientation: [0, 0, 0, 1]}]
    - id: crate
      header: {frame_id: cell}
      primitives: [{type: box, dimensions: [0.4, 0.2, 0.2]}]
      primitive_poses: [{position: [1, 0, 0.1], orientation: [0, 0, 0, 1]}]
    - id: wedge
      header: {frame_id: /map}
      meshes:
        - vertices: [{x: 0, y: 0, z: 0}, {x: 0.3, y: 0, z: 0}, {x: 0, y: 0.2, z: 0}, [0, 0, 0.1]]
          triangles: [{vertex_indices: [0, 2, 1]}, {vertex_indices: [0, 1, 3]},
                      {vertex_indices: [1, 2, 3]}, {vertex_indices: [0, 3, 2]}]
      mesh_poses: [{position: [0, 0, 1], orientation: [0, 0, 0, 1]}]
      planes: [{coef: [0, 0, 1, 0]}, {coef: [1, 0, 0, 0]}]
      plane_poses: []
  octomap: {header: {frame_id: map}, octomap: {id: OcTree, data: [1, 2]}}
object_colors: [{id: table}]
"""
OBJECT = """
world:
  collision_objects:
    - id: one
      header: {{frame_id: map}}
      primitives: [{{type: {type}, dimensions: {size}{more}}}]
      primitive_poses: [{{position: {at}, orientation: {turn}}}]
"""


def one(**changes: str) -> str:
    """Return a scene of one box, or another object."""
    parts = {"type": "box", "size": "[1, 1, 1]", "at": "[0, 0, 0.5]", "turn": "[0, 0, 0, 1]"}
    return OBJECT.format(**{**parts, "more": "", **changes})


def read(folder: Path, text: str) -> tuple[Scene, ImportReport]:
    path = folder / "scene.yaml"
    path.write_text(text)
    room = read_message(path, folder)
    return write_room(room, path, folder / "out.json"), room.final_report()


def test_shapes_stand_in_their_frames(tmp_path: Path) -> None:
    scene, _ = read(tmp_path, SCENE)
    assert [item.name for item in scene.objects] == ["table", "ball", "crate", "wedge"]
    low, high = scene.object("table").bounds
    assert_allclose((low + high)[:2] / 2, [1, 2], atol=1e-6)  # 0.8 x 1.6, turned by 90 degrees
    assert_allclose(high - low, [1.6, 0.8, 1.0], atol=1e-6)
    # At the table's corner (0.4, 0.8), which the turn brings to (-0.8, 0.4).
    assert_allclose(scene.object("ball").bounds.mean(0), [0.2, 2.4, 0.85], atol=2e-3)
    assert_allclose(scene.object("crate").bounds, [[0.9, 2.8, 0], [1.1, 3.2, 0.2]], atol=1e-6)
    assert_allclose(scene.object("wedge").bounds, [[0, 0, 1], [0.3, 0.2, 1.1]], atol=1e-9)
    assert_allclose(scene.start[:2], [-1, 1])
    assert_allclose(abs(scene.start[2]), np.pi)


def test_a_cylinder_stays_one(tmp_path: Path) -> None:
    scene, _ = read(tmp_path, SCENE)
    kinds = [s.kind for s in scene.object("table").model.urdf.links["body"].collisions]
    assert kinds == ["box", "cylinder"]
    assert scene.object("table").model.urdf.links["body"].collisions[1].size == (0.1, 0.2)


def test_what_has_no_place_in_a_scene_is_counted(tmp_path: Path) -> None:
    _, report = read(tmp_path, SCENE)
    assert report.dropped == {
        "subframes": 1, "floors": 1, "unbounded planes": 1, "attached objects": 1,
        "joint values of the robot": 2, "octomaps": 1, "colors": 1,
    }  # fmt: skip


def test_cones_and_prisms_are_enclosed(tmp_path: Path) -> None:
    scene, report = read(tmp_path, one(type="cone", size="[1.0, 0.2]"))
    assert_allclose(scene.objects[0].bounds[:, 2], [0, 1])
    assert report.approximated == {"cones as cylinders": 1}
    corners = "polygon: {points: [{x: 0, y: 0}, {x: 1, y: 0}, {x: 0, y: 2}]}"
    (tmp_path / "b").mkdir()
    scene, report = read(tmp_path / "b", one(type="5", size="[1.0]", more=f", {corners}"))
    assert_allclose(scene.objects[0].bounds, [[0, 0, 0], [1, 2, 1]], atol=1e-6)
    assert report.approximated == {"prisms as their convex hulls": 1}


def test_operations_apply_in_order(tmp_path: Path) -> None:
    box = "primitives: [{type: box, dimensions: [1, 1, 1]}]"
    rows = [
        f"{{id: a, {box}, operation: 0}}",
        f"{{id: b, {box}, operation: 0}}",
        f"{{id: a, {box}, pose: {{position: [3, 0, 0]}}, operation: append}}",
        "{id: b, operation: 1}",
        "{id: c, operation: remove}",
        "{id: a, pose: {position: [0, 0, 5]}, operation: 3}",
    ]
    text = "world:\n  collision_objects:\n" + "".join(f"    - {row}\n" for row in rows)
    scene, report = read(tmp_path, text)
    assert [item.name for item in scene.objects] == ["a"]
    assert_allclose(scene.objects[0].bounds, [[-0.5, -0.5, 4.5], [3.5, 0.5, 5.5]])
    assert +report.dropped == {"removals of unknown objects": 1}


def test_unknown_frames_are_reported_once(tmp_path: Path) -> None:
    scene, report = read(tmp_path, one().replace("map", "camera"))
    assert_allclose(scene.objects[0].bounds[:, 2], [0, 1])
    assert report.notes == [
        "frame 'camera' of 1 object is not in fixed_frame_transforms; it is taken as the planning "
        "frame"
    ]


def test_the_command_converts_them(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("---\n" + SCENE)
    assert kind_of_file(path) == "MoveIt message"
    assert "momapos scene convert" in error_of("scene", "show", str(path))
    assert "5 collision shapes" in output_of(
        "scene", "convert", str(path), str(tmp_path / "room.json")
    )


BAD = {
    "no world": ("robot_model_name: a\n", "it has no world with collision_objects"),
    "another shape": (one(type="torus"), "type 'torus' is none of box"),
    "a number of no shape": (one(type="9"), "type 9 is none of"),
    "no size": (one(size="[1, 0, 1]"), "dimensions of a box must be 3 numbers > 0"),
    "a missing size": (one(size="[1, 1]"), "must be 3 numbers > 0"),
    "NaN": (one(size="[1, .nan, 1]"), "dimensions must be finite numbers"),
    "words": (one(at="[a, b, c]"), "position must be 3 finite numbers"),
    "a long orientation": (one(turn="[0, 0, 1, 1]"), "orientation has length 1.41"),
    "more poses than shapes": (
        one().replace("primitives: [", "primitives: [] #"), "1 primitive_poses for 0 primitives",
    ),
    "no list": ("world: {collision_objects: 3}\n", "collision_objects must be a list, not 3"),
    "no message": ("world: {collision_objects: [3]}\n", "collision_objects 0 must be a mapping"),
    "another operation": (one().replace("id: one", "id: one\n      operation: 7"), "'7' is none"),
    "moving nothing": (one().replace("id: one", "id: one\n      operation: 3"), "moves 'one'"),
    "a circle of frames": (
        "fixed_frame_transforms: [{header: {frame_id: a}, child_frame_id: b},"
        " {header: {frame_id: b}, child_frame_id: a}]\nworld: {collision_objects: []}\n",
        "is its own parent",
    ),
    "a flat prism": (
        one(
            type="prism", size="[1]", more=", polygon: {points: [[0, 0, 0], [1, 1, 0], [2, 2, 0]]}"
        ),
        "encloses no area",
    ),
    "a vertex that is missing": (
        "world:\n  collision_objects:\n    - meshes: [{vertices: [[0, 0, 0]],"
        " triangles: [[0, 0, 1]]}]\n",
        "a triangle names vertex 1 of 1",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_messages_are_refused_in_one_line_and_leave_nothing(tmp_path: Path, case: str) -> None:
    text, message = BAD[case]
    with pytest.raises(MomaposError, match=message) as raised:
        read(tmp_path, text)
    assert "\n" not in str(raised.value)
    assert not list(tmp_path.glob("*out*"))


def test_published_planning_problems_are_read_whole(tmp_path: Path) -> None:
    """Each kind of scene for the Fetch, one of each."""
    archive = optional.there(DATA / "planning_problems" / "fetch.tar.bz2")
    with tarfile.open(archive) as file:
        found = [m for m in file.getmembers() if m.name.endswith("scene0003.yaml")]
        assert len(found) == 7
        for member in found:
            content = file.extractfile(member)
            folder = tmp_path / Path(member.name).parent.name
            folder.mkdir()
            text = content.read().decode()
            scene, report = read(folder, text)
            assert len(scene.objects) == text.count("id: ") - text.count("frame_id: ")
            assert not report.approximated.total()
            assert report.notes == []
