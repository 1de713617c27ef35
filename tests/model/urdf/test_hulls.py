"""Hulls contain their shapes, and boxes contain their hulls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Bool, Float
from numpy.testing import assert_allclose
from tests.model.collision.exact_hulls import rotations, surface_points
from tests.real import BUILT_IN, furniture

from momapos.core.errors import UrdfError
from momapos.core.geometry.transforms import pose
from momapos.model.robots.robot import Robot
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.hulls import (
    FLAT_THICKNESS,
    Boxes,
    Hull,
    cover,
    cover_shape,
    fit_box,
    hull_of,
)
from momapos.model.urdf.reader import Geometry, read_urdf

FURNITURE = (*BUILT_IN, "Fridge/10144", "Microwave/7128", "Faucet/14")


def outside(hull: Hull, points: Float[np.ndarray, "n 3"]) -> float:
    """Return how far the farthest point is outside a hull, by its faces [m]."""
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    normal = normal[area > 1e-14] / area[area > 1e-14, None]
    offset = np.einsum("ij,ij->i", normal, a[area > 1e-14])
    return float((points @ normal.T - offset).max())


def in_boxes(boxes: Boxes, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    local = np.einsum("nbi,bij->nbj", points[:, None] - boxes.center, boxes.rotation)
    return (np.abs(local) <= boxes.half + 1e-7).all(-1).any(-1)


def volume(boxes: Boxes) -> float:
    return float(np.prod(2 * boxes.half, axis=1).sum())


def points_in(hull: Hull, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Return a hull's vertices, and random convex combinations of a few and of all of them."""
    v = hull.vertices
    few = rng.dirichlet(np.ones(3), count)
    mixed = np.einsum("nk,nki->ni", few, v[rng.integers(len(v), size=(count, 3))])
    return np.vstack([v, mixed, rng.dirichlet(np.full(len(v), 0.3), count) @ v])


def write_obj(path: Path, points: Float[np.ndarray, "n 3"]) -> Geometry:
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in points))
    return Geometry("mesh", (1.0, 1.0, 1.0), np.eye(4), "", path)


def clouds(tmp_path: Path, count: int, rng: np.random.Generator) -> list[Hull]:
    """Generate hulls of random point clouds: round, long, flat and small."""
    return [
        hull_of(write_obj(tmp_path / f"{i}.obj", points))
        for i in range(count)
        for points in [
            rng.normal(size=(rng.integers(4, 60), 3)) * 10 ** rng.uniform(-2.5, 0, 3)
            @ rotations(1, rng)[0]
        ]
    ]  # fmt: skip


def hulls_of(name: str) -> list[Hull]:
    model = Articulated(read_urdf(furniture(name)))
    return [hull for hulls in model.hulls.values() for hull in hulls]


def test_faces_are_oriented_outward_and_close_the_hull(tmp_path: Path, robot: Robot) -> None:
    hulls = clouds(tmp_path, 20, np.random.default_rng(0))
    hulls += [hull for hulls in robot.model.hulls.values() for hull in hulls]
    for hull in hulls:
        assert outside(hull, hull.vertices) < 1e-6
        a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
        middle = hull.vertices.mean(0)
        assert np.einsum("ij,ij->", a - middle, np.cross(b - a, c - a)) > 0
        # Each edge belongs to two faces, which run along it in opposite directions.
        edges = hull.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        assert len(np.unique(edges, axis=0)) == len(edges)
        assert {tuple(e) for e in edges} == {tuple(e) for e in edges[:, ::-1]}


def test_a_hull_contains_its_mesh(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    for i in range(20):
        points = rng.normal(size=(50, 3)) * 10 ** rng.uniform(-2, 1, 3)
        T = pose(rng.normal(size=3), rotations(1, rng)[0])
        plain = write_obj(tmp_path / f"{i}.obj", points)
        scale = rng.choice([-1, 1], 3) * rng.uniform(0.5, 2, 3)
        shape = Geometry("mesh", tuple(scale), T, "", plain.mesh)
        hull = hull_of(shape)
        assert outside(hull, points * scale @ T[:3, :3].T + T[:3, 3]) < 1e-6
        size = np.ptp(hull.vertices @ T[:3, :3], axis=0)
        assert_allclose(size, np.ptp(points * scale, axis=0), atol=1e-6)


@pytest.mark.parametrize("name", [*BUILT_IN, "Fridge/10144", "Faucet/14"])
def test_hulls_contain_furniture(name: str) -> None:
    import trimesh

    model = Articulated(read_urdf(furniture(name)))
    for link, hulls in model.hulls.items():
        for shape, hull in zip(model.urdf.links[link].collisions, hulls, strict=True):
            if shape.kind == "mesh":
                mesh = trimesh.load(shape.mesh, force="mesh", process=False, skip_materials=True)
                points = np.array(mesh.vertices) * shape.size
            else:
                points = trimesh.creation.box(shape.size).vertices
            T = shape.T_link_geometry
            assert outside(hull, points @ T[:3, :3].T + T[:3, 3]) < 1e-5


@pytest.mark.parametrize(
    ("kind", "size", "loose"),
    [("box", (0.3, 0.02, 1.0), 0.0), ("cylinder", (0.2, 0.5), 0.01),
     ("cylinder", (0.5, 0.01), 0.01), ("sphere", (0.3,), 0.03)],
)  # fmt: skip
def test_a_hull_contains_its_primitive_tightly(
    kind: str, size: tuple[float, ...], loose: float
) -> None:
    rng = np.random.default_rng(2)
    T = pose(rng.normal(size=3), rotations(1, rng)[0])
    shape = Geometry(kind, size, T)  # type: ignore[arg-type]
    hull = hull_of(shape)
    assert outside(hull, surface_points(shape, 5000, rng)) < 1e-6
    reach = max(size[0], 0.5 * size[-1])
    body = np.linalg.norm(hull.vertices - T[:3, 3], axis=1).max()
    exact = np.linalg.norm(surface_points(shape, 5000, rng) - T[:3, 3], axis=1).max()
    assert body <= exact + loose * reach + 1e-6


@pytest.mark.parametrize("points", [3, 4, 30])
def test_the_hull_of_a_flat_mesh_has_a_thickness(tmp_path: Path, points: int) -> None:
    rng = np.random.default_rng(3)
    R = rotations(1, rng)[0]
    flat = np.column_stack([rng.normal(size=(points, 2)), np.zeros(points)]) @ R.T + 0.3
    hull = hull_of(write_obj(tmp_path / "flat.obj", flat))
    assert outside(hull, flat) < 1e-6
    assert_allclose(np.ptp(hull.vertices @ R[:, 2]), FLAT_THICKNESS, rtol=0.01)


def test_the_hull_of_a_line_has_a_thickness(tmp_path: Path) -> None:
    line = np.linspace(0, 1, 5)[:, None] * np.array([0.3, -0.2, 0.9])
    hull = hull_of(write_obj(tmp_path / "line.obj", line))
    assert outside(hull, line) < 1e-6
    assert volume(cover(hull)) < 3e-6


def test_a_mesh_without_points_or_with_nan_is_rejected(tmp_path: Path) -> None:
    for points, words in (
        (np.zeros((0, 3)), "empty"), (np.full((4, 3), np.nan), "NaN"),
        (np.full((4, 3), 1e9), "damaged"),
    ):  # fmt: skip
        with pytest.raises(UrdfError, match=words):
            hull_of(write_obj(tmp_path / f"{words}.obj", points))


def check_cover(hull: Hull, rng: np.random.Generator) -> None:
    boxes = cover(hull)
    assert in_boxes(boxes, points_in(hull, 400, rng)).all()
    assert volume(boxes) <= volume(cover(hull, depth=0)) * (1 + 1e-9)
    assert len(boxes) <= 8
    square = boxes.rotation @ np.swapaxes(boxes.rotation, 1, 2)
    assert_allclose(square, np.broadcast_to(np.eye(3), square.shape), atol=1e-9)
    assert_allclose(np.linalg.det(boxes.rotation), 1.0)


def test_boxes_cover_a_hull_and_have_no_more_volume_than_one(tmp_path: Path, robot: Robot) -> None:
    rng = np.random.default_rng(4)
    hulls = clouds(tmp_path, 30, rng)
    hulls += [hull for hulls in robot.model.hulls.values() for hull in hulls]
    for hull in hulls:
        check_cover(hull, rng)


@pytest.mark.parametrize("name", FURNITURE)
def test_boxes_cover_furniture(name: str) -> None:
    rng = np.random.default_rng(5)
    for hull in hulls_of(name):
        check_cover(hull, rng)


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize(
    ("kind", "size"),
    [
        ("box", (0.5, 0.2, 0.03)), ("cylinder", (0.03, 0.6)), ("cylinder", (0.25, 0.4)),
        ("cylinder", (0.6, 0.02)), ("sphere", (0.2,)),
    ],
)  # fmt: skip
def test_boxes_contain_their_primitive(
    kind: str, size: tuple[float, ...], *, upright: bool
) -> None:
    rng = np.random.default_rng(9)
    T = pose(rng.normal(size=3), None if upright else rotations(1, rng)[0])
    shape = Geometry(kind, size, T)  # type: ignore[arg-type]
    boxes, hull = cover_shape(shape, hull_of(shape)), hull_of(shape)
    assert in_boxes(boxes, surface_points(shape, 2000, rng)).all()
    assert volume(boxes) <= volume(cover(hull, depth=0)) * (1 + 1e-6)
    if kind == "box":
        assert len(boxes) == 1


def test_a_wedge_is_covered_by_several_boxes() -> None:
    """A single box would be mostly empty."""
    wedge = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1.0], [0, 0.2, 0], [1, 0.2, 0], [0, 0.2, 1.0]])
    vertices, faces = wedge, hull_faces(wedge)
    boxes = cover(Hull(vertices, faces, "wedge"))
    assert len(boxes) > 1
    assert volume(boxes) < 0.8 * 0.2


def hull_faces(points: Float[np.ndarray, "n 3"]) -> np.ndarray:
    from scipy.spatial import ConvexHull

    return ConvexHull(points).simplices


def test_a_fitted_box_contains_its_points() -> None:
    rng = np.random.default_rng(6)
    for _ in range(50):
        points = rng.normal(size=(rng.integers(2, 80), 3)) * 10 ** rng.uniform(-3, 1, 3)
        center, rotation, half = fit_box(points)
        assert (np.abs((points - center) @ rotation) <= half + 1e-6).all()


def test_the_fitted_box_of_a_rotated_box_is_the_box() -> None:
    """The diagonals of its triangulated faces must not mislead the fit."""
    rng = np.random.default_rng(7)
    for R in rotations(30, rng):
        half = rng.uniform(0.005, 0.5, 3)
        corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * half
        middle = rng.normal(size=3)
        center, _, fitted = fit_box(corners @ R.T + middle)
        assert_allclose(center, middle, atol=1e-6)
        assert_allclose(np.sort(fitted), np.sort(half), atol=1e-6)


def test_the_fitted_box_of_an_axis_aligned_box_is_axis_aligned() -> None:
    """Boxes stay recognizable: no rotation without a smaller volume."""
    rng = np.random.default_rng(8)
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    for _ in range(20):
        half = rng.uniform(0.1, 0.5, 3)
        points = np.repeat(corners * half, 5, axis=0) + rng.normal(size=(40, 3)) * 3e-4
        assert_allclose(fit_box(points)[1], np.eye(3))
