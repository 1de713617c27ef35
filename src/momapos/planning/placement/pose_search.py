"""The search: samples in A, most promising first, checked until nothing cheaper can remain."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import compose, latin_hypercube
from momapos.model.records import PoseOutcome, PoseStatus

from .area import PlacementGeometry, arm_radius, clear_of_sweep, sampling_box, task_frame
from .config import PlaceConfig
from .grasp_scores import ScoreWays
from .nearer import nearer
from .order import by_expected_cost
from .pose_cost import PoseCosts
from .potential import attraction
from .problem import Problem, Search
from .shortlist import Candidate, Shortlist, complete, cull, hopeless, near_poses, screen
from .waiting import Waiting

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_BLOCK = 512
"""Poses of the grid that are screened together [-]."""
_TOGETHER = 16
"""Poses that are screened together where every one that works is asked for [-]."""
_CHUNK = 32
"""Most poses whose reachability is looked up together where they come in a given order [-]."""
_CLOSE = 0.85
"""Odds of a base pose that the moving part passes closely by, of those that it has else [-]."""


def search(problem: Problem, config: PlaceConfig, rng: np.random.Generator) -> Search:
    """Find the cheapest base pose that works.

    Args:
        problem: Room, task, and the checks.
        config: How to search.
        rng: Source of the samples.

    Returns:
        The best pose found, if any, and what became of all others. One that shuts the robot in is a
        spare, see `Search.settle`.
    """
    corners = sampling_box(problem.geometry)
    if corners is None or problem.infeasible_reason:
        return known_no(problem)
    found = Search()
    frame = task_frame(problem.geometry)
    for local, on_grid in _rounds(corners, config, rng):
        near = near_poses(problem, compose(frame, local), found)
        if near is None:
            found.timed_out = True
            return found
        for score in problem.ways:
            reached = near.reached(problem, score, on_grid=on_grid)
            for shortlist in _home_first(problem, reached, config):
                waiting = Waiting.of(
                    problem, score, PoseCosts(problem.geometry, config, problem.takes_hold)
                )
                if on_grid:
                    _check_grid(problem, shortlist, found, waiting)
                else:
                    _check_samples(problem, score, shortlist, rng, found, waiting)
                found.margin = None if found.base is None else waiting.known_margin(found.base)
                if found.motion is not None or found.timed_out:
                    return found
    return found


def _home_first(problem: Problem, left: Shortlist, config: PlaceConfig) -> tuple[Shortlist, ...]:
    """The poses from which the arm can be brought home after the task, then the others."""
    if problem.goes_home is None or config.method != "ours":
        return (left,)
    home = problem.goes_home(left.poses)
    return (left,) if home.all() else (left.only(home), left.only(~home))


def search_in_order(
    problem: Problem, proposals: Iterator[Float[np.ndarray, "n 3"]], config: PlaceConfig
) -> Search:
    """Check base poses one after the other, in the order in which another method proposes them.

    Args:
        problem: Room, task, and the checks.
        proposals: Base poses, some at a time.
        config: How many grasps are tried at each.

    Returns:
        The first pose that works, if any, and what became of those before it.
    """
    if problem.infeasible_reason or sampling_box(problem.geometry) is None:
        return known_no(problem)
    found, size = Search(), 1
    for poses in proposals:
        first = 0
        while first < len(poses):
            _check_in_order(problem, poses[first : first + size], config, found)
            if found.motion is not None or found.timed_out:
                return found
            first, size = first + size, min(2 * size, _CHUNK)
        if problem.out_of_time():
            found.timed_out = True
            return found
    return found


def search_every(
    problem: Problem, config: PlaceConfig, rng: np.random.Generator
) -> Iterator[Search]:
    """Find base poses that work, one after the other, until no samples and no grid are left.

    Every round of samples is in the order of cost, and so is the grid after the last; where room
    comes first it does not count here.

    Args:
        problem: Room, task, and the checks.
        config: How to search.
        rng: Source of the samples.

    Yields:
        A search that found one base pose, its motion and its cost, and what became of the round's
        others so far.
    """
    corners = sampling_box(problem.geometry)
    if corners is None or problem.infeasible_reason:
        return
    problem = replace(problem, leads_on=None)
    frame, costs = (
        task_frame(problem.geometry),
        PoseCosts(problem.geometry, config, problem.takes_hold),
    )
    for local, on_grid in _rounds(corners, config, rng):
        found = Search()
        near = near_poses(problem, compose(frame, local), found)
        if near is None:
            return
        ways = [
            (near.reached(problem, score, on_grid=on_grid), Waiting.of(problem, score, costs))
            for score in problem.ways
        ]
        for one, waiting in _in_order_of_cost(problem, near.clear, ways, costs, found):
            found.base, found.motion, found.margin = None, None, waiting.known_margin(one.pose)
            complete(problem, one.left, {one.index: one.path}, config.grasps, found)
            if found.motion is not None:
                yield found
        if problem.out_of_time():
            return


def _in_order_of_cost(
    problem: Problem,
    clear: Shortlist,
    ways: list[tuple[Shortlist, Waiting]],
    costs: PoseCosts,
    found: Search,
) -> Iterator[tuple[Candidate, Waiting]]:
    """Poses of a round with an arm path, each in the first way of holding that has one.

    A pose waits until none that is left can cost less.
    """
    known = dict(zip(clear.row.tolist(), costs.before_path(clear.poses, clear.travel), strict=True))
    rows = np.array(sorted(known, key=known.__getitem__), int)
    waits: list[tuple[float, int, Candidate, Waiting]] = []
    for first in range(0, len(rows), _TOGETHER):
        block, rest = rows[first : first + _TOGETHER], rows[first + _TOGETHER :]
        for left, waiting in ways:
            which = np.flatnonzero(np.isin(left.row, block))
            some = screen(problem, left, which, costs.config.grasps, found)
            for i, path in some.items():
                row = int(left.row[i])
                cost = waiting.full_cost(left.poses[i], path, float(known[row]))
                one = Candidate(left, i, path, float(known[row]))
                heapq.heappush(waits, (cost, row, one, waiting))
            block = np.setdiff1d(block, left.row[list(some)])
        least = known[int(rest[0])] if len(rest) else np.inf
        while waits and waits[0][0] <= least:
            _, _, one, waiting = heapq.heappop(waits)
            yield one, waiting
        if problem.out_of_time():
            return


def _check_in_order(
    problem: Problem, poses: Float[np.ndarray, "n 3"], config: PlaceConfig, found: Search
) -> None:
    """Check base poses until one works; all ways of holding at one before the next."""
    clear = cull(problem, poses, found)
    ways = [clear.reached(score(problem.reach, clear.poses)) for score in problem.ways]
    for row in clear.row:
        for left in ways:
            which = np.flatnonzero(left.row == row)
            if not len(which):
                continue
            passed = screen(problem, left, which, config.grasps, found)
            complete(problem, left, passed, config.grasps, found)
            if found.motion is not None or found.timed_out:
                return


def known_no(problem: Problem) -> Search:
    """The search of a task that no base pose can help, with the reason."""
    found = Search()
    outcome = PoseOutcome(PoseStatus.OUT_OF_REACH_ANYWHERE, _too_high(problem.geometry))
    if problem.infeasible_reason:
        outcome = PoseOutcome(PoseStatus.TASK_INFEASIBLE, problem.infeasible_reason)
    found.note(np.zeros((1, 3)), np.array([outcome], object))
    return found


def _too_high(geometry: PlacementGeometry) -> str:
    """What is wrong with a task that no arm length can reach, however near the base stands."""
    off = np.isnan(arm_radius(geometry))
    if not off.any():
        return ""
    heights = geometry.Ts_world_tool[0, off, 2, 3]
    worst = heights[np.argmax(np.abs(heights - geometry.shoulder[2]))]
    return f" in height: {worst:.2f} m is too {'high' if worst > geometry.shoulder[2] else 'low'}"


def _rounds(
    corners: Float[np.ndarray, "2 2"], config: PlaceConfig, rng: np.random.Generator
) -> Iterator[tuple[Float[np.ndarray, "n 3"], bool]]:
    """Samples of every round, in the task's frame; the grid last (True), for its "no"."""
    if config.method != "exhaustive":
        for r in range(config.rounds):
            unit = latin_hypercube(rng, config.count * 2**r, 3)
            low, high = np.append(corners[0], -np.pi), np.append(corners[1], np.pi)
            yield low + unit * (high - low), False
        if not config.grid:
            return
    x, y = (
        np.arange(np.floor(lo / config.grid_cell), np.ceil(hi / config.grid_cell) + 1)
        * config.grid_cell
        for lo, hi in corners.T
    )
    yaw = np.radians(np.arange(-180.0, 180.0, config.grid_turn))
    yield np.stack(np.meshgrid(x, y, yaw, indexing="ij"), -1).reshape(-1, 3), True


def _check_samples(
    problem: Problem,
    score: ScoreWays,
    left: Shortlist,
    rng: np.random.Generator,
    found: Search,
    waiting: Waiting,
) -> None:
    """Check a round's samples in order; from the one that is chosen cheaper ones are stepped to."""
    costs, config = waiting.costs, waiting.costs.config
    known = costs.before_path(left.poses, left.travel)
    rest = _order(problem, left, known, config)
    while len(rest) and found.motion is None and not found.timed_out:
        block = rest[known[rest] < waiting.bound][: config.together]
        rest = rest[~np.isin(rest, block)]
        waiting.take(screen(problem, left, block, config.grasps, found), left.poses, known)
        last = not (known[rest] < waiting.bound).any()
        chosen = [
            Candidate(left, i, path, float(known[i]))
            for i, path in waiting.choose(left.poses, last=last).items()
            if not hopeless(problem, left.poses[i], found)
        ]
        if not chosen:
            continue
        better, others = nearer(problem, score, waiting, rng, found, chosen[0])
        # A pose that has less room is better than no answer.
        for one in (*better, *chosen, *others):
            if found.motion is None:
                complete(problem, one.left, {one.index: one.path}, config.grasps, found)


def _check_grid(problem: Problem, left: Shortlist, found: Search, waiting: Waiting) -> None:
    """Complete a pose of the grid, the cheapest where no margin is asked for.

    Poses are checked in blocks, cheapest first; with `whole_grid` all are looked at.
    """
    costs = waiting.costs
    known = costs.before_path(left.poses, left.travel)
    order = np.argsort(known, kind="stable")
    for first in range(0, len(order), _BLOCK):
        block, rest = order[first : first + _BLOCK], order[first + _BLOCK :]
        passed = screen(problem, left, block, None, found)
        if found.motion is None:
            waiting.take(passed, left.poses, known)
            last = costs.room_first or not (known[rest] < waiting.bound).any()
            complete(problem, left, waiting.choose(left.poses, last=last), None, found)
        if found.timed_out or (found.motion is not None and not costs.config.whole_grid):
            return


def _order(
    problem: Problem, left: Shortlist, known: Float[np.ndarray, " n"], config: PlaceConfig
) -> Int[np.ndarray, " n"]:
    """The order of some poses by what they cost before they have a path, and what a miss costs."""
    if not len(left.poses):
        return np.zeros(0, int)
    geometry, xy = problem.geometry, left.poses[:, :2]
    best, field_value = (
        left.scores.max(1),
        attraction(geometry, xy, np.array([geometry.shoulder[2]])),
    )
    # A pose that many grasps reach is worth more than one that a single grasp reaches well.
    assert left.held is not None
    share = np.clip((left.scores > 0).sum(1) / left.held.asked * 4, 0.0, 1.0)
    odds = np.clip(0.4 * best + 0.4 * share + 0.2 * np.sqrt(field_value), 0.0, 1.0)
    odds[~clear_of_sweep(geometry, left.poses, config.sweep_room)] *= _CLOSE
    return by_expected_cost(known, odds, miss=config.miss)
