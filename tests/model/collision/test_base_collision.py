"""Collisions of base poses agree with coal."""

from __future__ import annotations

import coal
import numpy as np
import pytest
from jaxtyping import Float
from tests.model.collision.exact_hulls import random_boxes

from momapos.core.geometry.transforms import pose, pose_planar
from momapos.model.collision.arm_collision import FREE
from momapos.model.collision.base_collision import base_hits
from momapos.model.robots.robot import Robot
from momapos.model.urdf.hulls import Boxes


def box_distances(
    base: Boxes, bases: Float[np.ndarray, "n 3"], boxes: Boxes, clearance: float
) -> Float[np.ndarray, "n boxes"]:
    """Return the signed distance of each box of the scene from the base's boxes, by coal."""

    def shapes(some: Boxes, grow: float) -> list[object]:
        return [coal.Box(*map(float, 2 * (half + grow))) for half in some.half]

    def at(T: np.ndarray) -> object:
        return coal.Transform3s(np.ascontiguousarray(T[:3, :3]), T[:3, 3])

    ours, theirs = shapes(base, clearance), shapes(boxes, 0.0)
    there = [at(pose(c, R)) for c, R in zip(boxes.center, boxes.rotation, strict=True)]
    out = np.full((len(bases), len(boxes)), np.inf)
    for i, T in enumerate(pose_planar(bases)):
        for a, c, R in zip(ours, base.center, base.rotation, strict=True):
            here = at(T @ pose(c, R))
            for b, (other, place) in enumerate(zip(theirs, there, strict=True)):
                result = coal.DistanceResult()
                coal.distance(a, here, other, place, coal.DistanceRequest(), result)
                out[i, b] = min(out[i, b], result.min_distance)
    return out


@pytest.mark.parametrize("clearance", [0.0, 0.05])
def test_the_first_hit_agrees_with_coal(clearance: float) -> None:
    rng = np.random.default_rng(0)
    base = random_boxes(3, rng, (-0.3, -0.3, 0.2), (0.3, 0.3, 0.6))
    room = random_boxes(6, rng, (-1.5, -1.5, 0.0), (1.5, 1.5, 1.0))
    bases = rng.uniform((-1.5, -1.5, -np.pi), (1.5, 1.5, np.pi), (600, 3))
    distance = box_distances(base, bases, room, clearance)
    sure = (np.abs(distance) > 1e-6).all(1)
    assert sure.mean() > 0.99
    hit = distance < 0
    expected = np.where(hit.any(1), hit.argmax(1), FREE)
    assert 0.1 < hit.any(1).mean() < 0.95
    np.testing.assert_array_equal(
        base_hits(bases, base, room, clearance=clearance)[sure], expected[sure]
    )


def test_parallel_and_crossed_boxes_are_recognized_as_disjoint() -> None:
    """All fifteen axes matter: parallel faces, and crossing edges."""
    cube = Boxes(np.zeros((1, 3)), np.eye(3)[None], np.full((1, 3), 0.5))
    c, s = np.cos(np.pi / 4), np.sin(np.pi / 4)
    on_edge = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])
    turned = np.array([[c, 0, s], [0, 1.0, 0], [-s, 0, c]])
    for rotation, reach in ((np.eye(3), 0.5 + 0.5), (on_edge, 0.5 + 0.5 * np.sqrt(2))):
        for gap, hit in ((1e-4, False), (-1e-4, True)):
            other = Boxes(np.array([[0.0, reach + gap, 0.0]]), rotation[None], np.full((1, 3), 0.5))
            assert bool(base_hits(np.zeros((1, 3)), cube, other, clearance=0.0)[0] == 0) is hit
    # Two beams crossed like an X, edge above edge: only the cross product of edges separates them.
    beam = Boxes(np.zeros((1, 3)), on_edge[None], np.array([[2.0, 0.5, 0.5]]))
    for gap, hit in ((1e-4, False), (-1e-4, True)):
        other = Boxes(
            np.array([[0.0, 0.0, np.sqrt(2) + gap]]), turned[None],
            np.array([[0.5, 2.0, 0.5]]),
        )  # fmt: skip
        assert bool(base_hits(np.zeros((1, 3)), beam, other, clearance=0.0)[0] == 0) is hit


def test_hits_do_not_change_if_base_and_scene_move_together(robot: Robot) -> None:
    rng = np.random.default_rng(1)
    room = random_boxes(8, rng, (-1.2, -1.2, 0.0), (1.2, 1.2, 1.2))
    bases = rng.uniform((-1.5, -1.5, -np.pi), (1.5, 1.5, np.pi), (300, 3))
    turn = np.array([0.7, -1.9, 2.2])
    T = pose_planar(turn)
    moved_room = Boxes(room.center @ T[:3, :3].T + T[:3, 3], T[:3, :3] @ room.rotation, room.half)
    moved = bases.copy()
    moved[:, :2] = bases[:, :2] @ T[:2, :2].T + T[:2, 3]
    moved[:, 2] += turn[2]
    here = base_hits(bases, robot.base, room, clearance=0.02)
    there = base_hits(moved, robot.base, moved_room, clearance=0.02)
    assert (here == there).mean() > 0.995  # rounding may decide a touch
    assert 0 < (here == FREE).sum() < len(here)


def test_a_larger_clearance_never_frees_a_base_pose(husky: Robot) -> None:
    rng, base = np.random.default_rng(2), husky.base
    room = random_boxes(5, rng, (-1.2, -1.2, 0.0), (1.2, 1.2, 1.2))
    bases = rng.uniform((-2, -2, -np.pi), (2, 2, np.pi), (500, 3))
    free = [base_hits(bases, base, room, clearance=c) == FREE for c in (0.0, 0.05, 0.2)]
    assert (free[0] | ~free[1]).all()
    assert (free[1] | ~free[2]).all()
    assert free[0].sum() > free[2].sum()


def test_an_empty_scene_is_free() -> None:
    none = Boxes(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))
    cube = Boxes(np.zeros((1, 3)), np.eye(3)[None], np.full((1, 3), 0.5))
    bases = np.zeros((3, 3))
    assert (base_hits(bases, cube, none, clearance=0.1) == FREE).all()
    assert (base_hits(bases, none, cube, clearance=0.1) == FREE).all()
