"""Paths and drives of car-like bases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.planning.navigation.boxes import free_pose, room, wall_with_door

from momapos.model.robots.robot import Robot, load_robot
from momapos.planning.navigation.driving import clip_velocity, drive, integrate
from momapos.planning.navigation.dynamic_window import velocity_window
from momapos.planning.navigation.footprint_map import NavigationMap, build_navigation_map
from momapos.planning.navigation.global_path import BasePath, leads_straight, plan_path
from momapos.planning.navigation.judge import FootprintCollisionChecker, impossible_motion
from momapos.planning.navigation.lattice import lattice_moves, planned_radius
from momapos.verification.path_checks import wheel_checks

BOXES = [(0.0, 0.0, 1.0, 1.0, 0.4), (-2.0, 1.5, 0.6, 1.0, 0.0), (1.8, -1.6, 0.8, 0.4, 0.2)]


@pytest.fixture(scope="module", params=[("fetch", 0.7), ("husky_ur5e", 1.1)], ids=str)
def car(request: pytest.FixtureRequest) -> Robot:
    """Return bases whose footprints are a circle and a rectangle, as if they steered like cars."""
    name, radius = request.param
    return replace(load_robot(name), drive="car", min_turning_radius=radius)


@pytest.fixture(scope="module")
def furnished(car: Robot) -> NavigationMap:
    return build_navigation_map(room(BOXES), car)


def is_drivable(nav_map: NavigationMap, path: BasePath) -> bool:
    """Return whether the path touches nothing and its wheels can follow it, by independent code."""
    robot = nav_map.robot
    checker = FootprintCollisionChecker(nav_map.prisms, nav_map.obstacles, nav_map.floor_polygon)
    checks = wheel_checks(path.poses, robot.drive, robot.min_turning_radius)
    return not any(checker.distance(path.poses)[1]) and all(check.ok for check in checks)


def test_paths_are_curves_that_its_wheels_can_follow(furnished: NavigationMap) -> None:
    rng = np.random.default_rng(3)
    for _ in range(6):
        start, goal = (free_pose(furnished, rng, gap=0.02) for _ in range(2))
        path = plan_path(furnished, start, goal)
        np.testing.assert_allclose(path.poses[0], start, atol=1e-9)
        np.testing.assert_allclose(path.poses[-1], goal, atol=1e-9)
        assert is_drivable(furnished, path)
        assert path.length >= np.hypot(*(goal - start)[:2]) - 1e-9
        np.testing.assert_allclose(path.nodes[[0, -1]], path.poses[[0, -1]], atol=1e-9)
        assert len(path.backwards) == len(path.nodes) - 1


def test_a_base_that_only_turns_drives_away_and_back(furnished: NavigationMap) -> None:
    start = np.array([-1.0, -2.0, 0.3])
    path = plan_path(furnished, start, np.array([-1.0, -2.0, 1.5]))
    assert path.length >= 1.2 * furnished.robot.min_turning_radius
    assert is_drivable(furnished, path)
    step = np.diff(path.poses, axis=0)
    assert np.hypot(step[:, 0], step[:, 1]).min() > 1e-4, "it never turns on the spot"


def test_the_way_out_of_a_niche_is_the_way_in(car: Robot) -> None:
    front, side = (float(car.footprint[:, k].max()) for k in (0, 1))
    niche = [(2.0, s * (side + 0.06), 1.0, 0.1, 0.0) for s in (-1, 1)]
    nav_map = build_navigation_map(room([*niche, (2.55, 0.0, 0.1, 2.0, 0.0)]), car)
    docked, free = np.array([2.5 - front - 0.015, 0.0, 0.0]), np.array([-1.0, 1.0, 2.0])
    for start, goal in ((docked, free), (free, docked)):
        path = plan_path(nav_map, start, goal)
        assert is_drivable(nav_map, path)


def test_a_long_wall_at_its_side_is_left_on_arcs(car: Robot) -> None:
    side = float(car.footprint[:, 1].max())
    wall = build_navigation_map(room([(0.0, -side - 0.07, 4.0, 0.1, 0.0)]), car)
    along, free = np.array([0.0, 0.0, 0.0]), np.array([0.5, 2.0, 1.0])
    for start, goal in ((along, free), (free, along)):
        path = plan_path(wall, start, goal)
        assert is_drivable(wall, path)


def test_where_it_cannot_turn_it_gets_to_fewer_poses_than_one_that_turns_on_the_spot(
    car: Robot,
) -> None:
    # A corridor in which the base can turn around, but by no arc.
    wide = float(np.hypot(*car.footprint.T).max()) * 2 + 0.1
    walls = [(0.0, s * (wide / 2 + 0.05), 5.0, 0.1, 0.0) for s in (-1.0, 1.0)]
    ends = [(s * 2.55, 0.0, 0.1, wide, 0.0) for s in (-1.0, 1.0)]
    turning = replace(car, drive="differential", min_turning_radius=0.0)
    here, around = np.array([-1.2, 0.0, 0.0]), np.array([1.2, 0.0, np.pi])
    assert plan_path(build_navigation_map(room([*walls, *ends]), turning), here, around) is not None
    large = replace(car, min_turning_radius=20.0)
    nav_map = build_navigation_map(room([*walls, *ends]), large)
    assert plan_path(nav_map, here, around) is None
    assert not leads_straight(nav_map, here, around)
    ahead = plan_path(nav_map, here, np.array([1.2, 0.0, 0.0]))
    assert ahead.length == pytest.approx(2.4, abs=1e-3)


def test_there_is_no_path_through_a_door_narrower_than_the_footprint(car: Robot) -> None:
    width = float(min(np.ptp(car.footprint, axis=0)))
    start, goal = np.array([-1.5, 0.3, 0.0]), np.array([1.5, -0.2, 1.0])
    assert (
        plan_path(build_navigation_map(room(wall_with_door(width - 0.02)), car), start, goal)
        is None
    )
    wide = build_navigation_map(room(wall_with_door(width + 0.15)), car)
    path = plan_path(wide, start, goal)
    assert is_drivable(wide, path)


def test_a_bend_of_the_lattice_has_at_least_the_turning_radius(car: Robot) -> None:
    moves = lattice_moves(car)
    turn = np.abs(np.diff(moves.heading - np.arange(32)[:, None], axis=1)).max()
    assert turn in (1, 2, 31, 32)
    bends = moves.heading != np.arange(32)[:, None]
    assert bends.sum() == 4 * 32
    assert moves.length[bends].min() >= 0.12 * planned_radius(car)
    assert (moves.length >= 0.999 * 0.05 * np.hypot(moves.columns, moves.rows)).all()


@pytest.mark.parametrize("seed", range(3))
def test_drives_arrive_and_keep_the_radius_all_the_way(furnished: NavigationMap, seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, goal = (free_pose(furnished, rng, gap=0.05) for _ in range(2))
    record = drive(furnished, start, goal, rng=rng)
    assert record.arrived, record.reason
    robot = furnished.robot
    assert impossible_motion("car", robot.min_turning_radius, record.poses) == ""
    v, w = record.velocities[:, 0], record.velocities[:, 2]
    assert not record.velocities[:, 1].any()
    assert (robot.min_turning_radius * np.abs(w) <= np.abs(v) + 1e-9).all()
    assert np.abs(v).max() <= robot.max_speed + 1e-9


def test_a_car_waits_for_a_person_and_drives_on(furnished: NavigationMap) -> None:
    start, goal = np.array([-2.3, -2.2, 0.0]), np.array([2.2, -2.4, 0.0])

    def person(now: float) -> np.ndarray:
        """Walk across the way until 6 s."""
        y = -2.3 if now < 6.0 else -2.3 + 0.8 * (now - 6.0)
        return np.array([[0.0, y, 0.0, 0.8 if now >= 6.0 else 0.06, 0.2]])

    record = drive(furnished, start, goal, rng=np.random.default_rng(0), moving=person)
    assert record.arrived, record.reason
    assert record.clearance_moving > 0.05


def test_the_window_has_only_velocities_that_the_wheels_allow(car: Robot) -> None:
    rng = np.random.default_rng(2)
    for v in rng.uniform(-car.max_speed, car.max_speed, 20):
        now = np.array([v, 0.0, rng.uniform(-1, 1) * abs(v) / car.min_turning_radius])
        window = velocity_window(car, now, 0.06)
        assert len(window) > 20
        assert not window[:, 1].any()
        assert (car.min_turning_radius * np.abs(window[:, 2]) <= np.abs(window[:, 0]) + 1e-6).all()
        for wish in rng.uniform(-2, 2, (20, 3)):
            reached = clip_velocity(car, now, wish, 0.02)
            assert car.min_turning_radius * abs(reached[2]) <= abs(reached[0]) + 1e-9


def test_the_judge_knows_what_the_wheels_cannot_do() -> None:
    def moved(velocity: tuple[float, float, float]) -> np.ndarray:
        poses = [np.array([0.3, -0.2, 2.9])]
        for _ in range(30):
            poses.append(integrate(poses[-1], np.array(velocity), 0.02))
        return np.array(poses)

    assert impossible_motion("car", 1.0, moved((0.5, 0.0, 0.49))) == ""
    assert impossible_motion("car", 1.0, moved((-0.5, 0.0, 0.49))) == ""
    assert "tighter than its radius of 1.00 m" in impossible_motion(
        "car", 1.0, moved((0.5, 0.0, 0.52))
    )
    assert "tighter" in impossible_motion("car", 1.0, moved((0.0, 0.0, 0.1)))
    for drive_kind in ("car", "differential"):
        assert "sideways" in impossible_motion(drive_kind, 1.0, moved((0.3, 0.02, 0.0)))
    assert impossible_motion("differential", 0.0, moved((0.1, 0.0, 1.0))) == ""
    assert impossible_motion("omni", 0.0, moved((0.1, 0.5, 1.0))) == ""


def test_an_omni_base_keeps_its_speed_in_every_direction(ranger: Robot) -> None:
    assert ranger.drive == "omni"
    rng = np.random.default_rng(4)
    now = np.zeros(3)
    for _ in range(200):
        wish = rng.uniform(-3, 3, 3)
        after = clip_velocity(ranger, now, wish, 0.06)
        change = after - now
        assert np.hypot(*after[:2]) <= ranger.max_speed + 1e-9
        assert np.hypot(*change[:2]) <= 0.06 * ranger.max_acceleration + 1e-9
        assert (
            np.hypot(*velocity_window(ranger, now, 0.06)[:, :2].T).max() <= ranger.max_speed + 1e-9
        )
        now = after
    assert np.hypot(*now[:2]) > 0
