"""Closed-loop drives; an independent checker judges the true poses by outlines alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.planning.navigation.boxes import free_pose, room, square, wall_with_door
from tests.shapes import unchecked

from momapos.core.errors import SceneError
from momapos.core.geometry.transforms import wrap_angle
from momapos.model.robots.robot import Robot, load_robot
from momapos.planning.navigation.driving import (
    TURN_TOLERANCE,
    DriveConfig,
    DriveEnding,
    DriveRecord,
    NoiseConfig,
    drive,
)
from momapos.planning.navigation.footprint_map import NavigationMap, build_navigation_map
from momapos.planning.navigation.global_path import plan_path

START, GOAL = np.array([-1.5, -0.8, 0.5]), np.array([1.4, 0.9, -1.0])


def go(
    nav_map: NavigationMap,
    start: np.ndarray = START,
    goal: np.ndarray = GOAL,
    seed: int = 0,
    **more: object,
) -> DriveRecord:
    return drive(nav_map, start, goal, rng=np.random.default_rng(seed), **more)  # type: ignore[arg-type]


def test_a_base_arrives_within_the_tolerance_and_keeps_its_limits(robot: Robot) -> None:
    config = DriveConfig()
    nav_map = build_navigation_map(room([(0.0, 0.1, 0.5, 0.7, 0.3)]), robot)
    record = go(nav_map, config=config)
    assert record.arrived, record.reason
    assert np.hypot(*(record.pose - record.goal)[:2]) <= config.tolerance
    assert abs(wrap_angle(record.pose[2] - record.goal[2])) <= TURN_TOLERANCE
    assert record.clearance > 0
    v, dt = record.velocities, np.diff(record.times)
    change = np.diff(v, axis=0) / dt[:, None]
    assert np.hypot(v[:, 0], v[:, 1]).max() <= robot.max_speed + 1e-9
    assert np.abs(v[:, 2]).max() <= robot.max_yaw_rate + 1e-9
    assert np.hypot(change[:, 0], change[:, 1]).max() <= robot.max_acceleration + 1e-6
    assert np.abs(change[:, 2]).max() <= robot.max_yaw_acceleration + 1e-6
    if robot.drive == "differential":
        assert (v[:, 1] == 0).all()
    assert record.length == pytest.approx(record.planned, rel=0.1)
    assert record.ending is None


def test_the_same_seed_gives_the_same_drive(fetch: Robot) -> None:
    nav_map = build_navigation_map(room([]), fetch)
    first, again, other = (go(nav_map, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.poses, again.poses)
    assert not np.array_equal(first.pose, other.pose)


def test_without_noise_the_controller_knows_where_it_is(ranger: Robot) -> None:
    config = DriveConfig(noise=NoiseConfig(position=0.0, heading=0.0, odometry=0.0))
    record = go(build_navigation_map(room([]), ranger), config=config)
    assert record.arrived
    np.testing.assert_allclose(record.pose, record.estimated_pose, atol=1e-9)
    assert np.hypot(*(record.pose - record.goal)[:2]) < 0.01


def test_an_impossible_drive_is_refused_with_the_reason(segway: Robot) -> None:
    nav_map = build_navigation_map(room([(1.5, 0.0, 0.5, 0.5, 0.0)]), segway)
    inside, off = np.array([1.5, 0.0, 0.0]), np.array([2.9, 2.0, 0.0])
    assert go(nav_map, goal=inside).reason == "the goal is in collision with box_0/box"
    assert go(nav_map, start=inside).reason == "the start is in collision with box_0/box"
    assert go(nav_map, goal=off).reason == "the goal is in collision with the edge of the floor"
    blocked = build_navigation_map(room(wall_with_door(0.3)), segway)
    refused = go(blocked)
    assert refused.reason == "there is no path for the footprint"
    assert refused.ending is DriveEnding.NO_PATH
    assert not refused.arrived
    assert refused.length == 0.0
    for name in ("start", "goal"):
        message = f"the {name} must be three finite numbers"
        for wrong in (np.array([0.0, np.nan, 0.0]), np.zeros(2)):
            with pytest.raises(SceneError, match=message), unchecked():
                go(nav_map, **{name: wrong})


def test_a_floor_smaller_than_the_base_is_named_as_the_reason(fetch: Robot) -> None:
    nav_map = build_navigation_map(room([], floor=0.1 * square(1.0)), fetch)
    refused = go(nav_map, np.zeros(3), np.array([0.01, 0.0, 0.0]))
    assert refused.reason == "the start is in collision with the edge of the floor"


def test_a_scene_without_a_known_floor_has_no_edges(ranger: Robot) -> None:
    walls = replace(room([(0.0, 0.0, 0.4, 0.4, 0.3)]), floor_polygon=None)
    for scene in (walls, replace(walls, objects=())):
        record = go(build_navigation_map(scene, ranger))
        assert record.arrived, record.reason


@pytest.mark.parametrize("wrong", [np.zeros(5), np.zeros((1, 4)), np.full((1, 5), np.nan)])
def test_moving_obstacles_that_are_not_discs_are_refused(wrong: np.ndarray, fetch: Robot) -> None:
    with pytest.raises(SceneError, match="rows of five finite numbers"):
        go(build_navigation_map(room([]), fetch), moving=lambda _: wrong)


@settings(max_examples=6, suppress_health_check=[HealthCheck.too_slow])
@given(
    seed=st.integers(0, 10_000),
    name=st.sampled_from(["segway_ur5e", "husky_ur5e", "fetch", "ranger_rm63"]),
)
def test_no_drive_through_a_random_scene_touches_anything(seed: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    boxes = [
        (*rng.uniform(-2.5, 2.5, 2), *rng.uniform(0.05, 0.9, 2), rng.uniform(-3, 3))
        for _ in range(7)
    ]
    nav_map = build_navigation_map(room(boxes), load_robot(name))
    start, goal = (free_pose(nav_map, rng, gap=0.03) for _ in range(2))
    record = go(nav_map, start, goal, seed)
    assert not record.hit, record.reason
    assert record.arrived == (plan_path(nav_map, start, goal) is not None), record.reason


def crossing(speed: float, radius: float) -> Callable[[float], np.ndarray]:
    """Return a disc that crosses the path of the robot."""

    def discs(t: float) -> np.ndarray:
        return np.array([[0.0, -2.6 + speed * t, 0.0, speed, radius]])

    return discs


@pytest.mark.parametrize("speed", [0.25, 0.5])
@pytest.mark.parametrize("name", ["fetch", "ranger_rm63"])
def test_the_base_waits_for_or_passes_a_crossing_obstacle_and_never_hits_it(
    robots: Callable[[str], Robot], name: str, speed: float
) -> None:
    nav_map = build_navigation_map(room([]), robots(name))
    start, goal = np.array([-1.8, 0.0, 0.0]), np.array([1.8, 0.0, 0.0])
    record = go(nav_map, start, goal, moving=crossing(speed, 0.3))
    assert record.arrived, record.reason
    assert record.clearance_moving > 0


def test_the_true_pose_is_reported_at_every_control_step(fetch: Robot) -> None:
    seen: list[np.ndarray] = []
    record = go(build_navigation_map(room([]), fetch), on_pose=seen.append)
    np.testing.assert_array_equal(record.poses[3::3], np.array(seen))


def test_an_obstacle_standing_in_the_only_door_is_named_as_the_reason(fetch: Robot) -> None:
    nav_map = build_navigation_map(room(wall_with_door(1.0)), fetch)

    def standing(_: float) -> np.ndarray:
        return np.array([[0.0, 0.0, 0.0, 0.0, 0.3]])

    config = replace(DriveConfig(), patience=1.0, replans=2)
    record = go(nav_map, moving=standing, config=config)
    assert not record.arrived
    assert not record.hit
    assert "moving obstacle" in record.reason
    assert record.reason.startswith(record.ending.value)
