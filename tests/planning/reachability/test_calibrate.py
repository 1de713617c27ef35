"""The value from which on lines count as reachable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from momapos.model.robots.robot import Robot, load_robot
from momapos.planning.reachability.calibrate import INVENTED, MISSED, calibrated
from momapos.planning.reachability.evaluation import evaluate
from momapos.planning.reachability.map_store import load_reach_map
from momapos.planning.reachability.reach_map import ReachMap


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("husky_ur5e")


@pytest.fixture(scope="module")
def reach(robot: Robot) -> ReachMap:
    return load_reach_map(robot)


def test_a_map_that_denies_too_much_is_moved_until_it_misses_little(
    robot: Robot, reach: ReachMap
) -> None:
    strict = replace(reach, threshold=2.0)
    moved = calibrated(strict, robot)
    before, after = (
        evaluate(one, robot, np.random.default_rng(0), 4000, robot.finer.ik, near=True)
        for one in (strict, moved)
    )
    assert before.misses > 4 * MISSED
    assert after.misses < 1.5 * MISSED
    # What it invents on top counts in what it took for reachable before.
    assert after.false_positives < before.false_positives + 1.5 * INVENTED


def test_a_map_that_misses_little_stays_as_it_is(robot: Robot, reach: ReachMap) -> None:
    lenient = replace(reach, threshold=reach.threshold - 1.0)
    assert calibrated(lenient, robot) is lenient


def test_a_map_that_would_invent_much_is_moved_as_far_as_it_may_be(
    robot: Robot, reach: ReachMap, caplog: pytest.LogCaptureFixture
) -> None:
    blurred = replace(reach, values=np.roll(reach.values, 2, axis=0), threshold=5.0)
    moved = calibrated(blurred, robot)
    assert blurred.threshold - 8.0 <= moved.threshold < blurred.threshold
    assert "misses" in caplog.text
