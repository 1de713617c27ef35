"""Paths from pose to pose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from tests.planning.navigation.boxes import free_pose, room, wall_with_door

from momapos.core.geometry.polygons import inscribed_radius
from momapos.core.geometry.transforms import wrap_angle
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.navigation import global_path
from momapos.planning.navigation.cost_map import CELL, FloorPlan, build_cost_map
from momapos.planning.navigation.footprint_map import (
    HEADINGS,
    MAX_GAP,
    NavigationMap,
    build_navigation_map,
)
from momapos.planning.navigation.global_path import BasePath, direct_path, leads_straight, plan_path
from momapos.planning.navigation.judge import FootprintCollisionChecker
from momapos.planning.navigation.lattice import Lattice, PathModel, astar, lattice_moves, standable
from momapos.planning.navigation.outline_gaps import CostWeights, OutlineArrays
from momapos.planning.navigation.path_ends import MIN_GAP


def finely(path: BasePath) -> np.ndarray:
    """Return poses of a path at most 1.3 cm and 1.5 degrees apart."""
    step = np.diff(path.poses, axis=0)
    step[:, 2] = wrap_angle(step[:, 2])
    share = np.arange(2)[:, None, None] / 2
    return np.concatenate([(path.poses[:-1] + share * step).reshape(-1, 3), path.poses[-1:]])


def touches_nothing(nav_map: NavigationMap, path: BasePath) -> bool:
    return not any(
        FootprintCollisionChecker(
            nav_map.prisms, nav_map.obstacles, nav_map.floor_polygon
        ).distance(finely(path))[1]
    )


def test_the_path_through_an_empty_room_is_the_straight_line(robot: Robot) -> None:
    nav_map = build_navigation_map(room([]), robot)
    start, goal = np.array([-1.5, -1.0, 0.4]), np.array([1.3, 0.7, -2.0])
    path = plan_path(nav_map, start, goal)
    assert path.length == pytest.approx(np.hypot(*(goal - start)[:2]))
    np.testing.assert_allclose(path.poses[[0, -1]], [start, goal], atol=1e-9)


def test_there_is_no_path_through_a_door_narrower_than_the_footprint(robot: Robot) -> None:
    start, goal = np.array([-1.5, 0.3, 0.0]), np.array([1.5, -0.2, 1.0])
    width = float(min(np.ptp(robot.footprint, axis=0)))
    narrow = build_navigation_map(room(wall_with_door(width - 0.02)), robot)
    assert plan_path(narrow, start, goal) is None
    wide = build_navigation_map(room(wall_with_door(width + 0.12)), robot)
    path = plan_path(wide, start, goal)
    assert touches_nothing(wide, path)
    assert all(leads_straight(wide, *path.nodes[k : k + 2]) for k in range(len(path.nodes) - 1))
    assert direct_path(narrow, start, goal) is None
    assert not leads_straight(narrow, start, goal)


def test_a_start_remembers_what_it_never_reaches(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    width = float(min(np.ptp(robot.footprint, axis=0)))
    narrow = build_navigation_map(room(wall_with_door(width - 0.02)), robot)
    start, searches = np.array([-1.5, 0.3, 0.0]), 0

    def counted(*args: object) -> tuple[np.ndarray, np.ndarray]:
        nonlocal searches
        searches += 1
        return astar(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(global_path, "astar", counted)
    for y in (-0.6, -0.2, 0.2, 0.6):
        assert plan_path(narrow, start, np.array([1.5, y, 1.0])) is None
    assert searches <= 2, "one from straight exits, one from shuffled ones"
    assert plan_path(narrow, start, np.array([-1.2, -0.6, 2.5])) is not None


@pytest.mark.parametrize("more", [-0.02, 0.02])
def test_what_a_start_remembers_changes_no_path(robot: Robot, more: float) -> None:
    rng = np.random.default_rng(4)
    scene = room(wall_with_door(float(min(np.ptp(robot.footprint, axis=0))) + more))
    shared = build_navigation_map(scene, robot)
    start = free_pose(shared, rng, gap=0.05)
    found = 0
    for goal in [free_pose(shared, rng, gap=0.01) for _ in range(8)]:
        path, again = (
            plan_path(one, start, goal) for one in (shared, build_navigation_map(scene, robot))
        )
        assert (path is None) == (again is None)
        if path is not None and again is not None:
            np.testing.assert_array_equal(path.nodes, again.nodes)
            found += 1
    assert found > 0


def test_a_path_is_free_of_collision_and_little_longer_than_that_of_a_disc(
    robot: Robot, kitchen: Scene
) -> None:
    nav_map = build_navigation_map(kitchen, robot)
    inner = float(inscribed_radius(robot.footprint))
    rng = np.random.default_rng(3)
    plan = FloorPlan(nav_map.origin, ~(nav_map.gap > -0.02).any(0))
    cells = np.argwhere(nav_map.gap > 0.05)
    checked = 0
    while checked < 2:
        h, i, j = cells[rng.integers(len(cells), size=2)].T
        centers = nav_map.origin + (np.stack([j, i], -1) + 0.5) * CELL
        start, goal = np.column_stack([centers, HEADINGS[h]])
        shortest = build_cost_map(plan, start[:2], radius=0.0).lengths(goal[None, :2])[0]
        path = plan_path(nav_map, start, goal)
        if not 1.5 < shortest < np.inf or path is None:
            continue
        assert touches_nothing(nav_map, path)
        assert path.length <= 1.1 * shortest + inner
        checked += 1


def test_a_search_computes_only_the_gaps_of_visited_states(robot: Robot) -> None:
    nav_map = build_navigation_map(room([(0.0, 0.0, 1.0, 1.0, 0.4)]), robot)
    assert plan_path(nav_map, np.array([-1.8, -1.0, 2.0]), np.array([1.8, 0.6, 0.0])) is not None
    known = np.isfinite(nav_map.known_gaps)
    assert 0 < known.sum() < 0.5 * known.size
    np.testing.assert_array_equal(nav_map.known_gaps[known], nav_map.gap[known])


def test_a_cell_is_standable_where_the_base_fits_with_some_heading(
    robots: Callable[[str], Robot], kitchen: Scene
) -> None:
    for name in ("fetch", "segway_ur5e"):
        nav_map = build_navigation_map(kitchen, robots(name))
        moves = lattice_moves(nav_map.robot)
        lattice = Lattice(nav_map.origin, CELL, HEADINGS, moves, MAX_GAP)
        surroundings = OutlineArrays(nav_map.prisms.arrays, nav_map.planning_obstacles.arrays)
        model = PathModel(False, 0.0, surroundings, CostWeights(MIN_GAP, 0.08, 1.0, 0.1, 1.3, 0.2))
        found = standable(nav_map.inside, lattice, model)
        assert 0.05 < found.mean() < 0.95
        np.testing.assert_array_equal(found, (nav_map.gap >= MIN_GAP).any(0))


def test_a_differential_base_drives_along_its_heading_and_turns_on_the_spot(segway: Robot) -> None:
    nav_map = build_navigation_map(room([(0.0, 0.0, 1.0, 1.0, 0.4)]), segway)
    path = plan_path(nav_map, np.array([-1.8, -1.0, 2.0]), np.array([1.8, 0.6, 0.0]))
    step = np.diff(path.poses, axis=0)
    turn = np.abs(wrap_angle(step[:, 2]))
    side = step[:, 1] * np.cos(path.poses[:-1, 2]) - step[:, 0] * np.sin(path.poses[:-1, 2])
    assert np.abs(side).max() < 1e-9
    assert (np.minimum(np.hypot(step[:, 0], step[:, 1]), turn) < 1e-9).all()


def test_an_omni_base_needs_no_turning(ranger: Robot) -> None:
    nav_map = build_navigation_map(room([(0.0, 0.0, 1.0, 0.4, 0.0)]), ranger)
    start, goal = np.array([-1.8, -0.3, 0.1]), np.array([1.8, 0.6, 0.1])
    path = plan_path(nav_map, start, goal)
    assert np.abs(wrap_angle(path.poses[:, 2] - 0.1)).max() < 0.3
    empty = build_navigation_map(room([]), ranger)
    straight = plan_path(empty, start, goal)
    assert np.abs(wrap_angle(straight.poses[:, 2] - 0.1)).max() < 1e-9


def test_a_base_close_to_furniture_can_back_out_and_drive_in(husky: Robot) -> None:
    front = float(husky.footprint[:, 0].max())
    side = float(husky.footprint[:, 1].max())
    # A niche slightly wider than the base, in front of a wall.
    niche = [(2.0, s * (side + 0.07), 1.0, 0.1, 0.0) for s in (-1, 1)]
    nav_map = build_navigation_map(room([*niche, (2.55, 0.0, 0.1, 2.0, 0.0)]), husky)
    docked = np.array([2.5 - front - 0.015, 0.0, 0.0])
    path = plan_path(nav_map, docked, np.array([-1.0, 1.0, 0.0]))
    back = plan_path(nav_map, np.array([-1.0, 1.0, 0.0]), docked)
    assert touches_nothing(nav_map, path)
    assert touches_nothing(nav_map, back)


@pytest.mark.parametrize("name", ["husky_ur5e", "segway_ur5e"])
def test_a_base_along_a_long_wall_shuffles_away_from_it_and_back(
    robots: Callable[[str], Robot], name: str
) -> None:
    robot = robots(name)
    side = float(robot.footprint[:, 1].max())
    wall = 0.3
    nav_map = build_navigation_map(room([(0.0, 2.5, 6.0, wall, 0.0)]), robot)
    # Too close to the wall to turn at once to any heading of the lattice.
    close = np.array([0.2, 2.5 - wall / 2 - side - 0.03, 0.02])
    away = np.array([-1.2, -1.0, 2.0])
    assert (
        FootprintCollisionChecker(
            nav_map.prisms, nav_map.obstacles, nav_map.floor_polygon
        ).distance(close[None])[0][0]
        > 0.01
    )
    for start, goal in ((close, away), (away, close)):
        path = plan_path(nav_map, start, goal)
        assert touches_nothing(nav_map, path)
        np.testing.assert_allclose(path.poses[[0, -1]], [start, goal], atol=1e-9)


def test_a_room_slightly_larger_than_the_base_allows_driving_but_not_turning(husky: Robot) -> None:
    length, width = np.ptp(husky.footprint, axis=0) + np.array([0.3, 0.1])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    middle = (husky.footprint.max(0) + husky.footprint.min(0)) / 2
    floor = middle + corners * [length / 2, width / 2]
    nav_map = build_navigation_map(room([], floor=floor), husky)
    path = plan_path(nav_map, np.array([-0.1, 0.0, 0.0]), np.array([0.1, 0.0, 0.0]))
    assert path.length == pytest.approx(0.2)
    assert plan_path(nav_map, np.zeros(3), np.array([0.0, 0.0, np.pi])) is None


def test_a_path_keeps_its_distance_from_an_obstacle_where_possible(fetch: Robot) -> None:
    nav_map = build_navigation_map(room([(0.0, -0.4, 1.0, 0.8, 0.0)]), fetch)
    path = plan_path(nav_map, np.array([-1.5, -0.3, 0.0]), np.array([1.5, -0.3, 0.0]))
    assert path.gap.min() > 0.02


def test_no_path_through_a_random_scene_touches_anything(ranger: Robot) -> None:
    rng = np.random.default_rng(0)
    boxes = [(*rng.uniform(-2, 2, 2), *rng.uniform(0.1, 0.8, 2), 1.0) for _ in range(6)]
    nav_map = build_navigation_map(room(boxes), ranger)
    for _ in range(4):
        ends = [free_pose(nav_map, rng, gap=0.03) for _ in range(2)]
        path = plan_path(nav_map, *ends)
        assert path is None or touches_nothing(nav_map, path)
