"""The fallback for an arm without a reachability map."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos.core.geometry.transforms import pose_planar
from momapos.model.robots.robot import Robot
from momapos.planning.reachability import ReachMap
from momapos.planning.reachability.map_store import by_arm_length, load_reach


def test_no_pose_that_the_arm_reaches_scores_zero(fetch: Robot) -> None:
    rng = np.random.default_rng(0)
    scorer, chain = by_arm_length(fetch, "a reason"), fetch.chain
    lower, upper = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    bases = np.column_stack([rng.uniform(-2, 2, (300, 2)), rng.uniform(-3, 3, 300)])
    Ts = pose_planar(bases) @ chain.tool_poses(rng.uniform(lower, upper, (300, chain.size)))
    scores = scorer.min_score(bases, Ts[:, None])
    assert scores.shape == (300, 300)
    assert (np.diag(scores) > 0).all()
    assert (scores == 0).any()
    assert (scores <= 1).all()


def test_the_worst_waypoint_counts(husky: Robot) -> None:
    scorer = by_arm_length(husky, "a reason")
    Ts = np.tile(np.eye(4), (1, 3, 1, 1))
    Ts[0, :, 0, 3], Ts[0, :, 2, 3] = [0.5, 0.9, 0.7], 0.8
    bases = np.array([[0.0, 0.0, 0.0]])
    alone = [scorer.min_score(bases, Ts[:, [k]])[0, 0] for k in range(3)]
    assert scorer.min_score(bases, Ts)[0, 0] == min(alone)


def test_an_arm_without_a_map_is_reported_in_one_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, husky: Robot
) -> None:
    assert isinstance(load_reach(husky, tmp_path), ReachMap)
    chain, segments = husky._parts
    short = replace(husky)
    short.__dict__["_parts"] = (replace(chain, names=chain.names[:5]), segments)
    with caplog.at_level(logging.WARNING):
        found = load_reach(short, tmp_path)
    assert not isinstance(found, ReachMap)
    assert caplog.messages == [found.note]
    assert "husky_ur5e has no reachability map: its arm has 5 degrees" in found.note
