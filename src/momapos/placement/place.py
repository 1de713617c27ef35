"""The search: samples in A, most promising first, checked until nothing cheaper can remain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.geometry.planar import compose
from momapos.geometry.samples import latin_hypercube
from momapos.outcomes import PoseOutcome, PoseStatus
from momapos.placement.area import (
    BaseStatus,
    PlacementGeometry,
    arm_radius,
    base_pose_status,
    sampling_box,
    task_frame,
)
from momapos.placement.config import PlaceConfig
from momapos.placement.fitting import fitted
from momapos.placement.holding import ScoreWays, WayScores
from momapos.placement.margin import Waiting, margin_of
from momapos.placement.order import by_expected_cost
from momapos.placement.potential import attraction
from momapos.placement.problem import Problem, Search
from momapos.placement.region import rules
from momapos.types import ArmPathResult

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_BLOCK = 512
"""Poses of the grid that are screened together [-]."""
_TOGETHER = 8
"""Poses that are screened together where every one that works is asked for [-]."""
_CHUNK = 32
"""Most poses whose reachability is looked up together where they come in a given order [-]."""
BASE_OUTCOMES = {
    BaseStatus.BLOCKED: PoseOutcome(PoseStatus.BASE_BLOCKED),
    BaseStatus.OFF_FLOOR: PoseOutcome(PoseStatus.OFF_FLOOR),
    BaseStatus.BEYOND_ARM: PoseOutcome(PoseStatus.BEYOND_ARM),
}
_NOT_TRIED = PoseOutcome(PoseStatus.NOT_TRIED)


def search(problem: Problem, config: PlaceConfig, rng: np.random.Generator) -> Search:
    """Find the cheapest base pose that works.

    Args:
        problem: Room, task, and the checks.
        config: How to search.
        rng: Source of the samples.

    Returns:
        The best pose found, if any, and what became of all others.
    """
    corners = sampling_box(problem.geometry)
    if corners is None or problem.infeasible_reason:
        return known_no(problem)
    found = Search()
    frame = task_frame(problem.geometry)
    for local, on_grid in _rounds(corners, config, rng):
        near = _near(problem, compose(frame, local), found)
        if near is None:
            found.timed_out = True
            return found
        for score in problem.ways:
            shortlist = near.reached(problem, score, on_grid=on_grid)
            # Beside a fitted pose an arm of few joints does nothing.
            looks = 0 if problem.fit is not None or config.method != "ours" else config.looks
            waiting = Waiting(margin_of(problem, score, config), looks)
            if on_grid:
                _check_grid(problem, shortlist, config, found, waiting)
            else:
                _check_samples(problem, shortlist, config, found, waiting)
            if found.motion is not None or found.timed_out:
                return found
    return found


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

    Every round of samples is in the order of driving length, and so is the grid after the last.

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
    frame = task_frame(problem.geometry)
    for local, on_grid in _rounds(corners, config, rng):
        found = Search()
        near = _near(problem, compose(frame, local), found)
        if near is None:
            return
        ways = [near.reached(problem, score, on_grid=on_grid) for score in problem.ways]
        rows = near.clear.row[np.argsort(near.clear.travel, kind="stable")]
        for first in range(0, len(rows), _TOGETHER):
            block = rows[first : first + _TOGETHER]
            passed: list[tuple[_Shortlist, int, ArmPathResult]] = []
            for left in ways:
                which = np.flatnonzero(np.isin(left.row, block))
                some = _screen(problem, left, which, config.grasps, found)
                passed += [(left, i, path) for i, path in some.items()]
                block = np.setdiff1d(block, left.row[list(some)])
            for left, i, path in sorted(passed, key=lambda one: float(one[0].travel[one[1]])):
                found.base, found.motion = None, None
                _complete(problem, left, {i: path}, config.grasps, found)
                if found.motion is not None:
                    yield found
            if problem.out_of_time():
                return


def _check_in_order(
    problem: Problem, poses: Float[np.ndarray, "n 3"], config: PlaceConfig, found: Search
) -> None:
    """Check base poses until one works; all ways of holding at one before the next."""
    clear = _cull(problem, poses, found)
    ways = [clear.reached(score(problem.reach, clear.poses)) for score in problem.ways]
    for row in clear.row:
        for left in ways:
            which = np.flatnonzero(left.row == row)
            if not len(which):
                continue
            passed = _screen(problem, left, which, config.grasps, found)
            _complete(problem, left, passed, config.grasps, found)
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


@dataclass
class _Shortlist:
    """The poses of one round that are left after culling; `outcomes` covers the whole round."""

    poses: Float[np.ndarray, "n 3"]
    row: Int[np.ndarray, " n"]
    """Index of each into the round."""
    travel: Float[np.ndarray, " n"]
    outcomes: np.ndarray
    tried: Bool[np.ndarray, " m"]
    """Of the whole round: those at which an arm path was looked for."""
    held: WayScores | None = None
    """Of the ways of holding; None before they are known."""

    @property
    def scores(self) -> Float[np.ndarray, "n h"]:
        """Of the ways of holding."""
        assert self.held is not None
        return self.held.scores

    def keep(self, which: Bool[np.ndarray, " n"], otherwise: PoseStatus) -> None:
        """Drop the others, and say what became of them."""
        self.outcomes[self.row[~which]] = PoseOutcome(otherwise)
        self.poses, self.row = self.poses[which], self.row[which]
        self.travel = self.travel[which]

    def reached(self, ways: WayScores) -> _Shortlist:
        """Those from which some way of holding is within reach."""
        which = ways.scores.max(1, initial=0.0) > 0
        beyond = self.row[~which]
        self.outcomes[beyond[~self.tried[beyond]]] = PoseOutcome(PoseStatus.OUT_OF_REACH)
        return _Shortlist(
            self.poses[which], self.row[which], self.travel[which], self.outcomes, self.tried,
            WayScores(ways.scores[which], ways.asked),
        )  # fmt: skip

    def ways(self, i: int) -> Int[np.ndarray, " k"]:
        """Ways of holding within reach of pose i, the best reached first."""
        order = np.argsort(-self.scores[i], kind="stable")
        return order[self.scores[i, order] > 0]


def _cull(problem: Problem, poses: Float[np.ndarray, "n 3"], found: Search) -> _Shortlist:
    """Footprint first, then the way there."""
    status, _ = base_pose_status(problem.geometry, poses)
    outcomes = np.full(len(poses), _NOT_TRIED, object)
    for code, outcome in BASE_OUTCOMES.items():
        outcomes[status == code] = outcome
    row = np.flatnonzero(status == BaseStatus.CLEAR)
    travel = problem.travel_cost(poses[row, :2])
    left = _Shortlist(poses[row], row, travel, outcomes, np.zeros(len(poses), bool))
    left.keep(np.isfinite(travel), PoseStatus.NO_ROUTE)
    for rule in rules(problem.region, problem.geometry):
        left.keep(rule.keeps(left.poses, left.travel), rule.otherwise)
    if problem.pose_filter is not None:
        left.keep(~problem.pose_filter(left.poses), PoseStatus.FILTERED)
    found.note(poses, outcomes)
    return left


@dataclass(frozen=True)
class _Near:
    """The poses of one round where the base stands clear."""

    clear: _Shortlist
    own: Int[np.ndarray, " m"] | None
    """The one way of holding of each pose of the round, where they are fitted to it."""

    def reached(self, problem: Problem, score: ScoreWays, *, on_grid: bool) -> _Shortlist:
        """Those from which one of the ways of holding that are scored is within reach."""
        scores = score(problem.grid_reach if on_grid else problem.reach, self.clear.poses)
        own = self.own
        return self.clear.reached(scores if own is None else scores.of_way(own[self.clear.row]))


def _near(problem: Problem, poses: Float[np.ndarray, "n 3"], found: Search) -> _Near | None:
    """Fit and cull the poses of a round; None: out of time."""
    near = fitted(problem.fit, problem.geometry, poses, problem.out_of_time)
    if near is None:
        return None
    poses, own = near
    clear = _cull(problem, poses, found)
    if own is not None:
        clear.keep(own[clear.row] >= 0, PoseStatus.TOO_FEW_JOINTS)
    return _Near(clear, own)


def _screen(
    problem: Problem,
    left: _Shortlist,
    block: Int[np.ndarray, " b"],
    most: int | None,
    found: Search,
) -> dict[int, ArmPathResult]:
    """Arm paths at some poses of a shortlist, by index; all get their outcomes."""
    screened = problem.screen(left.poses[block], left.scores[block], most)
    if screened is None:
        found.timed_out = found.motion is None
        return {}
    found.checked += len(block)
    left.tried[left.row[block]] = True
    left.outcomes[left.row[block]] = [one.outcome for one in screened]
    return {i: one for i, one in zip(block.tolist(), screened, strict=True) if one.q is not None}


def _complete(
    problem: Problem,
    left: _Shortlist,
    passed: dict[int, ArmPathResult],
    most: int | None,
    found: Search,
) -> None:
    """Complete the first of some arm paths that can be completed."""
    for i in passed:
        if problem.out_of_time():
            found.timed_out = True
            return
        result = problem.attempt(left.poses[i], passed[i], left.ways(i)[:most])
        left.outcomes[left.row[i]] = result.outcome
        if result.motion is not None:
            found.base, found.motion, found.cost = left.poses[i], result.motion, left.travel[i]
            return


def _check_samples(
    problem: Problem, left: _Shortlist, config: PlaceConfig, found: Search, waiting: Waiting
) -> None:
    """Check a round's samples in order; where some pass, a few cheaper ones have their chance."""
    together, improve = config.together, config.improve
    rest = _order(problem, left, config)
    while len(rest) and found.motion is None and not found.timed_out:
        block, rest = rest[:together], rest[together:]
        passed = _screen(problem, left, block, config.grasps, found)
        if passed and improve:
            best = left.travel[list(passed)].min()
            cheaper = rest[left.travel[rest] < best - 1e-9][:improve]
            passed |= _screen(problem, left, cheaper, config.grasps, found)
            rest = rest[~np.isin(rest, cheaper)]
        chosen = waiting.choose(passed, left.poses, left.travel, last=not len(rest))
        _complete(problem, left, chosen, config.grasps, found)


def _check_grid(
    problem: Problem, left: _Shortlist, config: PlaceConfig, found: Search, waiting: Waiting
) -> None:
    """Complete a pose of the grid, the cheapest where no margin is asked for.

    Poses are checked in blocks, cheapest first; with `whole_grid` all are looked at.
    """
    order = np.argsort(left.travel, kind="stable")
    for first in range(0, len(order), _BLOCK):
        block = order[first : first + _BLOCK]
        passed = _screen(problem, left, block, None, found)
        if found.motion is None:
            chosen = waiting.choose(passed, left.poses, left.travel, last=True)
            _complete(problem, left, chosen, None, found)
        if found.timed_out or (found.motion is not None and not config.whole_grid):
            return


def _order(problem: Problem, left: _Shortlist, config: PlaceConfig) -> Int[np.ndarray, " n"]:
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
    return by_expected_cost(left.travel, odds, miss=config.miss)
