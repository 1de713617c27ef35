"""What is drawn: triangles that show their outer sides."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from momapos.apps.web.bodies import facing, joined, looks, standing
from momapos.apps.web.cameras import viewpoint
from momapos.apps.web.room_view import triangulated
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import SceneObject
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf

URDF = """<robot name="thing"><link name="base">
<visual><geometry><mesh filename="half.obj" scale="{scale}"/></geometry></visual>
<collision><geometry><box size="1 1 1"/></geometry></collision></link></robot>"""
TETRAHEDRON = """v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Of what triangles enclose that show their outer sides [m^3]."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6)


def test_all_links_show_their_outer_sides(robots: Callable[[str], Robot]) -> None:
    for look in looks(robots("segway_ur5e").model):
        surface = joined((look.body, look.handle))
        assert volume(surface.vertices, surface.faces) > 0, look.link


@pytest.mark.parametrize("scale", ["1 1 1", "2 1 1", "-1 1 1"])
def test_a_mesh_is_drawn_by_its_own_triangles(tmp_path: Path, scale: str) -> None:
    (tmp_path / "half.obj").write_text(TETRAHEDRON)
    (tmp_path / "thing.urdf").write_text(URDF.format(scale=scale))
    (look,) = looks(Articulated(read_urdf(tmp_path / "thing.urdf")))
    assert len(look.body.faces) == len(look.body.vertices) == 4  # what corners share is sent once
    stretched = abs(np.prod([float(s) for s in scale.split()]))
    assert volume(look.body.vertices, look.body.faces) == pytest.approx(stretched / 6)


def test_what_is_checked_is_drawn_on_request(tmp_path: Path) -> None:
    (tmp_path / "half.obj").write_text(TETRAHEDRON)
    (tmp_path / "thing.urdf").write_text(URDF.format(scale="1 1 1"))
    (look,) = looks(Articulated(read_urdf(tmp_path / "thing.urdf")), collision=True)
    assert volume(look.body.vertices, look.body.faces) == pytest.approx(1.0)


def test_a_wall_shows_its_inner_side_only() -> None:
    wall = SceneObject.box("wall", (4.0, 0.1, 2.0), (0.0, 2.0, 1.0), category="wall")
    inner = facing(standing(wall, lambda look: look.body), np.array([0.0, 0.0, 1.0]))
    corners = inner.vertices[inner.faces].reshape(-1, 3)
    assert len(inner.faces) == 2
    np.testing.assert_allclose(corners[:, 1], 1.95)


def test_a_floor_with_a_notch_is_covered_once() -> None:
    notched = np.array([[0, 0], [4, 0], [4, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3.0]])
    for polygon in (notched, notched[::-1].copy()):
        a, b, c = (polygon[triangulated(polygon)[:, k]] for k in range(3))
        u, v = b - a, c - a
        areas = (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2
        assert (areas > 0).all()
        assert areas.sum() == pytest.approx(10.0)


def test_a_room_is_looked_at_from_the_side_to_which_its_doors_open() -> None:
    scene = load_scene("kitchen_small")
    eye, target = viewpoint(scene)
    assert eye[1] < target[1]
    assert eye[2] > 1.5
