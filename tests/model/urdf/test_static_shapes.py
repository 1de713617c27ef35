"""Shapes of furniture that stands still: pieces of hollow meshes, strips of round ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tests.meshes as given
from jaxtyping import Bool, Float
from tests import optional
from tests.real import CASES

from momapos.model.urdf.articulated import CUT, Articulated, StaticElement
from momapos.model.urdf.hulls import Boxes, Hull
from momapos.model.urdf.reader import read_urdf
from momapos.planning.grasps.handle_shapes import convex_of

TRAY: tuple[given.Box, ...] = (
    ((-0.25, -0.2, 0.0), (0.25, 0.2, 0.01)),
    ((-0.25, -0.2, 0.01), (-0.24, 0.2, 0.12)),
    ((0.24, -0.2, 0.01), (0.25, 0.2, 0.12)),
    ((-0.24, -0.2, 0.01), (0.24, -0.19, 0.12)),
    ((-0.24, 0.19, 0.01), (0.24, 0.2, 0.12)),
)
HOLLOW: dict[str, tuple[tuple[given.Box, ...], given.Box]] = {
    "tray": (TRAY, ((-0.22, -0.17, 0.03), (0.22, 0.17, 0.12))),
    "table": (given.table(), ((-0.5, -0.3, 0.0), (0.5, 0.3, 0.6))),
    "bookcase": (given.SHELVES, ((-0.2, -0.3, 0.65), (0.1, 0.3, 1.1))),
}
"""Boxes of a mesh, and the space in it that is free."""


def element(folder: Path, triangles: Float[np.ndarray, "t 3 3"]) -> StaticElement:
    given.write_obj(folder / "mesh.obj", triangles)
    shape = '<collision><geometry><mesh filename="mesh.obj"/></geometry></collision>'
    path = folder / "model.urdf"
    path.write_text(f'<robot name="a"><link name="body">{shape}</link></robot>')
    return Articulated(read_urdf(path)).static_elements["body"][0]


def in_boxes(
    boxes: Boxes, points: Float[np.ndarray, "n 3"], slack: float
) -> Bool[np.ndarray, " n"]:
    local = np.einsum("bij,nbi->nbj", boxes.rotation, points[:, None] - boxes.center)
    return (np.abs(local) <= boxes.half + slack).all(2).any(1)


def in_hulls(
    hulls: tuple[Hull, ...], points: Float[np.ndarray, "n 3"], slack: float
) -> Bool[np.ndarray, " n"]:
    return np.any([convex_of(h, np.eye(4)).depth(points) > -slack for h in hulls], axis=0)


@pytest.mark.parametrize("name", HOLLOW)
def test_pieces_of_a_hollow_mesh_contain_it_and_leave_its_inside_free(
    tmp_path: Path, name: str
) -> None:
    boxes, inside = HOLLOW[name]
    triangles, rng = given.triangles_of(boxes), np.random.default_rng(0)
    found = element(tmp_path, triangles)
    assert 1 < len(found.hulls) <= CUT.max_pieces
    surface = given.points_on(triangles, 20, rng)
    solid = np.concatenate([given.points_in(box, 50, rng) for box in boxes])
    for points in (surface, solid):
        assert in_hulls(found.hulls, points, 1e-6).all()
        assert in_boxes(found.boxes, points, 1e-6).all()
    free = given.points_in(inside, 300, rng)
    assert not in_hulls(found.hulls, free, 0.0).any()
    assert not in_boxes(found.boxes, free, 0.0).any()
    assert found.label("body", static=True) == "body (piece of mesh.obj)"
    assert found.label("body", static=False) == "body (hull of mesh.obj)"


def test_a_solid_mesh_stays_one_hull_and_keeps_its_name(tmp_path: Path) -> None:
    found = element(tmp_path, given.triangles_of((((0.0, 0.0, 0.0), (0.5, 0.4, 0.3)),)))
    assert len(found.hulls) == 1
    assert len(found.boxes) == 1
    assert found.label("body", static=True) == "body"


@pytest.mark.parametrize(("radius", "corners"), [(0.5, 40), (0.35, 8), (0.7, 24)])
def test_strips_cover_a_round_mesh_and_leave_the_corners_of_its_box_free(
    tmp_path: Path, radius: float, corners: int
) -> None:
    triangles, rng = given.prism(radius, 0.7, corners), np.random.default_rng(0)
    found = element(tmp_path, triangles)
    assert in_boxes(found.boxes, given.points_on(triangles, 20, rng), 1e-6).all()
    angle = rng.uniform(-np.pi, np.pi, 500)
    outside = np.column_stack(
        [1.1 * radius * np.cos(angle), 1.1 * radius * np.sin(angle), np.full(500, 0.35)]
    )
    held = in_boxes(found.boxes, outside, 0.0).mean()
    assert held < 0.2, "a box around the prism holds 45 % of these points"


def test_a_mesh_with_damaged_faces_is_its_hull(tmp_path: Path) -> None:
    element(tmp_path, given.triangles_of(given.table()))
    path = tmp_path / "mesh.obj"
    path.write_text(path.read_text() + "f 1 2 999999\n")
    model = Articulated(read_urdf(tmp_path / "model.urdf"))
    assert len(model.static_elements["body"][0].hulls) == 1


@pytest.mark.parametrize("name", ["island.obj", "tray.obj"])
def test_hollow_meshes_of_other_people_are_cut(tmp_path: Path, name: str) -> None:
    from momapos.model.urdf.meshes import mesh_triangles

    found = element(tmp_path, mesh_triangles(optional.there(CASES / "furniture" / name)))
    assert len(found.hulls) > 1
