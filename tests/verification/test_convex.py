"""Signed distances and swept depths agree with closed forms and reference implementations."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from momapos.core.geometry.transforms import invert, pose
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import Geometry, Link, Urdf
from momapos.verification.convex import Body, overlap
from momapos.verification.exact_shapes import Shapes, shapes_of
from momapos.verification.link_bodies import bodies_of
from momapos.verification.motion_loads import outside
from momapos.verification.sweep import all_pairs, deepest, first_contact

seeds = st.integers(0, 2**32 - 1)


def box(size: np.ndarray) -> Body:
    signs = np.array(list(product((-1, 1), repeat=3)))
    return Body(signs * (np.asarray(size) / 2), 0.0, 0.0)


def cylinder(radius: float, length: float) -> Body:
    return Body(np.array([[0.0, 0.0, -length / 2], [0.0, 0.0, length / 2]]), radius, 0.0)


def sphere(radius: float) -> Body:
    return Body(np.zeros((1, 3)), 0.0, radius)


def cloud(rng: np.random.Generator) -> Body:
    points = rng.normal(size=(int(rng.integers(4, 40)), 3)) * rng.uniform(0.05, 0.3, 3)
    return Body(points[ConvexHull(points).vertices], 0.0, 0.0)


def random_pose(rng: np.random.Generator, reach: float = 0.3) -> np.ndarray:
    return pose(rng.normal(size=3) * reach, Rotation.random(rng=rng).as_matrix())


def exact_overlap(a: np.ndarray, b: np.ndarray, T: np.ndarray) -> float:
    """Reference: the signed distance of the origin from the hull of all differences."""
    points = (a @ T[:3, :3].T + T[:3, 3])[:, None] - b
    points = points.reshape(-1, 3)
    depth = -float(ConvexHull(points).equations[:, 3].max())
    if depth >= 0.0:
        return depth
    weight = 1e4  # for the condition that the hull weights sum to one
    _, rest = nnls(np.vstack([points.T, np.full(len(points), weight)]), [0.0, 0.0, 0.0, weight])
    return -float(rest)


@settings(max_examples=300)
@given(seeds)
def test_aligned_boxes_have_the_overlap_of_their_intervals(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.choice([0.01, 0.02, 0.3, 0.5, 1.0, 2.0], (2, 3))
    shift = rng.choice([0.0, 0.01, 0.02, 0.05, 0.1, 0.25, 0.3, 0.5, 1.0], 3)
    gap = np.abs(shift) - (a + b) / 2
    expected = -gap.max() if gap.max() <= 0 else -np.linalg.norm(np.maximum(gap, 0.0))
    assert overlap(box(a), box(b), pose(shift)) == pytest.approx(expected, abs=2e-6)


@settings(max_examples=100)
@given(seeds)
def test_hulls_agree_with_the_hull_of_their_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, T = cloud(rng), cloud(rng), random_pose(rng)
    assert overlap(a, b, T) == pytest.approx(exact_overlap(a[0], b[0], T), abs=5e-6)


@settings(max_examples=100)
@given(seeds)
def test_the_order_of_two_bodies_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bodies = (cloud(rng), cylinder(*rng.uniform(0.02, 0.2, 2)), sphere(rng.uniform(0.02, 0.2)))
    a, b, T = bodies[seed % 3], bodies[seed // 3 % 3], random_pose(rng)
    assert overlap(a, b, T) == pytest.approx(overlap(b, a, invert(T)), abs=1e-4)


@settings(max_examples=100)
@given(seeds)
def test_the_overlap_of_a_ball_and_a_cylinder_agrees_with_the_closed_form(seed: int) -> None:
    rng = np.random.default_rng(seed)
    radius, length, ball = rng.uniform(0.02, 0.3, 3)
    center = rng.normal(size=3) * 0.2
    beyond = np.array([np.hypot(*center[:2]) - radius, abs(center[2]) - length / 2])
    apart = np.linalg.norm(np.maximum(beyond, 0.0)) + min(beyond.max(), 0.0)
    found = overlap(sphere(ball), cylinder(radius, length), pose(center))
    assert found == pytest.approx(ball - apart, abs=1e-5)


@pytest.mark.parametrize("core", [box(np.ones(3)), cylinder(0.5, 1.0), sphere(0.5)])
def test_a_body_overlaps_itself_by_its_width(core: Body) -> None:
    assert overlap(core, core, np.eye(4)) == pytest.approx(1.0, abs=5e-3)


def random_shapes(rng: np.random.Generator, count: int) -> Shapes:
    shapes = []
    for _ in range(count):
        T = random_pose(rng, 0.1)
        kind = ("box", "cylinder", "sphere")[int(rng.integers(3))]
        size = tuple(rng.uniform(0.02, 0.2, {"box": 3, "cylinder": 2, "sphere": 1}[kind]))
        shapes.append(Geometry(kind, size, T))
    links = {"body": Link("body", tuple(shapes), ())}
    model = Articulated(Urdf("shapes", None, "body", links, ()))
    return shapes_of(model, bodies_of(model))


@pytest.mark.parametrize("floor", [0.0, -0.05])
@pytest.mark.parametrize("seed", range(5))
def test_the_deepest_overlap_equals_that_of_checking_every_state(seed: int, floor: float) -> None:
    rng = np.random.default_rng(seed)
    a, b = random_shapes(rng, 4), random_shapes(rng, 5)
    turn = Rotation.from_rotvec(np.linspace(0, 2, 60)[:, None] * rng.normal(size=3)).as_matrix()
    Ts = np.array([pose((0.01 * i - 0.3, 0.1, 0.0), R) for i, R in enumerate(turn)])
    Ts_a, Ts_b = a.placed(Ts[:, None]), b.placed(np.eye(4)[None, None])
    pairs = all_pairs(4, 5)
    depth, state = deepest(a, Ts_a, b, Ts_b, pairs, floor)
    for (i, j), found, where in zip(pairs.tolist(), depth, state, strict=True):
        every = [overlap(a.core(i), b.core(j), invert(Ts_b[0, j]) @ T) for T in Ts_a[:, i]]
        assert found == pytest.approx(max(*every, floor), abs=2e-6)
        assert (where == -1) == (max(every) <= floor + 1e-6)


def test_outside_is_the_signed_distance_from_the_polygon() -> None:
    corner = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float)
    points = np.array([[0.5, 0.5], [1.5, 1.5], [3.0, 0.5], [3.0, -1.0], [1.0, 1.0]])
    expected = [-0.5, 0.5, 1.0, np.sqrt(2), 0.0]
    np.testing.assert_allclose(outside(corner, points), expected, atol=1e-12)


def one_shape(kind: str, size: tuple[float, ...]) -> Shapes:
    link = Link("body", (Geometry(kind, size, np.eye(4)),), ())
    model = Articulated(Urdf("shape", None, "body", {"body": link}, ()))
    return shapes_of(model, bodies_of(model))


@pytest.mark.parametrize("lean", [0.0, 0.5, 1.2])
def test_a_ball_on_its_way_bites_by_the_cosine_of_its_angle_to_the_normal(lean: float) -> None:
    """Whether the path begins before the wall, or in it; a path that ends there bites less."""
    ball, wall = one_shape("sphere", (0.05,)), one_shape("box", (0.2, 9.0, 9.0))
    travel = np.linspace(0.0, 0.3, 601)
    Ts = np.tile(np.eye(4), (601, 1, 1, 1))
    press = np.tile([0.01 * np.cos(lean), 0.01 * np.sin(lean), 0.0], (601, 1))
    for first in (-0.2, -0.145):
        Ts[:, 0, 0, 3] = first + np.cos(lean) * travel  # it touches the wall at -0.15
        Ts[:, 0, 1, 3] = np.sin(lean) * travel
        state, bite = first_contact(ball, Ts, travel, wall, np.eye(4)[None], press)
        assert travel[state] == pytest.approx(max(-0.15 - first, 0.0) / np.cos(lean), abs=6e-4)
        assert bite == pytest.approx(np.cos(lean), abs=1e-3)
        last = state + 11  # 5.5 of 10 mm
        _, bite = first_contact(ball, Ts[:last], travel[:last], wall, np.eye(4)[None], press[:last])
        assert bite == pytest.approx(0.5 * np.cos(lean), abs=1e-3)
    Ts[:, 0, 0, 3] = -0.16
    assert first_contact(ball, Ts, travel, wall, np.eye(4)[None], press) == (-1, -np.inf)
