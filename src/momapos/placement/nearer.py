"""Cheaper base poses beside one that works.

Samples of the whole floor are far apart. Where one works others nearer to the start mostly do: a
few are drawn around it, and the cheapest that the map gives room is looked at; then around that.
"""

from __future__ import annotations

import numpy as np

from momapos.geometry.planar import compose
from momapos.geometry.samples import latin_hypercube
from momapos.placement.config import PlaceConfig
from momapos.placement.holding import ScoreWays
from momapos.placement.margin import may_have_room
from momapos.placement.problem import Problem, Search
from momapos.placement.shortlist import Candidate, near_poses, screen

_COUNT = 128
"""Samples of one step [-]."""
_AROUND = np.array([0.3, 0.3, np.radians(30.0)])
"""They lie so far to either side [m], [m], [rad]."""
_GAIN = 0.02
"""Driving length that a step saves at least [m]."""
_MOST = 32
"""Poses whose room is looked up, the cheapest first [-]."""


def nearer(
    problem: Problem,
    score: ScoreWays,
    config: PlaceConfig,
    rng: np.random.Generator,
    found: Search,
    first: Candidate,
) -> list[Candidate]:
    """Go from a base pose with an arm path to cheaper ones, step by step.

    Args:
        problem, score: What is asked, and which ways of holding.
        config: How many steps.
        rng: Source of the samples.
        found: What has been looked at; it is added to.
        first: Where to begin.

    Returns:
        Those with an arm path, the cheapest first.
    """
    steps: list[Candidate] = []
    for _ in range(config.improve):
        step = _step(problem, score, config, rng, found, steps[0] if steps else first)
        if step is None:
            break
        steps.insert(0, step)
    return steps


def _step(
    problem: Problem,
    score: ScoreWays,
    config: PlaceConfig,
    rng: np.random.Generator,
    found: Search,
    best: Candidate,
) -> Candidate | None:
    poses = compose(best.pose, (2.0 * latin_hypercube(rng, _COUNT, 3) - 1.0) * _AROUND)
    limit = best.travel - _GAIN
    near = near_poses(problem, poses[problem.travel_cost(poses[:, :2]) < limit], Search())
    if near is None:
        return None
    left = near.reached(problem, score, on_grid=False)
    order = np.argsort(left.travel, kind="stable")
    order = order[left.travel[order] < limit]
    if problem.goes_home is not None:
        order = order[problem.goes_home(left.poses[order])]
    order = order[:_MOST]
    if config.looks and problem.fit is None:
        order = order[may_have_room(problem, score, config, left.poses[order])]
    # Only the one that is looked at counts as a sample.
    near = near_poses(problem, left.poses[order[:1]], found)
    if near is None:
        return None
    left = near.reached(problem, score, on_grid=False)
    for i, path in screen(problem, left, np.arange(len(left.poses)), config.grasps, found).items():
        return Candidate(left, i, path)
    return None
