"""Hulls of meshes with thousands of vertices, searched from neighbor to neighbor."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh
from tests.model.collision.exact_hulls import directions, hulls_meet, random_boxes, random_states

from momapos.core.geometry.transforms import invert, pose
from momapos.model.collision.arm_collision import place_segments
from momapos.model.collision.link_hulls import (
    BIN_CENTERS,
    DIRECTION_BINS,
    MAX_SCANNED_VERTICES,
    climb,
    direction_bin,
    hull_meets_box,
    hulls_overlap,
)
from momapos.model.collision.self_collision import arm_spheres
from momapos.model.collision.spheres import Spheres
from momapos.model.kinematics.chain import Chain, build_chain, chain_arrays
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf
from momapos.verification.convex import Body, overlap


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Chain, Spheres]:
    """Build a drum with flat ends that swings on a box next to an egg that swings."""
    folder = tmp_path_factory.mktemp("arm")
    trimesh.creation.icosphere(4).apply_scale((0.1, 0.2, 0.3)).export(folder / "egg.stl")
    trimesh.creation.cylinder(0.2, 0.3, sections=500).export(folder / "drum.stl")
    parts = ['<link name="base_link"/>']
    for name, parent in (("arm", "base_link"), ("egg", "arm"), ("wrist", "arm"), ("drum", "wrist")):
        shape = f'<mesh filename="{name}.stl"/>' if name in ("egg", "drum") else ""
        collision = f"<collision><geometry>{shape}</geometry></collision>" if shape else ""
        parts += [
            f'<link name="{name}">{collision}</link>',
            f'<joint name="{name}_joint" type="revolute"><parent link="{parent}"/>'
            f'<child link="{name}"/><origin xyz="0.3 0.15 0.1"/><axis xyz="0.48 0.6 0.64"/>'
            '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>',
        ]
    file = folder / "arm.urdf"
    file.write_text(f'<robot name="arm">{"".join(parts)}</robot>')
    model = Articulated(read_urdf(file))
    joints = tuple(f"{name}_joint" for name in ("arm", "wrist", "drum"))
    chain, segments = build_chain(model, "base_link", "drum", joints)
    return chain, arm_spheres(model, chain, segments, frozenset(), ["drum"])


def test_climbing_finds_a_farthest_vertex(arm: tuple[Chain, Spheres]) -> None:
    hulls = arm[1].hulls
    arrays = hulls.arrays
    large = np.flatnonzero(np.diff(hulls.first) > MAX_SCANNED_VERTICES)
    assert len(large) == 2
    axes = np.vstack([np.eye(3), -np.eye(3), np.zeros((1, 3))])
    for h in large:
        own = hulls.vertices[hulls.first[h] : hulls.first[h + 1]]
        for direction in np.vstack([axes, directions(300, np.random.default_rng(0))]):
            v = climb(arrays, hulls.begin[h, direction_bin(direction)], direction)
            assert hulls.first[h] <= v < hulls.first[h + 1]
            assert hulls.vertices[v] @ direction >= (own @ direction).max() - 1e-12


def test_each_bin_contains_its_center_and_the_zero_direction_has_a_bin() -> None:
    assert [direction_bin(tuple(middle)) for middle in BIN_CENTERS] == list(range(DIRECTION_BINS))
    for direction in ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (-1.0, 1.0, -1.0), (1e-310, 0.0, 0.0)):
        assert 0 <= direction_bin(direction) < DIRECTION_BINS


def test_overlap_of_hulls_with_many_vertices_agrees_with_the_exact_check(
    arm: tuple[Chain, Spheres],
) -> None:
    chain, spheres = arm
    egg, drum = (spheres.links.index(name) for name in ("egg", "drum"))
    hulls, meet = spheres.hulls, []
    pair = int(hulls.of_group[egg]), int(hulls.of_group[drum])
    R, p = np.empty((chain.last + 1, 3, 3)), np.empty((chain.last + 1, 3))
    Ts = np.tile(np.eye(4), (chain.last + 1, 1, 1))
    for q in random_states(chain, 200, np.random.default_rng(0)):
        place_segments(q, np.zeros(3), chain_arrays(chain), R, p)
        Ts[:, :3, :3], Ts[:, :3, 3] = R, p
        meet.append(hulls_overlap(R, p, hulls.arrays, egg, pair[1], pair[1] + 1))
        assert meet[-1] == hulls_meet(spheres, Ts, pair)
    assert 0.05 < np.mean(meet) < 0.95


@pytest.mark.parametrize("gap", [0.0, 0.05])
@pytest.mark.parametrize("cylinder", [False, True])
def test_a_hull_meets_a_box_or_cylinder_as_in_the_exact_check(
    arm: tuple[Chain, Spheres], *, cylinder: bool, gap: float
) -> None:
    chain, spheres = arm
    hulls, rng = spheres.hulls, np.random.default_rng(1)
    R, p = np.empty((chain.last + 1, 3, 3)), np.empty((chain.last + 1, 3))
    boxes = random_boxes(300, rng, (-0.4, -0.4, -0.2), (0.9, 0.9, 0.9))
    if cylinder:
        boxes.half[:, 1] = boxes.half[:, 0]
    arrays, found = (boxes.center, boxes.rotation, boxes.half), []
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    for b, q in enumerate(random_states(chain, len(boxes), rng)):
        place_segments(q, np.zeros(3), chain_arrays(chain), R, p)
        for h in range(hulls.of_group[-1]):
            half, m = boxes.half[b], hulls.segment[h]
            own = Body(hulls.vertices[hulls.first[h] : hulls.first[h + 1]], 0.0, gap)
            ends = np.array([[0.0, 0.0, -half[2]], [0.0, 0.0, half[2]]])
            other = Body(ends, half[0], 0.0) if cylinder else Body(half * corners, 0.0, 0.0)
            T = invert(pose(p[m], R[m])) @ pose(boxes.center[b], boxes.rotation[b])
            depth = overlap(other, own, np.ascontiguousarray(T))
            met = hull_meets_box(R, p, hulls.arrays, h, arrays, b, cylinder, gap)
            found.append((met, depth))
    met, depth = np.array(found).T
    assert met[depth > 1e-9].all()
    assert not met[depth < -1e-4].any()
    assert 0.1 < met.mean() < 0.9
