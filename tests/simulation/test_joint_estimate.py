"""Estimates of a part's joint from the path of the hand."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.core.geometry.transforms import apply, rotation_of
from momapos.simulation.config import ComplianceConfig
from momapos.simulation.joint_estimate import Axis, JointEstimate

CONFIG = ComplianceConfig()
UP = np.array([0.0, 0.0, 1.0])


def apart(one: Axis, other: Axis) -> tuple[float, float]:
    """Return the angle [rad] and the distance [m] between two axes."""
    off = one.point - other.point
    off = off - (off @ other.direction) * other.direction
    return float(np.arccos(np.clip(one.direction @ other.direction, -1, 1))), float(
        np.linalg.norm(off)
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_hinge_is_found_from_the_arc_of_the_hand(seed: int) -> None:
    rng = np.random.default_rng(seed)
    modeled = Axis(False, UP, np.zeros(3))
    tilt = rotation_of(np.append(rng.uniform(-0.08, 0.08, 2), 0.0))
    true = Axis(False, tilt @ UP, np.append(rng.uniform(-0.03, 0.03, 2), 0.0))
    start = np.array([0.5, 0.0, 0.0])
    estimate = JointEstimate(modeled, start, CONFIG)
    for value in np.linspace(0.0, 1.5, 150):
        estimate.see(apply(true.moved(value), start[None])[0] + rng.normal(0.0, 5e-4, 3))
    angle, distance = apart(estimate.axis, true)
    assert angle < np.radians(1.0)
    assert distance < 0.006


def test_a_slide_is_found_from_the_line_of_the_hand() -> None:
    true = Axis(
        True, rotation_of(np.array([0.0, 0.07, 0.05])) @ np.array([1.0, 0.0, 0.0]), np.zeros(3)
    )
    estimate = JointEstimate(
        Axis(True, np.array([1.0, 0.0, 0.0]), np.zeros(3)), np.zeros(3), CONFIG
    )
    for value in np.linspace(0.0, 0.4, 100):
        estimate.see(value * true.direction)
    assert apart(estimate.axis, true)[0] < 0.005
    assert estimate.tilt == pytest.approx(np.hypot(0.07, 0.05), abs=0.01)


def test_without_motion_of_the_hand_the_joint_stays_as_modeled() -> None:
    modeled = Axis(False, UP, np.array([0.3, 0.1, 0.0]))
    estimate = JointEstimate(modeled, np.array([0.8, 0.1, 0.4]), CONFIG)
    for shake in np.random.default_rng(0).normal(0.0, 3e-4, (50, 3)):
        estimate.see(np.array([0.8, 0.1, 0.4]) + shake)
    assert estimate.axis is modeled
    assert (estimate.tilt, estimate.shift) == (0.0, 0.0)


def test_a_hand_on_the_modeled_path_keeps_the_modeled_joint() -> None:
    modeled = Axis(False, UP, np.zeros(3))
    start = np.array([0.4, 0.0, 0.2])
    estimate = JointEstimate(modeled, start, CONFIG)
    for value in np.linspace(0.0, 1.2, 80):
        estimate.see(apply(modeled.moved(value), start[None])[0])
    assert estimate.tilt < 1e-6
    assert estimate.shift < 1e-6


@pytest.mark.parametrize("drift", [[0.03, 0.0], [0.0, 0.03], [-0.02, 0.02]])
def test_a_drift_of_the_base_is_not_taken_for_another_hinge(drift: list[float]) -> None:
    """The hand seems to leave its arc by 3 % of the way, as much as the wheels may slip."""
    modeled, start = Axis(False, UP, np.zeros(3)), np.array([0.55, 0.0, 0.2])
    wrong = {}
    for known in (False, True):
        estimate = JointEstimate(modeled, start, CONFIG)
        for value in np.linspace(0.0, np.pi / 2, 100):
            way = 0.55 * value
            seen = apply(modeled.moved(value), start[None])[0] + way * np.array([*drift, 0.0])
            estimate.see(seen, 0.03 * way if known else 0.0)
        end = (apply(axis.moved(np.pi / 2), start[None])[0] for axis in (estimate.axis, modeled))
        wrong[known] = np.linalg.norm(np.subtract(*end))
    assert wrong[True] < 0.5 * wrong[False]
    assert wrong[True] < 0.02


def test_points_move_in_the_direction_that_the_axis_gives() -> None:
    rng = np.random.default_rng(1)
    for slides in (False, True):
        direction = rng.normal(size=3)
        axis = Axis(slides, direction / np.linalg.norm(direction), rng.normal(size=3))
        point = rng.normal(size=3)
        step = apply(axis.moved(1e-6), point[None])[0] - point
        np.testing.assert_allclose(step / np.linalg.norm(step), axis.way_at(point), atol=1e-4)
