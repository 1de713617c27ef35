"""Calibration of a map's threshold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from momapos.model.robots.robot import Robot, load_robot
from momapos.planning.reachability.map_store import (
    MAX_FALSE_POSITIVES,
    MAX_MISSED,
    calibrated,
    evaluate,
    load_reach_map,
)
from momapos.planning.reachability.reach_map import ReachMap


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("husky_ur5e")


@pytest.fixture(scope="module")
def reach(robot: Robot) -> ReachMap:
    return load_reach_map(robot)


def test_a_map_that_rejects_too_much_is_lowered_until_it_misses_little(
    robot: Robot, reach: ReachMap
) -> None:
    strict = replace(reach, threshold=2.0)
    moved = calibrated(strict, robot)
    before, after = (
        evaluate(one, robot, np.random.default_rng(0), 4000, robot.finer.ik, near=True)
        for one in (strict, moved)
    )
    assert before.misses > 4 * MAX_MISSED
    assert after.misses < 1.5 * MAX_MISSED
    # The added false positives are limited relative to the poses that it accepted before.
    assert after.false_positives < before.false_positives + 1.5 * MAX_FALSE_POSITIVES


def test_a_map_that_misses_little_is_unchanged(robot: Robot, reach: ReachMap) -> None:
    lenient = replace(reach, threshold=reach.threshold - 1.0)
    assert calibrated(lenient, robot) is lenient


def test_a_map_with_many_false_positives_is_lowered_only_as_far_as_allowed(
    robot: Robot, reach: ReachMap, caplog: pytest.LogCaptureFixture
) -> None:
    blurred = replace(reach, values=np.roll(reach.values, 2, axis=0), threshold=5.0)
    moved = calibrated(blurred, robot)
    assert blurred.threshold - 8.0 <= moved.threshold < blurred.threshold
    assert "misses" in caplog.text
