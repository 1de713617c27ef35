"""Links of robots in convex pieces: they contain the mesh and leave the space around it free."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tests.meshes as given
from jaxtyping import Bool, Float
from tests.urdf_parts import box, joint, link

from momapos.core import Cache
from momapos.model.collision.spheres import build_spheres
from momapos.model.kinematics.chain import build_chain
from momapos.model.robots.amended_urdf import Amendments
from momapos.model.urdf import articulated
from momapos.model.urdf.articulated import LINK_CUT, Articulated
from momapos.model.urdf.hulls import Hull
from momapos.planning.grasps.handle_shapes import convex_of
from momapos.verification.exact_shapes import hulls_of, piece_names, prepared
from momapos.verification.link_bodies import body_poses
from momapos.verification.sweep import Overlaps, all_pairs

PLATE: given.Box = ((-0.3, -0.25, 0.1), (0.3, 0.25, 0.35))
MAST: given.Box = ((-0.3, -0.06, 0.35), (-0.2, 0.06, 1.4))
LINKS: dict[str, tuple[tuple[given.Box, ...], given.Box]] = {
    "base with a mast": ((PLATE, MAST), ((-0.18, -0.2, 0.37), (0.25, 0.2, 1.3))),
    "base with two masts": (
        (PLATE, MAST, ((0.2, -0.06, 0.35), (0.3, 0.06, 1.4))),
        ((-0.18, -0.2, 0.37), (0.18, 0.2, 1.3)),
    ),
    "cage": (
        (
            PLATE,
            *(
                ((x, y, 0.35), (x + 0.04, y + 0.04, 1.0))
                for x in (-0.3, 0.26)
                for y in (-0.25, 0.21)
            ),
            ((-0.3, -0.25, 1.0), (0.3, 0.25, 1.05)),
        ),
        ((-0.24, -0.19, 0.37), (0.24, 0.19, 0.98)),
    ),
    "forearm with an offset wrist": (
        (((-0.04, -0.04, 0.0), (0.04, 0.04, 0.3)), ((0.04, -0.04, 0.22), (0.2, 0.04, 0.3))),
        ((0.06, -0.03, 0.0), (0.18, 0.03, 0.2)),
    ),
    "hand with two fixed fingers": (
        (
            ((-0.02, -0.1, 0.0), (0.02, 0.1, 0.08)),
            ((-0.02, -0.1, 0.08), (0.02, -0.08, 0.2)),
            ((-0.02, 0.08, 0.08), (0.02, 0.1, 0.2)),
        ),
        ((-0.015, -0.06, 0.1), (0.015, 0.06, 0.19)),
    ),
}
"""Boxes of a mesh, and the space in its hull that is free."""


def robot_of(folder: Path, boxes: tuple[given.Box, ...], cache: Cache | None = None) -> Articulated:
    """Return a robot whose arm link 'body' is a mesh, next to a link that is a box."""
    given.write_obj(folder / "body.obj", given.triangles_of(boxes))
    limit = '<limit lower="-3" upper="3" effort="1" velocity="1"/>'
    parts = [
        link("base_link", box(0.1, 0.1, 0.1)),
        link("body", '<mesh filename="body.obj"/>'),
        joint("turn", "revolute", "base_link", "body", "0 0 1", "0 0 1", limit),
    ]
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="one">{"".join(parts)}</robot>')
    return Articulated(Amendments().read(path, cache)[0], cache=cache)


def inside(hulls: tuple[Hull, ...], points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    return np.any([convex_of(h, np.eye(4)).depth(points) > -1e-6 for h in hulls], axis=0)


@pytest.mark.parametrize("name", LINKS)
def test_pieces_of_a_link_contain_its_mesh_and_leave_the_space_around_it_free(
    tmp_path: Path, name: str
) -> None:
    boxes, free = LINKS[name]
    rng = np.random.default_rng(0)
    hulls = robot_of(tmp_path, boxes).hulls["body"]
    assert 1 < len(hulls) <= LINK_CUT.max_pieces
    assert inside(hulls, given.points_on(given.triangles_of(boxes), 20, rng)).all()
    assert inside(hulls, np.concatenate([given.points_in(one, 50, rng) for one in boxes])).all()
    assert not inside(hulls, given.points_in(free, 300, rng)).any()


@pytest.mark.parametrize(
    "boxes",
    [
        (PLATE,),
        # A finger: half of its hull is free, which is 9 ml.
        (((0.0, 0.0, 0.0), (0.06, 0.02, 0.005)), ((0.0, 0.0, 0.005), (0.005, 0.02, 0.02))),
        # A plate with a rim of 6 mm, whose hull has hardly more volume.
        (PLATE, ((-0.3, -0.25, 0.35), (0.3, -0.24, 0.356))),
    ],
)
def test_links_whose_hulls_hold_little_more_than_they_stay_whole(
    tmp_path: Path, boxes: tuple[given.Box, ...]
) -> None:
    robot = robot_of(tmp_path, boxes)
    (shape,) = robot.urdf.links["body"].collisions
    assert shape.mesh == tmp_path / "body.obj"
    assert shape.piece == ""


def test_a_link_with_damaged_faces_is_its_hull(tmp_path: Path) -> None:
    robot_of(tmp_path, LINKS["cage"][0])
    path = tmp_path / "body.obj"
    path.write_text(path.read_text() + "f 1 2 999999\n")
    record, _ = Amendments().read(tmp_path / "robot.urdf")
    assert len(Articulated(record).hulls["body"]) == 1


@pytest.mark.parametrize("name", ["cage", "base with a mast", "forearm with an offset wrist"])
def test_pieces_of_a_coarser_mesh_contain_the_finer_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """A mesh of 12,288 triangles per box, cut as one with 2,000 in all."""
    boxes, free = LINKS[name]
    monkeypatch.setattr(articulated, "LINK_CUT", replace(LINK_CUT, max_detail=2000))
    fine = given.triangles_of(boxes)
    for _ in range(5):
        a, b, c = fine.transpose(1, 0, 2)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)
        fine = np.concatenate([np.stack(part, 1) for part in parts])
    monkeypatch.setattr(given, "triangles_of", lambda _: fine)
    hulls = robot_of(tmp_path, boxes).hulls["body"]
    assert 1 < len(hulls) <= LINK_CUT.max_pieces
    points = fine.mean(1)
    deep = np.max([convex_of(hull, np.eye(4)).depth(points) for hull in hulls], axis=0)
    assert deep.min() > -2e-5
    middle = given.points_in(free, 300, np.random.default_rng(0))
    assert inside(hulls, middle).mean() < 0.2


def test_planner_and_exact_check_use_the_same_pieces_by_their_names(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, LINKS["cage"][0])
    own = robot.hulls["body"]
    chain, segments = build_chain(robot, "base_link", "body", ("turn",))
    hulls = build_spheres(robot, segments, (), ()).hulls
    _, shapes = prepared(robot)
    assert sum(name == "body" for name in shapes.names) == len(own) == hulls.of_group[-1]
    for k, (first, last) in enumerate(itertools.pairwise(hulls.first[: len(own) + 1])):
        index = [i for i, name in enumerate(shapes.names) if name == "body"][k]
        exact = shapes.core(index).points @ shapes.Ts_body_shape[index, :3, :3].T
        exact = exact + shapes.Ts_body_shape[index, :3, 3] + robot.rest_poses["body"][:3, 3]
        planned = hulls.vertices[first:last] + chain.d[0]
        np.testing.assert_allclose(np.sort(exact, 0), np.sort(planned, 0), atol=1e-9)
    names = [name for name in piece_names(robot) if name.startswith("body")]
    assert names == [f"body (piece {k} of body.obj)" for k in range(1, len(own) + 1)]


def test_pieces_are_the_same_from_a_cache_and_follow_the_mesh(tmp_path: Path) -> None:
    cache = Cache(tmp_path / "cache")
    first, again = (robot_of(tmp_path, LINKS["cage"][0], cache) for _ in range(2))
    for one, other in zip(first.hulls["body"], again.hulls["body"], strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
    changed = robot_of(tmp_path, LINKS["base with a mast"][0], cache)
    tops = [max(h.vertices[:, 2].max() for h in one.hulls["body"]) for one in (first, changed)]
    np.testing.assert_allclose(tops, [1.05, 1.4])


def test_a_contact_is_reported_with_its_piece_and_counts_once_per_link(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, LINKS["base with a mast"][0])
    bodies, shapes = prepared(robot)
    links = replace(shapes, names=piece_names(robot))
    Ts = links.placed(body_poses(bodies, {}, np.eye(4)))
    # A slab around most of the mast that reaches into the base below it.
    corners = np.array(list(itertools.product((-0.4, -0.23), (-0.2, 0.2), (1.2, 2.2))))
    slab = hulls_of(corners, np.array([0, 8]), 0, "slab")
    found = Overlaps(0.003)
    pairs = all_pairs(len(links), 1)
    found.add(links, Ts, slab, slab.Ts_body_shape[None], pairs, lambda _: "q[0]")
    check = found.check("contact")
    assert re.search(r"body \(piece \d of body\.obj\) \d+ mm in slab at q", check.detail)
    assert check.detail.count("slab") == 1
    assert check.culprit == "body and slab"
