"""Test the planner of free motions in a plane with an obstacle."""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np
import pytest

from momapos.model.collision.collision_world import CheckMotion
from momapos.planning.arm_motion.arm_planner import (
    PREFERRED_CLEARANCE,
    RESOLUTION,
    _Budget,
    interpolate,
    plan_motion,
    plan_with_clearance,
)
from momapos.planning.arm_motion.config import PlannerConfig

LOW, HIGH = np.full(2, -3.0), np.full(2, 3.0)
A, B = np.array([-2.0, 0.0]), np.array([2.0, 0.0])


def disc(radius: float, center: tuple[float, float] = (0.0, 0.0)) -> CheckMotion:
    """Return a check of motions that stay out of a disc."""

    def free(a: np.ndarray, b: np.ndarray) -> bool:
        states = interpolate(np.stack([a, b]))
        return bool((np.linalg.norm(states - np.array(center), axis=1) > radius).all())

    return free


def test_a_free_straight_line_is_the_path() -> None:
    path = plan_motion(A, B, LOW, HIGH, disc(0.5, (0.0, 2.0)), config=PlannerConfig(), seed=0)
    np.testing.assert_array_equal(path, [A, B])


@pytest.mark.parametrize("algorithm", ["RRTConnect", "RRTstar"])
def test_a_path_around_the_obstacle_is_free_and_keeps_its_ends(algorithm: str) -> None:
    free = disc(1.0)
    config = PlannerConfig(planner=algorithm, checks=3000)  # type: ignore[arg-type]
    path = plan_motion(A, B, LOW, HIGH, free, config=config, seed=3)
    assert path is not None
    assert len(path) > 2
    np.testing.assert_array_equal(path[[0, -1]], [A, B])
    assert all(free(a, b) for a, b in pairwise(path))
    assert (np.abs(path) <= 3.0 + 1e-9).all()


@pytest.mark.parametrize("algorithm", ["RRTConnect", "RRTstar", "BITstar"])
def test_the_same_seed_gives_the_same_path_at_any_speed(algorithm: str) -> None:
    free, config = disc(1.0), PlannerConfig(planner=algorithm, checks=400)  # type: ignore[arg-type]

    def slowly(a: np.ndarray, b: np.ndarray) -> bool:
        time.sleep(5e-4)
        return free(a, b)

    paths = [plan_motion(A, B, LOW, HIGH, check, config=config, seed=5) for check in (free, slowly)]
    assert paths[0] is not None
    np.testing.assert_array_equal(*paths)


def test_there_is_no_path_from_or_to_a_state_in_collision() -> None:
    for start, goal in ((A, np.zeros(2)), (np.zeros(2), B)):
        assert (
            plan_motion(start, goal, LOW, HIGH, disc(1.0), config=PlannerConfig(), seed=0) is None
        )


@pytest.mark.parametrize("algorithm", ["RRTConnect", "RRTstar", "BITstar"])
def test_the_search_for_a_path_through_a_closed_wall_ends(algorithm: str) -> None:
    checks = []

    def free(a: np.ndarray, b: np.ndarray) -> bool:
        checks.append(not np.array_equal(a, b))
        return bool(a[0] * b[0] > 0 and min(abs(a[0]), abs(b[0])) > 0.1)

    config = PlannerConfig(planner=algorithm, checks=500)  # type: ignore[arg-type]
    assert plan_motion(A, B, LOW, HIGH, free, config=config, seed=0) is None
    assert 500 < sum(checks) < 550  # a turn checks several


def test_a_search_that_checks_nothing_ends() -> None:
    budget = _Budget(20)
    assert sum(1 for _ in iter(budget.spent, True)) == 20 * _Budget.TURNS_PER_CHECK
    assert budget.checks == 20


def test_no_step_of_an_interpolated_path_exceeds_the_resolution() -> None:
    path = np.array([[0.0, 0.0], [1.0, -0.5], [1.0, 0.013]])
    filled = interpolate(path)
    assert np.abs(np.diff(filled, axis=0)).max() <= RESOLUTION + 1e-12
    for corner in path:
        assert np.isclose(filled, corner).all(1).any()


def opening(gap: float) -> CheckMotion:
    """Return a check of motions through an opening of twice the gap in the middle of the plane."""

    def free(a: np.ndarray, b: np.ndarray) -> bool:
        states = interpolate(np.stack([a, b]), 1e-3)
        crossing = np.abs(states[:, 0]) < 0.1
        return bool((np.abs(states[crossing, 1] - 1.0) <= gap).all())

    return free


@pytest.mark.parametrize(("gap", "kept"), [(1.0, True), (0.25, False)])
def test_a_path_keeps_clearance_where_possible(gap: float, *, kept: bool) -> None:
    path = plan_with_clearance(
        A,
        B,
        LOW,
        HIGH,
        lambda extra_clearance: opening(gap - 100 * extra_clearance),
        config=PlannerConfig(),
        seed=1,
    )
    assert path is not None
    assert all(opening(gap)(a, b) for a, b in pairwise(path))
    assert all(opening(gap - 100 * PREFERRED_CLEARANCE)(a, b) for a, b in pairwise(path)) is kept
