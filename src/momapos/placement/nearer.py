"""Cheaper base poses beside one that works.

Samples of the whole floor are far apart. Where one works others nearer to the start mostly do: a
few are drawn around it, and the cheapest that the map gives room is looked at; then around that.
"""

from __future__ import annotations

import numpy as np

from momapos.geometry.planar import compose
from momapos.geometry.samples import latin_hypercube
from momapos.placement.cost import PoseCosts
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
_STEPS = 8
"""So many times the steps are made there [-]."""
_NEAREST = 0.1
"""There a step that fails is followed by one from half as far around, down to this share [-]."""
_LOOKS = 8
"""Poses at which a path is looked for where room does not come first, so that the cheapest mostly
are at the edge of what the arm reaches [-]."""


def nearer(
    problem: Problem,
    score: ScoreWays,
    costs: PoseCosts,
    rng: np.random.Generator,
    found: Search,
    first: Candidate,
) -> list[Candidate]:
    """Go from a base pose with an arm path to cheaper ones, step by step.

    Args:
        problem, score: What is asked, and which ways of holding.
        costs: What poses cost, and how many steps are made.
        rng: Source of the samples.
        found: What has been looked at; it is added to.
        first: Where to begin.

    Returns:
        Those with an arm path, the cheapest first.
    """
    steps: list[Candidate] = []
    improve, nearest = costs.config.improve, 1.0 if costs.room_first else _NEAREST
    most = improve if costs.room_first else _STEPS * improve
    around = 1.0
    for _ in range(most):
        best = steps[0] if steps else first
        step = _step(problem, score, costs, rng, found, best, around)
        if step is not None:
            steps.insert(0, step)
            continue
        around /= 2.0
        if around < nearest:
            break
    return steps


def _step(
    problem: Problem,
    score: ScoreWays,
    costs: PoseCosts,
    rng: np.random.Generator,
    found: Search,
    best: Candidate,
    around: float,
) -> Candidate | None:
    """The cheapest pose with a path that is looked at, some way around another [-]."""
    config = costs.config
    poses = compose(best.pose, (2.0 * latin_hypercube(rng, _COUNT, 3) - 1.0) * around * _AROUND)
    limit = best.known - _GAIN * config.weight_driving
    travel = problem.travel_cost(poses[:, :2])
    poses, travel = poses[np.isfinite(travel)], travel[np.isfinite(travel)]
    near = near_poses(problem, poses[costs.before_path(poses, travel) < limit], Search())
    if near is None:
        return None
    left = near.reached(problem, score, on_grid=False)
    known = costs.before_path(left.poses, left.travel)
    order = np.argsort(known, kind="stable")
    order = order[known[order] < limit]
    if problem.goes_home is not None:
        order = order[problem.goes_home(left.poses[order])]
    order = order[:_MOST]
    if costs.room_first and config.looks and problem.fit is None:
        order = order[may_have_room(problem, score, config, left.poses[order])]
    # A pose that is looked at counts as a sample, and no other.
    for i in order[: 1 if costs.room_first else _LOOKS]:
        near = near_poses(problem, left.poses[i : i + 1], found)
        if near is None:
            return None
        one = near.reached(problem, score, on_grid=False)
        passed = screen(problem, one, np.arange(len(one.poses)), config.grasps, found)
        for index, path in passed.items():
            return Candidate(one, index, path, float(known[i]))
    return None
