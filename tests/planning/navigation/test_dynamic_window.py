"""The choice of a velocity by the dynamic window."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from tests.planning.navigation.boxes import free_pose, room

from momapos.core.geometry.transforms import place_points
from momapos.model.robots.robot import Robot
from momapos.planning.navigation.driving import integrate
from momapos.planning.navigation.dynamic_window import (
    Steering,
    WindowConfig,
    disc_separation,
    velocity_window,
)
from momapos.planning.navigation.footprint_map import build_navigation_map
from momapos.planning.navigation.global_path import plan_path
from momapos.planning.navigation.judge import FootprintCollisionChecker

DT = 0.06
BOXES = [(0.0, 0.2, 0.9, 0.5, 0.4), (-1.4, 1.2, 0.5, 0.5, 0.0), (1.3, -1.2, 0.4, 0.8, 1.0)]


def samples_along_paths(
    robot: Robot, discs: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Return poses, velocities, and their scores when rated together and one by one."""
    nav_map = build_navigation_map(room(BOXES), robot)
    rng, found = np.random.default_rng(0), []
    while len(found) < 30:
        path = plan_path(nav_map, *(free_pose(nav_map, rng, gap=0.02) for _ in range(2)))
        if path is None:
            continue
        steering = Steering(nav_map, path, WindowConfig(), DT)
        for index in range(0, len(path.poses), 10):
            pose = path.poses[index] + rng.normal(size=3) * 0.01
            now = np.array([rng.uniform(0, robot.max_speed), 0.0, rng.uniform(-0.6, 0.6)])
            window = velocity_window(robot, now, DT)
            together = steering.ratings(pose, window, index, discs)
            alone = [steering.ratings(pose, v[None], index, discs)[0] for v in window]
            found.append((pose, window, together, np.array(alone)))
    return found


@pytest.mark.parametrize("name", ["segway_ur5e", "ranger_rm63"])
def test_the_chosen_velocity_is_the_best_of_all_rated_one_by_one(
    robots: Callable[[str], Robot], name: str
) -> None:
    walker = np.array([[0.5, -0.5, -0.4, 0.2, 0.25]])
    moving = 0
    for discs in (np.zeros((0, 5)), walker):
        for _, _, together, alone in samples_along_paths(robots(name), discs):
            assert together.max() == alone.max()
            seen = np.isfinite(together)
            np.testing.assert_array_equal(together[seen], alone[seen])
            moving += int(seen.any())
    assert moving > 20


def test_after_an_allowed_velocity_the_base_can_brake_without_collision(husky: Robot) -> None:
    nav_map = build_navigation_map(room(BOXES), husky)
    judge = FootprintCollisionChecker(nav_map.prisms, nav_map.obstacles, nav_map.floor_polygon)
    checked = 0
    for pose, window, _, alone in samples_along_paths(husky, np.zeros((0, 5))):
        for v in window[np.isfinite(alone)][::9]:
            braking = max(
                float(np.hypot(v[0], v[1])) / husky.max_acceleration,
                abs(float(v[2])) / husky.max_yaw_acceleration,
            )
            arc = np.linspace(0.0, DT + braking / 2, 20)
            assert not any(judge.distance(np.array([integrate(pose, v, t) for t in arc]))[1])
            checked += 1
    assert checked > 50


@pytest.mark.parametrize("ahead", [0.2, 0.5])
def test_the_base_can_stop_behind_an_obstacle_that_stops_at_once(
    ahead: float, fetch: Robot
) -> None:
    nav_map = build_navigation_map(room([]), fetch)
    judge = FootprintCollisionChecker(nav_map.prisms, nav_map.obstacles, nav_map.floor_polygon)
    path = plan_path(nav_map, np.array([-1.5, 0.0, 0.0]), np.array([1.5, 0.0, 0.0]))
    pose, pace = path.poses[0], 0.6 * fetch.max_speed
    disc = np.array([[pose[0] + 2.0, pose[1], pace, 0.0, 0.3]])
    disc[0, 0] -= judge.disc_distances(pose, disc)[0] - ahead
    speeds = np.linspace(0.0, fetch.max_speed, 40)
    window = np.column_stack([speeds, np.zeros((40, 2))])
    steering = Steering(nav_map, path, WindowConfig(), DT)
    # Rate each alone, because rating them together skips those that cannot be the best.
    alone = [np.isfinite(steering.ratings(pose, v[None], 0, disc)[0]) for v in window]
    allowed = speeds[np.array(alone)]
    assert (allowed * DT + allowed**2 / (2 * fetch.max_acceleration) < ahead).all()
    assert 0 < len(allowed) < len(speeds)


def test_the_separation_from_a_disc_is_that_of_the_nearest_prism(robot: Robot) -> None:
    nav_map = build_navigation_map(room([]), robot)
    judge = FootprintCollisionChecker(nav_map.prisms, nav_map.obstacles, nav_map.floor_polygon)
    rng = np.random.default_rng(0)
    pose = np.array([0.3, -0.2, 0.7])
    points = pose[:2] + rng.uniform(-1.2, 1.2, (400, 2))
    found = np.array([disc_separation(pose, x, y, nav_map.prisms.arrays) for x, y in points])
    expected = np.full(len(points), np.inf)
    for outline in nav_map.prisms.outlines:
        corners = place_points(pose[None], outline)[0]
        along = np.roll(corners, -1, axis=0) - corners
        normal = np.stack([along[:, 1], -along[:, 0]], -1) / np.hypot(*along.T)[:, None]
        beyond = np.einsum("ei,nei->ne", normal, points[:, None] - corners)
        expected = np.minimum(expected, beyond.max(1))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    discs = np.column_stack([points, np.zeros((len(points), 3))])
    distance = judge.disc_distances(pose, discs)
    assert (found <= distance + 1e-9).all()
    assert (distance > 0).sum() > 100
