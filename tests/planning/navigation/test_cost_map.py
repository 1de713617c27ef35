"""Driving lengths of the cost map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from momapos.core.geometry.transforms import wrap_angle
from momapos.model.robots.robot import Robot
from momapos.model.urdf.hulls import Boxes
from momapos.planning.navigation.cost_map import CELL, FloorPlan, build_cost_map, floor_plan
from momapos.planning.navigation.reachable_floor import TravelLengths


def wall(center: tuple[float, float, float], half: tuple[float, float, float]) -> Boxes:
    return Boxes(np.array([center]), np.eye(3)[None], np.array([half]))


def test_without_obstacles_the_length_is_the_distance() -> None:
    plan = floor_plan(
        wall((5, 5, 0.5), (0.1, 0.1, 0.5)), height=0.5, margin=6.0, floor_polygon=None
    )
    cost = build_cost_map(plan, np.zeros(2), radius=0.3)
    goals = np.random.default_rng(0).uniform(-0.9, 3.0, (200, 2))
    straight = np.linalg.norm(goals, axis=1)
    lengths = cost.lengths(goals)
    # Sixteen directions give lengths at most 2.8 % too long, plus the cells at both ends.
    assert (lengths <= straight * 1.028 + 3 * CELL).all()
    assert (lengths >= straight - 3 * CELL).all()


@pytest.mark.parametrize("start", [(3.3, 0.4), (-0.1, 9.0), (-40.0, 25.0), (5e3, 0.0)])
def test_lengths_from_a_start_outside_the_map_are_right(start: tuple[float, float]) -> None:
    xy, box = np.array(start), wall((0, 0, 0.5), (0.1, 0.1, 0.5))
    plan = floor_plan(box, height=0.5, margin=2.0, floor_polygon=None, start=xy)
    assert plan.blocked.size < 1e6
    goals = np.random.default_rng(0).uniform(-1.5, 1.5, (200, 2))
    goals = goals[np.linalg.norm(goals, axis=1) > 0.6]
    straight = np.linalg.norm(goals - xy, axis=1)
    lengths = build_cost_map(plan, xy, radius=0.3).lengths(goals)
    assert (lengths >= straight - 3 * CELL).all()
    # The path leads around the box, and from far away through the nearest point of the map.
    assert (lengths <= straight * 1.028 + 3 * CELL + (0.5 if straight.max() < 12 else 6.0)).all()


def test_a_wall_makes_the_path_longer_and_a_closed_room_has_none() -> None:
    plan = floor_plan(
        wall((1, 0, 0.5), (0.05, 2.0, 0.5)), height=0.5, margin=2.0, floor_polygon=None
    )
    around = build_cost_map(plan, np.array([0.0, 0.0]), radius=0.3)
    assert around.lengths(np.array([[2.0, 0.0]]))[0] > 4.0
    floor = np.array([[-1.0, -1.9], [3.0, -1.9], [3.0, 1.9], [-1.0, 1.9]])
    closed = floor_plan(
        wall((1, 0, 0.5), (0.05, 2.0, 0.5)), height=0.5, margin=0.5, floor_polygon=floor
    )
    assert np.isinf(
        build_cost_map(closed, np.array([0.0, 0.0]), radius=0.3).lengths(np.array([[2.0, 0.0]]))[0]
    )


def test_a_shelf_above_the_base_is_no_obstacle() -> None:
    shelf = wall((1, 0, 1.5), (0.05, 2.0, 0.2))
    assert not floor_plan(shelf, height=0.5, margin=2.0, floor_polygon=None).blocked.any()
    assert floor_plan(shelf, height=1.4, margin=2.0, floor_polygon=None).blocked.any()


def test_a_rotated_box_blocks_the_cells_under_it() -> None:
    c, s = np.cos(0.6), np.sin(0.6)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    boxes = Boxes(np.array([[0.0, 0.0, 0.5]]), R[None], np.array([[0.8, 0.3, 0.5]]))
    plan = floor_plan(boxes, height=0.5, margin=0.5, floor_polygon=None)
    i, j = np.nonzero(plan.blocked)
    centers = plan.origin + (np.stack([j, i], -1) + 0.5) * CELL
    local = np.abs(centers @ R[:2, :2])
    assert (local <= [0.8 + 1.5 * CELL, 0.3 + 1.5 * CELL]).all()
    assert plan.blocked.sum() * CELL**2 >= 0.8 * 0.3 * 4


def test_a_car_like_base_drives_at_least_the_shortest_curve(fetch: Robot) -> None:
    start = np.array([0.5, -0.5, 0.4])
    plan = FloorPlan(np.array([-3.0, -3.0]), np.zeros((120, 120), bool))
    costs = build_cost_map(plan, start[:2], radius=0.3)
    poses = np.random.default_rng(0).uniform([-2, -2, -3], [2, 2, 3], (200, 3))
    turning = TravelLengths(costs, fetch, start)
    car = TravelLengths(costs, replace(fetch, drive="car", min_turning_radius=0.9), start)
    np.testing.assert_array_equal(turning(poses), costs.lengths(poses[:, :2]))
    np.testing.assert_array_equal(car(poses[:, :2]), costs.lengths(poses[:, :2]))
    turn = np.abs(wrap_angle(poses[:, 2] - start[2]))
    assert (car(poses) >= np.maximum(turning(poses), 0.9 * turn) - 1e-9).all()
    around = np.array([[*start[:2], start[2] + np.pi]])
    assert turning(around)[0] < 0.1
    assert car(around)[0] > 0.9 * np.pi
