"""Surfaces that are drawn: their triangles face outward."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from momapos.apps.web.cameras import viewpoint
from momapos.apps.web.room_view import facing, joined, link_surfaces, world_surface
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf

URDF = """<robot name="chest"><link name="base">
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
    """Return the volume that triangles enclose, positive if they face outward [m^3]."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6)


def test_triangles_of_all_links_face_outward(segway: Robot) -> None:
    for link in link_surfaces(segway.model):
        surface = joined((link.body, link.handle))
        assert volume(surface.vertices, surface.faces) > 0, link.link


@pytest.mark.parametrize("scale", ["1 1 1", "2 1 1", "-1 1 1"])
def test_a_mesh_is_drawn_with_its_own_triangles(tmp_path: Path, scale: str) -> None:
    (tmp_path / "half.obj").write_text(TETRAHEDRON)
    (tmp_path / "chest.urdf").write_text(URDF.format(scale=scale))
    (link,) = link_surfaces(Articulated(read_urdf(tmp_path / "chest.urdf")))
    assert len(link.body.faces) == len(link.body.vertices) == 4  # shared corners are sent once
    stretched = abs(np.prod([float(s) for s in scale.split()]))
    assert volume(link.body.vertices, link.body.faces) == pytest.approx(stretched / 6)


def test_collision_shapes_are_drawn_on_request(tmp_path: Path) -> None:
    (tmp_path / "half.obj").write_text(TETRAHEDRON)
    (tmp_path / "chest.urdf").write_text(URDF.format(scale="1 1 1"))
    (link,) = link_surfaces(Articulated(read_urdf(tmp_path / "chest.urdf")), collision=True)
    assert volume(link.body.vertices, link.body.faces) == pytest.approx(1.0)


def test_only_the_inner_side_of_a_wall_is_drawn() -> None:
    wall = SceneObject.box("wall", (4.0, 0.1, 2.0), (0.0, 2.0, 1.0), category="wall")
    inner = facing(world_surface(wall, lambda link: link.body), np.array([0.0, 0.0, 1.0]))
    corners = inner.vertices[inner.faces].reshape(-1, 3)
    assert len(inner.faces) == 2
    np.testing.assert_allclose(corners[:, 1], 1.95)


def test_the_camera_is_on_the_side_to_which_doors_open(kitchen: Scene) -> None:
    eye, target = viewpoint(kitchen)
    assert eye[1] < target[1]
    assert eye[2] > 1.5
