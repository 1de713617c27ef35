"""Calibration of a map's threshold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from momapos.model.robots.robot import Robot
from momapos.planning.reachability.map_store import (
    MAX_FALSE_POSITIVES,
    MAX_MISSED,
    calibrated,
    evaluate,
    load_reach_map,
)
from momapos.planning.reachability.reach_map import ReachMap


@pytest.fixture(scope="module")
def reach(husky: Robot) -> ReachMap:
    return load_reach_map(husky)


def test_a_map_that_rejects_too_much_is_lowered_until_it_misses_little(
    husky: Robot, reach: ReachMap
) -> None:
    strict = replace(reach, threshold=2.0)
    moved = calibrated(strict, husky)
    before, after = (
        evaluate(one, husky, np.random.default_rng(0), 4000, husky.finer.ik, near=True)
        for one in (strict, moved)
    )
    assert before.misses > 4 * MAX_MISSED
    assert after.misses < 1.5 * MAX_MISSED
    # The added false positives are limited relative to the poses that it accepted before.
    assert after.false_positives < before.false_positives + 1.5 * MAX_FALSE_POSITIVES


def test_a_map_that_misses_little_is_unchanged(husky: Robot, reach: ReachMap) -> None:
    lenient = replace(reach, threshold=reach.threshold - 1.0)
    assert calibrated(lenient, husky) is lenient


def test_a_map_with_many_false_positives_is_lowered_only_as_far_as_allowed(
    husky: Robot, reach: ReachMap, caplog: pytest.LogCaptureFixture
) -> None:
    blurred = replace(reach, values=np.roll(reach.values, 2, axis=0), threshold=5.0)
    moved = calibrated(blurred, husky)
    assert blurred.threshold - 8.0 <= moved.threshold < blurred.threshold
    assert "misses" in caplog.text
