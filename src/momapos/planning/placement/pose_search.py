"""Search base poses: sample the free area A and check poses by expected cost.

Samples of the whole floor are far apart. To improve a pose that works, the search draws samples
around the best pose, checks the cheapest that can be as robust, and repeats this around the new
pose; at the end in a smaller box.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, islice
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import look
from momapos.core.geometry import compose, latin_hypercube
from momapos.model.records import ArmPathResult, PoseOutcome, PoseStatus

from .area import (
    PlacementGeometry,
    arm_radius,
    clears_sweep,
    grid_standing,
    sampling_box,
    task_frame,
)
from .config import PlaceConfig
from .grasp_scores import GraspModeScorer, attraction
from .pose_cost import PoseCosts, Robustness, can_be_robust, robustness_of
from .problem import PoseOutcomes, Problem, Search
from .shortlist import (
    Candidate,
    ClearPoses,
    Shortlist,
    can_approach,
    clear_poses,
    complete,
    cull,
    is_dominated,
    screen,
)

if TYPE_CHECKING:
    from jaxtyping import Float, Int


@dataclass
class Waiting:
    """Base poses of one round with an arm path, by index.

    If robustness is compared first, the best is the most robust of some; otherwise it is the
    cheapest, chosen as soon as no remaining pose may cost less.
    """

    costs: PoseCosts
    robustness: Robustness
    looks: float
    """Maximum number of poses whose robustness is measured; 0: it does not count [-]."""
    paths: dict[int, ArmPathResult] = field(default_factory=dict)
    cost: dict[int, float] = field(default_factory=dict)
    """Cost of each pose with a path."""
    measured: dict[bytes, tuple[float, bool]] = field(default_factory=dict)
    """Robustness by base pose, and whether it is not only an upper bound."""
    looked: int = 0
    """Number of poses whose robustness was measured to choose [-]."""
    bound: float = math.inf
    """A pose of this known cost cannot be better than the best that waits."""

    @classmethod
    def of(cls, problem: Problem, score: GraspModeScorer, costs: PoseCosts) -> Waiting:
        """Start with no poses, as the costs are configured."""
        config = costs.config
        if problem.fit is not None or (config.method == "ours" and not config.polish):
            looks = 0.0  # an arm of few joints has no path next to a fitted pose
        elif costs.robustness_first:
            looks = float(config.compared) if config.method == "ours" else 0.0
        else:
            looks = math.inf if config.weight_robustness > 0.0 else 0.0
        return cls(costs, robustness_of(problem, score, config), looks)

    def take(
        self,
        passed: dict[int, ArmPathResult],
        poses: Float[np.ndarray, "n 3"],
        known: Float[np.ndarray, " n"],
    ) -> None:
        """Add the poses with a path; `poses` and `known` costs cover the whole round."""
        for i, path in passed.items():
            self.paths[i] = path
            self.cost[i] = self.full_cost(poses[i], path, float(known[i]))
            if not self.costs.robustness_first:
                self.bound = min(self.bound, self.cost[i])

    def full_cost(self, pose: Float[np.ndarray, "3"], path: ArmPathResult, known: float) -> float:
        """Return a pose's cost with its path, and with its robustness unless another is better."""
        assert path.q is not None
        cost = known + self.costs.of_path(path.q)
        if self.costs.robustness_first or not self.looks or cost >= self.bound:
            return cost
        return cost + self.costs.of_robustness(self.robustness_at(pose, path))

    def choose(self, poses: Float[np.ndarray, "n 3"], *, last: bool) -> dict[int, ArmPathResult]:
        """Return all waiting poses, best first, as soon as the best is known; nothing before.

        Args:
            poses: All base poses of the round.
            last: Whether no more poses follow.
        """
        by_cost = sorted(self.paths, key=lambda i: self.cost[i])
        if self.costs.robustness_first:
            best = 0.0
            for i in by_cost:
                if best == 1.0 or self.looked >= self.looks:
                    break
                self.looked += poses[i].tobytes() not in self.measured
                # A cheaper pose wins a tie.
                more = float(np.nextafter(best, 1.0))
                best = max(best, self.robustness_at(poses[i], self.paths[i], more))
            if not (best == 1.0 or last or self.looked >= self.looks):
                return {}
            by_cost.sort(key=lambda i: -self.robustness_bound(poses[i]))
        elif not last:
            return {}
        paths, self.paths, self.bound = self.paths, {}, math.inf
        return {i: paths[i] for i in by_cost}

    def prefers(self, step: Candidate, to: Candidate) -> bool:
        """Check that a step of lower known cost improves: it costs less, or is as robust."""
        if not self.costs.robustness_first:
            cost, before = (self.full_cost(one.pose, one.path, one.known) for one in (step, to))
            return cost < before
        least = self.robustness_bound(to.pose)
        return not self.looks or self.robustness_at(step.pose, step.path, least) >= least

    def robustness_bound(self, pose: Float[np.ndarray, "3"]) -> float:
        """Return an upper bound of a base pose's robustness; 0 if it was not measured."""
        return self.measured.get(pose.tobytes(), (0.0, False))[0]

    def known_robustness(self, pose: Float[np.ndarray, "3"]) -> float | None:
        """Return the robustness of a base pose if it was measured."""
        value, is_exact = self.measured.get(pose.tobytes(), (0.0, False))
        return value if is_exact else None

    def robustness_at(
        self, pose: Float[np.ndarray, "3"], path: ArmPathResult, least: float = 0.0
    ) -> float:
        """Measure the robustness of a base pose, once; an upper bound is enough below `least`."""
        key = pose.tobytes()
        value, is_exact = self.measured.get(key, (1.0, False))
        if not is_exact and value >= least:
            value = self.robustness(pose, path, least)
            self.measured[key] = value, value >= least
        return value


_COUNT = 128
"""Samples of one step [-]."""
_AROUND = np.array([0.3, 0.3, np.radians(30.0)])
"""Half size of the box of samples [m], [m], [rad]."""
_MIN_GAIN = 0.06
"""Minimum driving length that a step saves [m]."""
_MAX_LOOKUPS = 32
"""Maximum number of poses whose possible robustness is looked up, the cheapest first [-]."""
_LOOKED_UP = 8
"""Number of them that are looked up together, twice as many as are checked [-]."""
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
    for _ in range(waiting.costs.config.polish):
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
    clear = clear_poses(problem, poses[costs.before_path(poses, travel) < limit])
    left = clear.reached(problem, score, on_grid=False)
    known = costs.before_path(left.poses, left.travel)
    order = np.argsort(known, kind="stable")
    order = order[known[order] < limit]
    if problem.home_is_free is not None:
        order = order[problem.home_is_free(left.poses[order])]
    order = order[:_MAX_LOOKUPS]
    chosen = iter(order.tolist())
    if costs.robustness_first and waiting.looks:
        least = waiting.robustness_bound(best.pose)
        blocks = np.split(order, range(_LOOKED_UP, len(order), _LOOKED_UP))
        chosen = (
            int(i)
            for block in blocks
            for i in block[can_be_robust(problem, score, config, left.poses[block], least)]
        )
    # Only poses that are checked count as samples.
    for i in islice(chosen, _MAX_CHECKS):
        clear = clear_poses(problem, left.poses[i : i + 1])
        found.note(clear.every, clear.poses.outcomes)
        one = clear.reached(problem, score, on_grid=False)
        passed = screen(problem, one, np.arange(len(one.poses)), config.grasps, found)
        for index, path in passed.items():
            yield Candidate(one, index, path, float(known[i]))


def by_expected_cost(
    known: Float[np.ndarray, " n"], odds: Float[np.ndarray, " n"], *, miss: float
) -> Int[np.ndarray, " m"]:
    """Return the order by known cost plus expected cost of a miss, cheapest first.

    Args:
        known: Cost of each pose before it has a path; poses of infinite cost are left out.
        odds: Estimated probability that it works, in [0, 1].
        miss: Cost of a certain miss, in meters of driving of weight 1 [m].
    """
    key = known + miss * (1.0 - odds)
    order = np.argsort(key, kind="stable")
    return order[np.isfinite(key[order])]


_BLOCK = 512
"""Grid poses screened together [-]."""
_TOGETHER = 16
"""Poses screened together when all poses that work are wanted [-]."""
_MAX_CHUNK = 32
"""Maximum number of poses looked up together when their order is given [-]."""
_CLOSE_PASS_ODDS = 0.85
"""Factor on the odds of a base pose that the moving part passes closely [-]."""


def search(problem: Problem, config: PlaceConfig, rng: np.random.Generator) -> Search:
    """Find the cheapest base pose that works.

    Args:
        problem: Scene, task and checks.
        config: How to search.
        rng: Source of the samples.

    Returns:
        The best pose, if any, and the outcomes of all. A pose that blocks the robot in is only a
        fallback, see `Search.accept_fallback`.
    """
    corners = sampling_box(problem.geometry)
    if corners is None or problem.infeasible_reason:
        return infeasible_search(problem)
    found = Search()
    with found.in_time():
        _search(problem, config, rng, corners, found)
    return found


def _search(
    problem: Problem,
    config: PlaceConfig,
    rng: np.random.Generator,
    corners: Float[np.ndarray, "2 2"],
    found: Search,
) -> None:
    """Check rounds of samples, then the grid; a round that reaches nothing is the last one if the
    grid reaches nothing either.
    """
    frame = task_frame(problem.geometry)
    grid = _Grid(problem, config, frame, corners) if _has_grid(config) else None
    for local in _samples(corners, config, rng):
        look()
        clear = clear_poses(problem, compose(frame, local))
        found.note(clear.every, clear.poses.outcomes)
        reached = 0
        for score in problem.mode_scorers:
            left = clear.reached(problem, score, on_grid=False)
            reached += len(left.poses)
            for shortlist in _home_first(problem, left, config):
                waiting = Waiting.of(problem, score, PoseCosts.of(problem, config))
                _check_samples(problem, score, shortlist, rng, found, waiting)
                if _is_done(found, waiting):
                    return
        if not reached and grid is not None and not grid.reaches:
            break
    if grid is None:
        return
    look()
    found.note(grid.clear.every, grid.clear.poses.outcomes)
    for score, left in zip(problem.mode_scorers, grid.reached(), strict=True):
        for shortlist in _home_first(problem, left, config):
            waiting = Waiting.of(problem, score, PoseCosts.of(problem, config))
            _check_grid(problem, shortlist, found, waiting)
            if _is_done(found, waiting):
                return


def is_within_reach(problem: Problem, config: PlaceConfig) -> bool:
    """Return whether any clear base pose of the grid reaches any grasp mode."""
    corners = sampling_box(problem.geometry)
    if corners is None or problem.infeasible_reason:
        return False
    return _Grid(problem, config, task_frame(problem.geometry), corners).reaches


def _is_done(found: Search, waiting: Waiting) -> bool:
    """Return whether a base pose was found, and note how robust it is."""
    found.robustness = None if found.base is None else waiting.known_robustness(found.base)
    return found.motion is not None


@dataclass
class _Grid:
    """The grid of a problem: which of its poses are clear, and what they reach, each once."""

    problem: Problem
    config: PlaceConfig
    frame: Float[np.ndarray, "3"]
    corners: Float[np.ndarray, "2 2"]
    _reached: list[Shortlist] = field(default_factory=list)
    """For the first scorers."""

    @cached_property
    def clear(self) -> ClearPoses:
        """Return the clear poses."""
        config, local = self.config, grid_poses(self.corners, self.config)
        poses = compose(self.frame, local)
        geometry = self.problem.geometry
        stands = grid_standing(geometry, poses, local, config.grid_cell, config.grid_turn)
        return clear_poses(self.problem, poses, stands)

    def reached(self) -> Iterator[Shortlist]:
        """Yield the poses from which some grasp mode of each scorer is within reach."""
        for k, score in enumerate(self.problem.mode_scorers):
            if k == len(self._reached):
                self._reached.append(self.clear.reached(self.problem, score, on_grid=True))
            yield self._reached[k]

    @property
    def reaches(self) -> bool:
        """Return whether any grasp mode is within reach of any pose."""
        return any(len(left.poses) for left in self.reached())


def _home_first(problem: Problem, left: Shortlist, config: PlaceConfig) -> tuple[Shortlist, ...]:
    """Return the poses from which the arm can return home after the task, then the others."""
    if problem.home_is_free is None or config.method != "ours":
        return (left,)
    home = problem.home_is_free(left.poses)
    return (left,) if home.all() else (left.only(home), left.only(~home))


def search_in_order(
    problem: Problem, proposals: Iterator[Float[np.ndarray, "n 3"]], config: PlaceConfig
) -> Search:
    """Check base poses in a given order.

    Args:
        problem: Scene, task and checks.
        proposals: Batches of base poses.
        config: Limits the grasps tried at each.

    Returns:
        The first pose that works, if any, and the outcomes of those before it.
    """
    if problem.infeasible_reason or sampling_box(problem.geometry) is None:
        return infeasible_search(problem)
    found, size = Search(), 1
    with found.in_time():
        for poses in proposals:
            first = 0
            while first < len(poses):
                _check_in_order(problem, poses[first : first + size], config, found)
                if found.motion is not None:
                    return found
                first, size = first + size, min(2 * size, _MAX_CHUNK)
            look()
    return found


def iter_searches(
    problem: Problem, config: PlaceConfig, rng: np.random.Generator
) -> Iterator[Search]:
    """Yield all base poses that work, in order of cost within each round and within the grid.

    Robustness does not count here where it is compared first.

    Args:
        problem: Scene, task and checks.
        config: How to search.
        rng: Source of the samples.

    Yields:
        A search with one base pose, its motion and its cost, and the outcomes of the round so far.
    """
    corners = sampling_box(problem.geometry)
    if corners is None or problem.infeasible_reason:
        return
    problem = replace(problem, departure=None)
    frame = task_frame(problem.geometry)
    costs = PoseCosts.of(problem, config)
    grid = _Grid(problem, config, frame, corners)
    for local in chain(_samples(corners, config, rng), [None] if _has_grid(config) else []):
        look()
        found, on_grid = Search(), local is None
        clear = grid.clear if local is None else clear_poses(problem, compose(frame, local))
        found.note(clear.every, clear.poses.outcomes)
        modes = [
            (clear.reached(problem, score, on_grid=on_grid), Waiting.of(problem, score, costs))
            for score in problem.mode_scorers
        ]
        for one, waiting in _in_order_of_cost(problem, clear.poses, modes, costs, found):
            found.base, found.motion = None, None
            found.robustness = waiting.known_robustness(one.pose)
            complete(problem, one.left, {one.index: one.path}, config.grasps, found)
            if found.motion is not None:
                yield found


def _in_order_of_cost(
    problem: Problem,
    clear: Shortlist,
    modes: list[tuple[Shortlist, Waiting]],
    costs: PoseCosts,
    found: Search,
) -> Iterator[tuple[Candidate, Waiting]]:
    """Yield poses with an arm path, each in its first grasp mode that has one.

    A pose waits until no remaining one can cost less.
    """
    known = dict(zip(clear.row.tolist(), costs.before_path(clear.poses, clear.travel), strict=True))
    rows = np.array(sorted(known, key=known.__getitem__), int)
    waits: list[tuple[float, int, Candidate, Waiting]] = []
    for first in range(0, len(rows), _TOGETHER):
        block, rest = rows[first : first + _TOGETHER], rows[first + _TOGETHER :]
        for left, waiting in modes:
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
        look()


def _check_in_order(
    problem: Problem, poses: Float[np.ndarray, "n 3"], config: PlaceConfig, found: Search
) -> None:
    """Check base poses until one works; all grasp modes at one before the next."""
    clear = cull(problem, poses)
    found.note(poses, clear.outcomes)
    modes = [
        clear.reached(score(problem.reach, clear.poses), problem.path_rules)
        for score in problem.mode_scorers
    ]
    for row in clear.row:
        for left in modes:
            which = np.flatnonzero(left.row == row)
            if not len(which):
                continue
            passed = screen(problem, left, which, config.grasps, found)
            complete(problem, left, passed, config.grasps, found)
            if found.motion is not None:
                return


def infeasible_search(problem: Problem) -> Search:
    """Return the result for a task that no base pose can solve, with the reason."""
    found = Search()
    outcome = PoseOutcome(PoseStatus.OUT_OF_REACH_ANYWHERE, _too_high(problem.geometry))
    if problem.infeasible_reason:
        outcome = PoseOutcome(PoseStatus.TASK_INFEASIBLE, problem.infeasible_reason)
    found.note(np.zeros((1, 3)), PoseOutcomes([outcome]))
    return found


def _too_high(geometry: PlacementGeometry) -> str:
    """Say which waypoint is too high or too low for any base pose."""
    off = np.isnan(arm_radius(geometry))
    if not off.any():
        return ""
    heights = geometry.Ts_world_tool[0, off, 2, 3]
    worst = heights[np.argmax(np.abs(heights - geometry.shoulder[2]))]
    return f" in height: {worst:.2f} m is too {'high' if worst > geometry.shoulder[2] else 'low'}"


def _has_grid(config: PlaceConfig) -> bool:
    """Return whether the search ends with a grid."""
    return config.grid or config.method == "exhaustive"


def _samples(
    corners: Float[np.ndarray, "2 2"], config: PlaceConfig, rng: np.random.Generator
) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Yield the samples of each round, in the task frame."""
    for r in range(config.rounds if config.method != "exhaustive" else 0):
        unit = latin_hypercube(rng, config.count * 2**r, 3)
        low, high = np.append(corners[0], -np.pi), np.append(corners[1], np.pi)
        yield low + unit * (high - low)


def grid_poses(corners: Float[np.ndarray, "2 2"], config: PlaceConfig) -> Float[np.ndarray, "n 3"]:
    """Return the poses of the grid, in the task frame."""
    x, y = (
        np.arange(np.floor(lo / config.grid_cell), np.ceil(hi / config.grid_cell) + 1)
        * config.grid_cell
        for lo, hi in corners.T
    )
    yaw = np.radians(np.arange(-180.0, 180.0, config.grid_turn))
    return np.stack(np.meshgrid(x, y, yaw, indexing="ij"), -1).reshape(-1, 3)


def _check_samples(
    problem: Problem,
    score: GraspModeScorer,
    left: Shortlist,
    rng: np.random.Generator,
    found: Search,
    waiting: Waiting,
) -> None:
    """Check a round's samples in order of expected cost, and improve the chosen one."""
    costs, config = waiting.costs, waiting.costs.config
    known = costs.before_path(left.poses, left.travel)
    rest = _order(problem, left, known, config)
    while len(rest) and found.motion is None:
        block = rest[known[rest] < waiting.bound][: config.batch]
        rest = rest[~np.isin(rest, block)]
        waiting.take(screen(problem, left, block, config.grasps, found), left.poses, known)
        last = not (known[rest] < waiting.bound).any()
        chosen = [
            Candidate(left, i, path, float(known[i]))
            for i, path in waiting.choose(left.poses, last=last).items()
            if not is_dominated(problem, left.poses[i], found)
        ]
        while chosen and not can_approach(problem, chosen[0]):
            chosen.pop(0)
        if not chosen:
            continue
        better, others = cheaper_poses(problem, score, waiting, rng, found, chosen[0])
        # A less robust pose is better than none.
        for one in (*better, *chosen, *others):
            if found.motion is None:
                complete(problem, one.left, {one.index: one.path}, config.grasps, found)


def _check_grid(problem: Problem, left: Shortlist, found: Search, waiting: Waiting) -> None:
    """Check the grid in blocks, cheapest first; `whole_grid` screens all of it."""
    costs = waiting.costs
    known = costs.before_path(left.poses, left.travel)
    order = np.argsort(known, kind="stable")
    for first in range(0, len(order), _BLOCK):
        block, rest = order[first : first + _BLOCK], order[first + _BLOCK :]
        passed = screen(problem, left, block, None, found)
        if found.motion is None:
            waiting.take(passed, left.poses, known)
            last = costs.robustness_first or not (known[rest] < waiting.bound).any()
            complete(problem, left, waiting.choose(left.poses, last=last), None, found)
        if found.motion is not None and not costs.config.whole_grid:
            return


def _order(
    problem: Problem, left: Shortlist, known: Float[np.ndarray, " n"], config: PlaceConfig
) -> Int[np.ndarray, " n"]:
    """Order poses by known cost and the estimated odds that they work."""
    if not len(left.poses):
        return np.zeros(0, int)
    geometry, xy = problem.geometry, left.poses[:, :2]
    best = left.scores.max(1)
    field_value = attraction(geometry, xy, np.array([geometry.shoulder[2]]))
    # A pose that many grasps reach is better than one that a single grasp reaches well.
    assert left.mode_scores is not None
    share = np.clip((left.scores > 0).sum(1) / left.mode_scores.scored * 4, 0.0, 1.0)
    odds = np.clip(0.4 * best + 0.4 * share + 0.2 * np.sqrt(field_value), 0.0, 1.0)
    odds[~clears_sweep(geometry, left.poses, config.sweep_clearance)] *= _CLOSE_PASS_ODDS
    return by_expected_cost(known, odds, miss=config.miss_cost)
