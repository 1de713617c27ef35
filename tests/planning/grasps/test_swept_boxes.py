"""Test when boxes that move along a line touch convex hulls."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from momapos.model.urdf.hulls import Boxes, Hull
from momapos.planning.grasps.handle_shapes import NEVER, Convex, convex_of, touches_hull

X = np.array([1.0, 0.0, 0.0])


def convex(points: np.ndarray) -> Convex:
    hull = ConvexHull(points)
    used = hull.vertices
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    faces = number[hull.simplices]
    a, b, c = (points[used][faces[:, k]] for k in range(3))
    inward = np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return convex_of(Hull(points[used], faces, ""), np.eye(4))


def cube(half: float) -> Convex:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    return convex(half * corners)


def box(half: tuple[float, float, float], turn: float = 0.0) -> Boxes:
    R = Rotation.from_euler("z", turn).as_matrix()
    return Boxes(np.zeros((1, 3)), R[None], np.array([half]))


def test_a_box_touches_a_cube_where_their_faces_meet() -> None:
    p = np.array([[-1.0, 0.0, 0.0], [-1.0, 0.35, 0.0], [0.15, 0.0, 0.0], [1.0, 0.0, 0.0]])
    R = np.tile(np.eye(3), (4, 1, 1))
    touch = touches_hull(box((0.1, 0.2, 0.1)), cube(0.1), R, p, X, margin=0.01)
    np.testing.assert_allclose(touch.begin[[0, 2, 3], 0], [0.79, -0.36, -1.21])
    np.testing.assert_allclose(touch.end[[0, 2, 3], 0], [1.21, 0.06, -0.79])
    np.testing.assert_allclose(touch.cosine[[0, 2, 3], 0], 1.0)
    assert touch.begin[1, 0] == NEVER


def test_the_cosine_is_that_of_the_touched_face() -> None:
    turn = np.radians(30.0)
    p = np.array([[-1.0, 0.0, 0.0]])
    bar = cube(0.01)
    touch = touches_hull(box((0.05, 0.5, 0.05), turn), bar, np.eye(3)[None], p, X)
    assert touch.cosine[0, 0] == pytest.approx(np.cos(turn))


def test_contact_is_never_reported_late_and_rarely_early() -> None:
    rng = np.random.default_rng(5)
    early, checked = 0, 0
    for _ in range(30):
        hull = convex(0.1 * rng.normal(size=(int(rng.integers(5, 20)), 3)))
        half = rng.uniform(0.01, 0.08, 3)
        R = Rotation.random(4, rng=rng).as_matrix()
        p = rng.normal(size=(4, 3)) * 0.1 - 0.4 * R[:, :, 0]
        boxes = Boxes(np.zeros((1, 3)), np.eye(3)[None], half[None])
        touch = touches_hull(boxes, hull, R, p, X)
        for g in range(4):
            for t in rng.uniform(0.2, 0.6, 5):
                reported = bool(touch.begin[g, 0] <= t <= touch.end[g, 0])
                truly = meet(hull, half, R[g], p[g] + t * R[g, :, 0])
                assert reported or not truly
                early += reported and not truly
                checked += truly
    assert checked > 100
    assert early < 0.1 * checked


def meet(hull: Convex, half: np.ndarray, R: np.ndarray, p: np.ndarray) -> bool:
    """Check by linear programming whether a hull and a box intersect."""
    A = np.concatenate([hull.normals, R.T, -R.T])
    b = np.concatenate([hull.offsets, half + R.T @ p, half - R.T @ p]) - 1e-9
    return linprog(np.zeros(3), A, b, bounds=(None, None)).status == 0


def test_depth_is_to_the_nearest_face_and_the_line_leaves_by_the_next_one() -> None:
    points = np.array([[[0.05, 0.0, 0.08], [0.0, 0.0, 0.2]]])
    depth, cosine = cube(0.1).surface(points, np.array([[0.6, 0.0, 0.8]]))
    np.testing.assert_allclose(depth, [[0.02, -0.1]])
    np.testing.assert_allclose(cosine[0, 0], 0.8)
