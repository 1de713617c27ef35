"""Convex pieces contain the whole mesh, and leave the space free that a hand reaches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tests.meshes as given
import trimesh
from jaxtyping import Bool, Float
from tests.real import BUILT_IN, furniture

from momapos.core.cache import Cache
from momapos.core.geometry.transforms import rotation_about
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.convex_pieces import FINE, convex_pieces
from momapos.model.urdf.hulls import hull_around
from momapos.model.urdf.meshes import mesh_triangles
from momapos.model.urdf.reader import read_urdf
from momapos.planning.grasps.handle_shapes import convex_of

ROUNDING = 1e-6
SHAPES = {
    "bow": given.BOW, "door": given.DOOR_WITH_BOW,
    "pocket": given.FRONT_WITH_POCKET, "lip": given.FRONT_WITH_LIP,
}  # fmt: skip
BEHIND_THE_BOW: given.Box = ((0.45, -0.053, -0.087), (0.55, -0.021, 0.087))
UNDER_THE_LIP: given.Box = ((-0.29, -0.0345, 0.1), (0.29, -0.0205, 0.1395))
ROOM = {
    "bow": BEHIND_THE_BOW, "door": BEHIND_THE_BOW, "pocket": given.POCKET, "lip": UNDER_THE_LIP,
}  # fmt: skip


def held(
    pieces: list[Float[np.ndarray, "n 3"]], points: Float[np.ndarray, "m 3"], slack: float
) -> Bool[np.ndarray, " m"]:
    """Return which points are in some piece, or within a distance of it [m]."""
    hulls = [convex_of(hull_around(piece, ""), np.eye(4)) for piece in pieces]
    return np.any([hull.depth(points) > -slack for hull in hulls], axis=0)


@pytest.mark.parametrize("name", SHAPES)
def test_pieces_contain_the_whole_surface_and_all_solid_parts(name: str) -> None:
    rng, boxes = np.random.default_rng(0), SHAPES[name]
    triangles = given.triangles_of(boxes)
    pieces = convex_pieces(triangles)
    assert 1 < len(pieces) <= FINE.max_pieces
    assert held(pieces, given.points_on(triangles, 50, rng), ROUNDING).all()
    for box in boxes:
        assert held(pieces, given.points_in(box, 200, rng), ROUNDING).all()


@pytest.mark.parametrize("name", SHAPES)
def test_pieces_leave_space_for_fingers(name: str) -> None:
    triangles = given.triangles_of(SHAPES[name])
    inner = np.array(ROOM[name]) + 1e-3 * np.array([[1], [-1]])
    points = given.points_in((tuple(inner[0]), tuple(inner[1])), 500, np.random.default_rng(0))
    assert held([triangles.reshape(-1, 3)], points, 0.0).any()
    assert not held(convex_pieces(triangles), points, 0.0).any()


def test_a_convex_mesh_stays_one_piece() -> None:
    rng = np.random.default_rng(0)
    box = given.triangles_of((given.PANEL,))
    ball = np.asarray(trimesh.creation.icosphere(2, 0.2).triangles)
    cloud = np.asarray(trimesh.PointCloud(rng.normal(size=(40, 3))).convex_hull.triangles)
    without_back = box[(box[..., 1] < -1e-3).any(1)]
    for triangles in (box, ball, cloud, without_back, box[:1]):
        assert len(convex_pieces(triangles)) == 1


@pytest.mark.parametrize("seed", range(3))
def test_pieces_do_not_depend_on_order_orientation_or_repetition_of_triangles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    triangles = given.triangles_of(given.DOOR_WITH_BOW)
    other = np.concatenate([triangles, triangles[:, ::-1]])[rng.permutation(2 * len(triangles))]
    low, high = triangles.min((0, 1)), triangles.max((0, 1))
    points = rng.uniform(low, high, (2000, 3))
    one, two = (held(convex_pieces(t), points, 0.0) for t in (triangles, other))
    np.testing.assert_array_equal(one, two)


def test_the_pieces_of_a_rotated_mesh_are_rotated() -> None:
    R = rotation_about(np.array([0.6, 0.0, 0.8]), 0.7)
    triangles = given.triangles_of(given.DOOR_WITH_BOW)
    points = given.points_in(BEHIND_THE_BOW, 500, np.random.default_rng(0))
    pieces = convex_pieces(triangles @ R.T)
    assert held(pieces, given.points_on(triangles, 20, np.random.default_rng(1)) @ R.T, 1e-6).all()
    assert not held(pieces, points @ R.T, -1e-3).any()


def test_a_round_bow_handle_has_free_space_behind_its_middle() -> None:
    angle = np.linspace(0, np.pi, 25)
    middle = np.column_stack([0 * angle, -0.05 * np.sin(angle), 0.1 * np.cos(angle)])
    across = np.array([[-1.0, 0, 0], [0, -1, 0], [1, 0, 0], [0, 1, 0]]) * 0.007
    rings = middle[:, None] + across
    a, b = rings[:-1], rings[1:]
    c, d = np.roll(a, -1, 1), np.roll(b, -1, 1)
    triangles = np.concatenate([np.stack([a, b, c], 2), np.stack([c, b, d], 2)]).reshape(-1, 3, 3)
    pieces = convex_pieces(triangles)
    assert held(pieces, given.points_on(triangles, 10, np.random.default_rng(0)), ROUNDING).all()
    room = np.array([[0.0, -0.02, 0.0], [0.0, -0.025, 0.03], [0.0, -0.01, -0.05]])
    assert held([triangles.reshape(-1, 3)], room, 0.0).all()
    assert not held(pieces, room, 0.0).any()


@pytest.mark.parametrize(
    ("name", "joint"), [("Microwave/7263", "joint_0"), ("OvenCounter/101773", "joint_0")]
)
def test_pieces_of_real_doors_contain_their_meshes(name: str, joint: str) -> None:
    rng = np.random.default_rng(0)
    model = Articulated(read_urdf(furniture(name)))
    cut = 0
    for link in model.moved_by(joint):
        for k, shape in enumerate(model.urdf.links[link].collisions):
            pieces = model.pieces(link, k)
            cut += len(pieces) > 1
            points = given.points_on(mesh_triangles(shape.mesh) * np.array(shape.size), 3, rng)
            T = shape.T_link_geometry
            placed = points @ T[:3, :3].T + T[:3, 3]
            assert held([hull.vertices for hull in pieces], placed, 1e-5).all()
    assert cut > 0


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_primitive_has_its_hull_as_its_only_piece(name: str) -> None:
    model = Articulated(read_urdf(furniture(name)))
    for link in model.links:
        for k, hull in enumerate(model.hulls[link]):
            assert model.pieces(link, k) == (hull,)


def test_cached_pieces_equal_computed_ones(tmp_path: Path) -> None:
    given.write_obj(tmp_path / "door.obj", given.triangles_of(given.DOOR_WITH_BOW))
    (tmp_path / "door.urdf").write_text(
        '<robot name="door"><link name="door"><collision><geometry><mesh filename="door.obj"/>'
        "</geometry></collision></link></robot>"
    )
    urdf = read_urdf(tmp_path / "door.urdf")
    first, second = (Articulated(urdf, cache=Cache(tmp_path / "cache")) for _ in range(2))
    one, two = first.pieces("door", 0), second.pieces("door", 0)
    assert len(one) == len(two) == 4
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
        np.testing.assert_array_equal(a.faces, b.faces)
