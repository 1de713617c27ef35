"""Cheaper base poses beside one that works.

Samples of the whole floor are far apart. Where one works others nearer to the start mostly do: some
are drawn around it, and the cheapest of them that are no worse in room are looked at; then around
that which is found, and at last nearer around.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from momapos.core.geometry import compose, latin_hypercube

from .grasp_scores import ScoreWays
from .margin import may_have_room
from .problem import Problem, Search
from .shortlist import Candidate, near_poses, screen
from .waiting import Waiting

_COUNT = 128
"""Samples of one step [-]."""
_AROUND = np.array([0.3, 0.3, np.radians(30.0)])
"""They lie so far to either side [m], [m], [rad]."""
_GAIN = 0.06
"""Driving length that a step saves at least [m]."""
_MOST = 32
"""Poses whose room is looked up, the cheapest first [-]."""
_LOOKS = 4
"""Poses of a step at which a path is looked for: the cheapest mostly are at the edge of what the
arm reaches [-]."""
_NEAREST = 0.25
"""A step that fails is followed by one from half as far around, down to this share [-]."""


def nearer(
    problem: Problem,
    score: ScoreWays,
    waiting: Waiting,
    rng: np.random.Generator,
    found: Search,
    first: Candidate,
) -> tuple[list[Candidate], list[Candidate]]:
    """Go from a base pose with an arm path to better ones that are nearer, step by step.

    Args:
        problem, score: What is asked, and which ways of holding.
        waiting: What poses cost, what room is beside them, and how many steps are made.
        rng: Source of the samples.
        found: What has been looked at; it is added to.
        first: Where to begin.

    Returns:
        Better poses with an arm path, the best first, and those that are nearer but no better.
    """
    better: list[Candidate] = []
    others: list[Candidate] = []
    around = 1.0
    for _ in range(waiting.costs.config.improve):
        best = better[0] if better else first
        for step in _looked_at(problem, score, waiting, rng, found, best, around):
            if waiting.prefers(step, best):
                better.insert(0, step)
                break
            others.append(step)
        else:
            around /= 2.0
            if around < _NEAREST:
                break
    return better, others


def _looked_at(
    problem: Problem,
    score: ScoreWays,
    waiting: Waiting,
    rng: np.random.Generator,
    found: Search,
    best: Candidate,
    around: float,
) -> Iterator[Candidate]:
    """Poses with a path that cost less before they have one, some way around another [-].

    Each is looked at when it is asked for.
    """
    costs = waiting.costs
    config = costs.config
    poses = compose(best.pose, (2.0 * latin_hypercube(rng, _COUNT, 3) - 1.0) * around * _AROUND)
    limit = best.known - _GAIN * config.weight_driving
    travel = problem.travel_cost(poses[:, :2])
    poses, travel = poses[np.isfinite(travel)], travel[np.isfinite(travel)]
    near = near_poses(problem, poses[costs.before_path(poses, travel) < limit], Search())
    if near is None:
        return
    left = near.reached(problem, score, on_grid=False)
    known = costs.before_path(left.poses, left.travel)
    order = np.argsort(known, kind="stable")
    order = order[known[order] < limit]
    if problem.goes_home is not None:
        order = order[problem.goes_home(left.poses[order])]
    order = order[:_MOST]
    if costs.room_first and waiting.looks:
        least = waiting.known_margin(best.pose) or 0.0
        order = order[may_have_room(problem, score, config, left.poses[order], least)]
    # A pose that is looked at counts as a sample, and no other.
    for i in order[:_LOOKS]:
        near = near_poses(problem, left.poses[i : i + 1], found)
        if near is None:
            return
        one = near.reached(problem, score, on_grid=False)
        passed = screen(problem, one, np.arange(len(one.poses)), config.grasps, found)
        for index, path in passed.items():
            yield Candidate(one, index, path, float(known[i]))
