"""Improve a base pose that works: step to cheaper poses nearby that are as robust.

Samples of the whole floor are far apart. The search draws samples around the best pose, checks the
cheapest that can be as robust, and repeats this around the new pose; at the end in a smaller box.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from momapos.core.geometry import compose, latin_hypercube

from .grasp_scores import GraspModeScorer
from .margin import can_be_robust
from .problem import Problem, Search
from .shortlist import Candidate, clear_poses, screen
from .waiting import Waiting

_COUNT = 128
"""Samples of one step [-]."""
_AROUND = np.array([0.3, 0.3, np.radians(30.0)])
"""Half size of the box of samples [m], [m], [rad]."""
_MIN_GAIN = 0.06
"""Minimum driving length that a step saves [m]."""
_MAX_LOOKUPS = 32
"""Maximum number of poses whose possible robustness is looked up, the cheapest first [-]."""
_MAX_CHECKS = 4
"""Maximum number of poses of a step that are checked for a path: the cheapest mostly are at the
edge of the arm's reach [-]."""
_MIN_BOX = 0.25
"""A step that fails halves the box, down to this share [-]."""


def cheaper_poses(
    problem: Problem,
    score: GraspModeScorer,
    waiting: Waiting,
    rng: np.random.Generator,
    found: Search,
    first: Candidate,
) -> tuple[list[Candidate], list[Candidate]]:
    """Step from a base pose with an arm path to better ones.

    Args:
        problem, score: The problem and the scorer of the grasp modes.
        waiting: Costs, robustness and number of steps.
        rng: Source of the samples.
        found: Record of the search, which is extended.
        first: The base pose to improve.

    Returns:
        Better poses with an arm path, the best first, and cheaper poses that are less robust.
    """
    better: list[Candidate] = []
    others: list[Candidate] = []
    around = 1.0
    for _ in range(waiting.costs.config.improve):
        best = better[0] if better else first
        for step in _checked_steps(problem, score, waiting, rng, found, best, around):
            if waiting.prefers(step, best):
                better.insert(0, step)
                break
            others.append(step)
        else:
            around /= 2.0
            if around < _MIN_BOX:
                break
    return better, others


def _checked_steps(
    problem: Problem,
    score: GraspModeScorer,
    waiting: Waiting,
    rng: np.random.Generator,
    found: Search,
    best: Candidate,
    around: float,
) -> Iterator[Candidate]:
    """Yield poses around another that have a path and a lower known cost, checked lazily."""
    costs = waiting.costs
    config = costs.config
    poses = compose(best.pose, (2.0 * latin_hypercube(rng, _COUNT, 3) - 1.0) * around * _AROUND)
    limit = best.known - _MIN_GAIN * config.weight_driving
    travel = problem.travel_cost(poses)
    poses, travel = poses[np.isfinite(travel)], travel[np.isfinite(travel)]
    clear = clear_poses(problem, poses[costs.before_path(poses, travel) < limit], Search())
    if clear is None:
        return
    left = clear.reached(problem, score, on_grid=False)
    known = costs.before_path(left.poses, left.travel)
    order = np.argsort(known, kind="stable")
    order = order[known[order] < limit]
    if problem.home_is_free is not None:
        order = order[problem.home_is_free(left.poses[order])]
    order = order[:_MAX_LOOKUPS]
    if costs.robustness_first and waiting.looks:
        least = waiting.known_robustness(best.pose) or 0.0
        order = order[can_be_robust(problem, score, config, left.poses[order], least)]
    # Only poses that are checked count as samples.
    for i in order[:_MAX_CHECKS]:
        clear = clear_poses(problem, left.poses[i : i + 1], found)
        if clear is None:
            return
        one = clear.reached(problem, score, on_grid=False)
        passed = screen(problem, one, np.arange(len(one.poses)), config.grasps, found)
        for index, path in passed.items():
            yield Candidate(one, index, path, float(known[i]))
