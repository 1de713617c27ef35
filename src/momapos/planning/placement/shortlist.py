"""Handle the poses of one round: cull them, screen them for an arm path, complete one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import look
from momapos.model.records import ArmPathResult, PoseOutcome, PoseStatus

from .area import BaseStatus, base_pose_status
from .grasp_scores import GraspModeScorer, GraspModeScores
from .problem import PoseOutcomes, PoseRule, Problem, Search, fitted, rules

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    from .area import StandingCodes

BASE_OUTCOMES: dict[BaseStatus, PoseOutcome] = {
    BaseStatus.BLOCKED: PoseOutcome(PoseStatus.BASE_BLOCKED),
    BaseStatus.OFF_FLOOR: PoseOutcome(PoseStatus.OFF_FLOOR),
    BaseStatus.BEYOND_ARM: PoseOutcome(PoseStatus.BEYOND_ARM),
}
NOT_TRIED = PoseOutcome(PoseStatus.NOT_TRIED)


@dataclass(eq=False)
class Shortlist:
    """The poses of one round that remain after culling."""

    poses: Float[np.ndarray, "n 3"]
    row: Int[np.ndarray, " n"]
    """Index of each pose in the round."""
    travel: Float[np.ndarray, " n"]
    """Driving length to each pose [m]."""
    outcomes: PoseOutcomes
    """Outcomes of the whole round, shared by all its shortlists."""
    tried: Bool[np.ndarray, " m"]
    """Which poses of the whole round were screened for an arm path."""
    mode_scores: GraspModeScores | None = None
    """Scores of the grasp modes; None before they are known."""

    @property
    def scores(self) -> Float[np.ndarray, "n h"]:
        """Scores of the grasp modes."""
        assert self.mode_scores is not None
        return self.mode_scores.scores

    def keep(self, which: Bool[np.ndarray, " n"], otherwise: PoseOutcome) -> None:
        """Drop the other poses and record their outcome."""
        self.outcomes[self.row[~which]] = otherwise
        self.poses, self.row = self.poses[which], self.row[which]
        self.travel = self.travel[which]

    def reached(self, modes: GraspModeScores, also: Sequence[PoseRule]) -> Shortlist:
        """Return the poses from which some grasp mode is within reach and that keep further rules.

        Args:
            modes: Scores of the grasp modes.
            also: The rules.
        """
        which = modes.scores.max(1, initial=0.0) > 0
        left = replace(self, mode_scores=modes)._without(
            ~which, PoseOutcome(PoseStatus.OUT_OF_REACH)
        )
        for rule in also:
            left = left._without(~rule.keeps(left.poses, left.travel), rule.otherwise)
        return left

    def _without(self, which: Bool[np.ndarray, " n"], because: PoseOutcome) -> Shortlist:
        """Return the other poses; record why unless an earlier grasp mode came farther."""
        rows = self.row[which]
        self.outcomes[rows[~self.tried[rows]]] = because
        return self.only(~which)

    def only(self, which: Bool[np.ndarray, " n"]) -> Shortlist:
        """Return a subset that shares the outcomes of the round."""
        assert self.mode_scores is not None
        return Shortlist(
            self.poses[which], self.row[which], self.travel[which], self.outcomes, self.tried,
            GraspModeScores(self.scores[which], self.mode_scores.scored),
        )  # fmt: skip

    def modes(self, i: int) -> Int[np.ndarray, " k"]:
        """Return the grasp modes within reach of pose i, the best reached first."""
        order = np.argsort(-self.scores[i], kind="stable")
        return order[self.scores[i, order] > 0]


def cull(
    problem: Problem,
    poses: Float[np.ndarray, "n 3"],
    stands: StandingCodes | None = None,
) -> Shortlist:
    """Drop poses by base collision, driving path, region and filters.

    Args:
        problem: Scene, task and checks.
        poses: Base poses (x [m], y [m], yaw [rad]).
        stands: See `base_pose_status`.
    """
    status, _ = base_pose_status(problem.geometry, poses, stands)
    outcomes = PoseOutcomes.all_the_same(NOT_TRIED, len(poses))
    for code, outcome in BASE_OUTCOMES.items():
        outcomes[status == code] = outcome
    row = np.flatnonzero(status == BaseStatus.CLEAR)
    travel = problem.travel_cost(poses[row])
    left = Shortlist(poses[row], row, travel, outcomes, np.zeros(len(poses), bool))
    before: tuple[PoseRule, ...] = (*rules(problem.region, problem.geometry), *problem.way_rules)
    for rule in before:
        left.keep(rule.keeps(left.poses, left.travel), rule.otherwise)
    left.keep(np.isfinite(left.travel), PoseOutcome(PoseStatus.NO_ROUTE))
    for rule in problem.rules:
        left.keep(rule.keeps(left.poses, left.travel), rule.otherwise)
    if problem.keep_poses is not None:
        left.keep(problem.keep_poses(left.poses), PoseOutcome(PoseStatus.FILTERED))
    return left


@dataclass(frozen=True)
class Candidate:
    """A base pose with an arm path."""

    left: Shortlist
    index: int
    """Index of the pose in its shortlist."""
    path: ArmPathResult
    known: float
    """Its cost before it has a path."""

    @property
    def pose(self) -> Float[np.ndarray, "3"]:
        """x [m], y [m], yaw [rad]."""
        return self.left.poses[self.index]


@dataclass(frozen=True, eq=False)
class ClearPoses:
    """The poses of one round at which the base stands clear."""

    every: Float[np.ndarray, "m 3"]
    """All poses of the round."""
    poses: Shortlist
    own: Int[np.ndarray, " m"] | None
    """The only grasp mode of each pose of the round, if they are fitted to one."""

    def reached(self, problem: Problem, score: GraspModeScorer, *, on_grid: bool) -> Shortlist:
        """Return the poses from which a scored grasp mode is within reach."""
        scores = score(problem.grid_reach if on_grid else problem.reach, self.poses.poses)
        own = self.own
        modes = scores if own is None else scores.of_mode(own[self.poses.row])
        return self.poses.reached(modes, problem.path_rules)


def clear_poses(
    problem: Problem, poses: Float[np.ndarray, "n 3"], stands: StandingCodes | None = None
) -> ClearPoses:
    """Fit and cull the poses of a round."""
    poses, own = fitted(problem.fit, problem.geometry, poses)
    clear = cull(problem, poses, stands if own is None else None)
    if own is not None:
        clear.keep(own[clear.row] >= 0, PoseOutcome(PoseStatus.TOO_FEW_JOINTS))
    return ClearPoses(poses, clear, own)


def screen(
    problem: Problem,
    left: Shortlist,
    block: Int[np.ndarray, " b"],
    most: int | None,
    found: Search,
) -> dict[int, ArmPathResult]:
    """Return the arm paths at some poses of a shortlist by index; record all outcomes."""
    block = _approachable(problem, left, block)
    if not len(block):
        return {}
    screened = problem.screen(left.poses[block], left.scores[block], most)
    found.checked += len(block)
    left.tried[left.row[block]] = True
    left.outcomes[left.row[block]] = [one.outcome for one in screened]
    return {i: one for i, one in zip(block.tolist(), screened, strict=True) if one.q is not None}


def _approachable(
    problem: Problem, left: Shortlist, block: Int[np.ndarray, " b"]
) -> Int[np.ndarray, " c"]:
    """Return the poses that are not known to be cut off; record the others' outcome."""
    if problem.approach is None:
        return block
    blocked = problem.approach.known_blocked(left.poses[block])
    if blocked.any():
        left.outcomes[left.row[block[blocked]]] = problem.approach.no_way()
    left.tried[left.row[block[blocked]]] = True
    return block[~blocked]


def can_approach(problem: Problem, one: Candidate) -> bool:
    """Return whether a path may lead to a base pose; record its outcome if none does."""
    if problem.approach is None or problem.approach(one.pose):
        return True
    one.left.outcomes[one.left.row[one.index]] = problem.approach.no_way()
    return False


def is_dominated(problem: Problem, pose: Float[np.ndarray, "3"], found: Search) -> bool:
    """Check whether a base pose is known to be no better than the fallback."""
    if found.fallback is None or problem.departure is None:
        return False
    return problem.departure.is_known_blocked(pose)


def complete(
    problem: Problem,
    left: Shortlist,
    passed: dict[int, ArmPathResult],
    most: int | None,
    found: Search,
) -> None:
    """Complete the first arm path that can be; one that blocks the robot in is the fallback."""
    for i in passed:
        look()
        pose, travel = left.poses[i], float(left.travel[i])
        if is_dominated(problem, pose, found):
            continue
        result = problem.attempt(pose, passed[i], left.modes(i)[:most])
        left.outcomes[left.row[i]] = result.outcome
        if result.motion is None:
            continue
        pose = pose if result.base is None else result.base
        if problem.departure is None or problem.departure(pose):
            found.base, found.motion, found.cost = pose, result.motion, travel
            return
        found.fallback = found.fallback or (pose, result.motion, travel)
