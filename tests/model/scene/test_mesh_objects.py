"""Objects made from meshes in code are saved, planned around and exported like those of files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from tests.shapes import unchecked

from momapos.core.errors import MomaposError
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.robots.robot import Robot
from momapos.model.scene.formats.importing import write_mjcf
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.meshes import mesh_triangles
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.verification.plan_check import verify_files

WEDGE = [[0, 0, 0], [0.6, 0, 0], [0, 0.4, 0], [0, 0, 0.8]]
FACES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
LEGS = [(x, y, 0.34) for x in (-0.45, 0.45) for y in (-0.25, 0.25)]


def moved(shape: trimesh.Trimesh, at: tuple[float, float, float]) -> trimesh.Trimesh:
    shape.apply_translation(at)
    return shape


def table() -> trimesh.Scene:
    """Return a table of five boxes, whose legs are one placed mesh."""
    scene = trimesh.Scene([moved(trimesh.creation.box((1.0, 0.6, 0.04)), (0, 0, 0.7))])
    leg = trimesh.creation.box((0.05, 0.05, 0.68))
    for k, at in enumerate(LEGS):
        T = trimesh.transformations.translation_matrix(at)
        scene.add_geometry(leg, node_name=f"leg{k}", geom_name="leg", transform=T)
    return scene


def test_a_mesh_stands_where_its_pose_says() -> None:
    item = SceneObject.from_mesh("wedge", WEDGE, FACES, (1, 2, 0.1), yaw=np.pi / 2, category="ramp")
    assert_allclose(item.bounds, [[0.6, 2, 0.1], [1, 2.6, 0.9]], atol=1e-9)
    assert item.category == "ramp"


def test_corners_that_no_triangle_names_do_not_count() -> None:
    item = SceneObject.from_mesh("wedge", [*WEDGE, [9, 9, 9]], FACES, (0, 0, 0))
    assert_allclose(item.bounds[1], [0.6, 0.4, 0.8], atol=1e-9)


def test_each_placed_mesh_of_a_scene_has_a_hull_of_its_own() -> None:
    item = SceneObject.from_trimesh("table", table(), (2, 0, 0))
    hulls = item.model.hulls["body"]
    assert len(hulls) == 5
    assert_allclose(item.bounds, [[1.5, -0.3, 0], [2.5, 0.3, 0.72]], atol=1e-9)
    under = np.array([2.0, 0.0, 0.3])
    assert not any((h.vertices.min(0) < under - [2, 0, 0]).all()
                   and (h.vertices.max(0) > under - [2, 0, 0]).all() for h in hulls)  # fmt: skip


def test_declared_units_are_converted_to_meters() -> None:
    box = trimesh.creation.box((400.0, 200.0, 100.0))
    box.units = "mm"
    assert_allclose(np.ptp(SceneObject.from_trimesh("b", box, (0, 0, 0)).bounds, axis=0),
                    [0.4, 0.2, 0.1])  # fmt: skip
    inches = trimesh.Scene([trimesh.creation.box((10.0, 10.0, 10.0))])
    inches.units = "inches"
    assert_allclose(np.ptp(SceneObject.from_trimesh("b", inches, (0, 0, 0)).bounds, axis=0), 0.254)


def test_a_saved_scene_is_read_back_to_the_last_digit(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(2, 0.2)
    items = (
        SceneObject.from_mesh("ball/1", ball.vertices, ball.faces, (1, 0, 0.5), yaw=0.3),
        SceneObject.from_trimesh("table", table(), (2, 0, 0), category="table"),
        SceneObject.box("box", (1, 1, 1), (5, 5, 0.5)),
    )
    scene = Scene("room", items)
    for _ in range(2):  # saving again changes no file
        save_scene(scene, tmp_path / "room.json")
    files = sorted(file.name for file in (tmp_path / "room_files").iterdir())
    assert len(files) == 2 + 1 + 5
    again = load_scene(tmp_path / "room.json")
    for a, b in zip(scene.objects, again.objects, strict=True):
        assert (a.name, a.category) == (b.name, b.category)
        assert_allclose(b.vertices, a.vertices, atol=1e-15)
    save_scene(again, tmp_path / "again.json")
    assert not (tmp_path / "again_files").exists()  # models of files stay where they are


def test_two_scenes_in_one_folder_share_no_changed_file(tmp_path: Path) -> None:
    small = SceneObject.from_mesh("wedge", WEDGE, FACES, (0, 0, 0))
    large = SceneObject.from_mesh("wedge", 2 * np.array(WEDGE), FACES, (0, 0, 0))
    save_scene(Scene("a", (small,)), tmp_path / "room.json")
    save_scene(Scene("b", (large,)), tmp_path / "room.json")
    assert_allclose(load_scene(tmp_path / "room.json").objects[0].vertices, large.vertices)


def test_a_mesh_is_drawn_and_exported_as_it_is(tmp_path: Path) -> None:
    item = SceneObject.from_mesh("wedge", WEDGE, FACES, (0, 0, 0))
    shape = item.model.urdf.links["body"].visuals[0]
    assert_allclose(mesh_triangles(shape.mesh).reshape(-1, 3).max(0), [0.6, 0.4, 0.8])
    write_mjcf(Scene("room", (item,)), tmp_path / "room.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "room.xml"))
    assert model.nmesh == 1


def test_a_pick_over_a_table_made_in_code_is_planned_and_verified(
    tmp_path: Path, fetch: Robot
) -> None:
    table_here = SceneObject.from_trimesh("table", table(), (1.5, 0, 0))
    mug = SceneObject.box("mug", (0.06, 0.06, 0.1), (1.3, 0, 0.77))
    floor = np.array([[-2.0, -2], [3, -2], [3, 2], [-2, 2]])
    scene = replace(Scene("room", (table_here, mug)), floor_polygon=floor, start=np.zeros(3))
    scene = save_scene(scene, tmp_path / "room.json")
    answer = plan_base_placement(scene, fetch, make_task(scene, "pick", "mug"))
    assert answer.plan.status == "solved"
    write_plan(answer.plan, tmp_path / "plan.json")
    assert verify_files(tmp_path / "plan.json").valid


BAD: dict[str, tuple[Any, Any, str]] = {
    "NaN": ([[0, 0, float("nan")], *WEDGE[1:]], FACES, "finite numbers"),
    "a vertex that is missing": (WEDGE, [[0, 1, 4]], "vertex 4 does not exist; there are 4"),
    "a negative vertex": (WEDGE, [[0, 1, -1]], "vertex -1 does not exist"),
    "half a vertex": (WEDGE, [[0, 1, 1.5]], "whole numbers"),
    "quadrangles": (WEDGE, [[0, 1, 2, 3]], "must be triangles, n x 3"),
    "no faces": (WEDGE, np.zeros((0, 3)), "has 0 triangles"),
    "nothing": ([], [], "n x 3 finite numbers"),
    "points on a line": ([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]], "lie on one line"),
    "millimeters": (2e4 * np.array(WEDGE), FACES, "units are meters"),
    "two numbers a vertex": ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], "n x 3 finite numbers"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_meshes_are_refused_in_one_line(case: str) -> None:
    vertices, faces, message = BAD[case]
    with unchecked(), pytest.raises(MomaposError, match=message) as raised:
        SceneObject.from_mesh("wedge", vertices, faces, (0, 0, 0))
    assert "\n" not in str(raised.value)


def test_too_many_triangles_are_refused_before_they_are_used() -> None:
    faces = np.zeros((400_001, 3), int)
    with pytest.raises(MomaposError, match="400001 triangles"):
        SceneObject.from_mesh("wedge", WEDGE, faces, (0, 0, 0))


def test_what_is_no_triangle_mesh_is_refused() -> None:
    line = trimesh.PointCloud([[0, 0, 0], [1, 0, 0]])
    for wrong, message in (
        (line, "with faces"), (trimesh.Scene([line]), "not a triangle mesh"),
        (None, "not None"), (trimesh.Scene(), "has 0 parts"),
    ):  # fmt: skip
        with unchecked(), pytest.raises(MomaposError, match=message):
            SceneObject.from_trimesh("chest", wrong, (0, 0, 0))
    odd = trimesh.creation.box((1, 1, 1))
    odd.units = "cubits and a half"
    with pytest.raises(MomaposError, match="unknown units"):
        SceneObject.from_trimesh("chest", odd, (0, 0, 0))
