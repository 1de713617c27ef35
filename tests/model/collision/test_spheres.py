"""Spheres cover the shapes of a robot, and protrude no farther than allowed."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import trimesh
from jaxtyping import Float
from tests.model.collision.exact_hulls import (
    directions,
    link_spheres,
    rotations,
    signed_distance,
    surface_points,
)
from tests.real import furniture

from momapos.core.geometry.transforms import pose
from momapos.model.collision.sphere_cover import (
    ARM,
    BODY,
    GRIPPER,
    MARGIN,
    MIN_BULKY_HALF,
    cover_shapes,
)
from momapos.model.collision.spheres import box_spheres
from momapos.model.robots.robot import Robot
from momapos.model.urdf.hulls import Boxes, hull_of
from momapos.model.urdf.reader import Geometry


def uncovered(
    points: Float[np.ndarray, "n 3"], center: Float[np.ndarray, "s 3"], radius: np.ndarray
) -> float:
    """Return the largest distance of a point from all spheres [m]."""
    return float((np.linalg.norm(points[:, None] - center, axis=-1) - radius).min(1).max())


def stick_out(
    shapes: tuple[Geometry, ...], center: Float[np.ndarray, "s 3"], radius: np.ndarray,
    rng: np.random.Generator,
) -> float:  # fmt: skip
    """Return the largest protrusion of a sphere from all shapes [m]."""
    surface = (center[:, None] + radius[:, None, None] * directions(300, rng)).reshape(-1, 3)
    return float(np.min([signed_distance(shape, surface) for shape in shapes], axis=0).max())


def test_spheres_cover_each_shape_of_the_arm(robot: Robot) -> None:
    rng = np.random.default_rng(0)
    for link in robot.spheres.links:
        center, radius = link_spheres(robot, link)
        for shape in robot.model.urdf.links[link].collisions:
            assert uncovered(surface_points(shape, 2000, rng), center, radius) < MARGIN + 1e-3


def test_spheres_protrude_least_from_the_gripper(robot: Robot) -> None:
    rng = np.random.default_rng(1)
    for link in robot.spheres.links:
        shapes = robot.model.urdf.links[link].collisions
        out = stick_out(shapes, *link_spheres(robot, link), rng)
        thin = [min(s.size[0], s.size[-1] / 2) if s.kind == "cylinder" else min(s.size) / 2
                for s in shapes]  # fmt: skip
        slender = (
            max(thin) <= MIN_BULKY_HALF
            and robot.segments.of_link[link] > robot.chain.prismatic.sum()
        )
        most = GRIPPER if link in robot.gripper_links else ARM if slender else BODY
        assert out < most + 1e-3, link


def test_moving_links_have_spheres_and_the_others_have_boxes(robot: Robot) -> None:
    shaped = [name for name, link in robot.model.urdf.links.items() if link.collisions]
    moving = {name for name in shaped if robot.segments.of_link[name] > 0}
    assert set(robot.spheres.links) == moving
    rng = np.random.default_rng(2)
    base = robot.base
    for name in set(shaped) - moving:
        T = robot.segments.T_segment_link[name]
        for shape in robot.model.urdf.links[name].collisions:
            points = surface_points(shape, 200, rng) @ T[:3, :3].T + T[:3, 3]
            local = np.einsum("nbi,bij->nbj", points[:, None] - base.center, base.rotation)
            assert (np.abs(local) <= base.half + 1e-6).all(-1).any(-1).all()


def test_the_number_of_spheres_is_small(robot: Robot) -> None:
    """Check time grows with their number; Fetch's arm carries its torso and head."""
    assert len(robot.spheres.radius) <= (220 if robot.name == "fetch" else 110)


def test_bounding_spheres_contain_their_groups(robot: Robot) -> None:
    s = robot.spheres
    assert s.start[0] == 0
    assert s.start[-1] == len(s.radius)
    for g in range(len(s.links)):
        part = slice(s.start[g], s.start[g + 1])
        reach = np.linalg.norm(s.center[part] - s.bound_center[g], axis=1) + s.radius[part]
        assert (reach <= s.bound_radius[g] + 1e-9).all()


def test_neighbors_and_disabled_pairs_are_never_checked(robot: Robot) -> None:
    s, parents = robot.spheres, {j.child: j.parent for j in robot.model.urdf.joints}
    pairs = {frozenset((s.links[a], s.links[b])) for a, b in s.pairs}
    assert not pairs & robot.disabled
    assert not pairs & {frozenset(pair) for pair in parents.items()}
    assert pairs


@pytest.mark.parametrize(
    ("kind", "size"),
    [
        ("box", (0.3, 0.3, 0.3)), ("box", (0.6, 0.02, 0.4)), ("box", (0.02, 0.03, 0.5)),
        ("box", (0.003, 0.003, 0.003)), ("box", (2.0, 1.0, 0.7)),
        ("cylinder", (0.05, 0.4)), ("cylinder", (0.2, 0.05)), ("cylinder", (0.06, 0.06)),
        ("cylinder", (0.002, 0.3)), ("cylinder", (0.3, 1.0)), ("sphere", (0.2,)),
    ],
)  # fmt: skip
@pytest.mark.parametrize("allowed", [GRIPPER, ARM])
def test_any_primitive_is_covered(kind: str, size: tuple[float, ...], allowed: float) -> None:
    rng = np.random.default_rng(3)
    T = pose(rng.normal(size=3), rotations(1, rng)[0])
    shape = Geometry(kind, size, T)  # type: ignore[arg-type]
    center, radius = cover_shapes((shape,), allowed)
    assert uncovered(surface_points(shape, 3000, rng), center, radius) < MARGIN + 1e-3
    # Wide discs and meshes are divided into cells, whose spheres may protrude farther.
    if max(size) < 0.5 and not (kind == "cylinder" and size[0] > 2 * size[1]):
        bulky = min(size[0], size[-1] / 2) if kind == "cylinder" else min(size) / 2
        most = BODY if bulky > MIN_BULKY_HALF else allowed
        assert stick_out((shape,), center, radius, rng) < most + 1e-3
    assert (radius > 0).all()


def test_a_shape_inside_another_needs_no_spheres() -> None:
    outer = Geometry("cylinder", (0.05, 0.3), np.eye(4))
    inner = Geometry("box", (0.04, 0.04, 0.1), np.eye(4))
    alone = cover_shapes((outer,), ARM)
    both = cover_shapes((inner, outer), ARM)
    assert len(both[1]) == len(alone[1])


@pytest.mark.parametrize("part", ["kitchen_small/chair", "Faucet/14", "MilkBottle/4043"])
def test_objects_are_covered(part: str) -> None:
    from momapos.model.urdf.reader import read_urdf

    rng = np.random.default_rng(4)
    for link in read_urdf(furniture(part), scale=0.4).links.values():
        for shape in link.collisions:
            center, radius = cover_shapes((shape,), ARM)
            v = hull_of(shape).vertices
            mixed = rng.dirichlet(np.ones(3), 800)
            points = np.einsum("nk,nki->ni", mixed, v[rng.integers(len(v), size=(800, 3))])
            assert uncovered(np.vstack([v, points]), center, radius) < MARGIN + 2e-3


def test_carried_boxes_are_covered() -> None:
    rng = np.random.default_rng(5)
    boxes = Boxes(rng.normal(size=(4, 3)), rotations(4, rng), rng.uniform(0.01, 0.15, (4, 3)))
    center, radius = box_spheres(boxes)
    for c, R, h in zip(boxes.center, boxes.rotation, boxes.half, strict=True):
        shape = Geometry("box", tuple(2 * h), pose(c, R))
        assert uncovered(surface_points(shape, 2000, rng), center, radius) < MARGIN + 1e-6


def test_a_mesh_with_many_faces_is_covered_tightly_and_with_little_memory(tmp_path: Path) -> None:
    """For an egg with 20,000 faces, grid points times faces would take gigabytes."""
    egg = trimesh.creation.icosphere(5)
    egg.apply_scale((0.05, 0.07, 0.12))
    egg.export(tmp_path / "egg.stl")
    shape = Geometry("mesh", (1.0, 1.0, 1.0), np.eye(4), mesh=tmp_path / "egg.stl")
    tracemalloc.start()
    center, radius = cover_shapes([shape], ARM)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    points = np.asarray(egg.vertices)
    assert uncovered(points, center, radius) < MARGIN + 1e-3
    # Protrusion of spheres, by supporting planes of the egg.
    normal = directions(500, np.random.default_rng(0))
    reach = ((center @ normal.T) + radius[:, None]).max(0) - (points @ normal.T).max(0)
    assert reach.max() < BODY
    assert peak < 200e6
