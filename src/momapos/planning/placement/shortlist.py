"""The poses of one round: culled, looked at for an arm path, completed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import ArmPathResult, PoseOutcome, PoseStatus

from .area import BaseStatus, base_pose_status
from .fitting import fitted
from .grasp_scores import ScoreWays, WayScores
from .problem import Problem, Search
from .region import rules

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

BASE_OUTCOMES = {
    BaseStatus.BLOCKED: PoseOutcome(PoseStatus.BASE_BLOCKED),
    BaseStatus.OFF_FLOOR: PoseOutcome(PoseStatus.OFF_FLOOR),
    BaseStatus.BEYOND_ARM: PoseOutcome(PoseStatus.BEYOND_ARM),
}
NOT_TRIED = PoseOutcome(PoseStatus.NOT_TRIED)


@dataclass
class Shortlist:
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

    def keep(self, which: Bool[np.ndarray, " n"], otherwise: PoseOutcome) -> None:
        """Drop the others, and say what became of them."""
        self.outcomes[self.row[~which]] = otherwise
        self.poses, self.row = self.poses[which], self.row[which]
        self.travel = self.travel[which]

    def reached(self, ways: WayScores) -> Shortlist:
        """Those from which some way of holding is within reach."""
        which = ways.scores.max(1, initial=0.0) > 0
        beyond = self.row[~which]
        self.outcomes[beyond[~self.tried[beyond]]] = PoseOutcome(PoseStatus.OUT_OF_REACH)
        return replace(self, held=ways).only(which)

    def only(self, which: Bool[np.ndarray, " n"]) -> Shortlist:
        """Some of them, whose outcomes are written where those of all are."""
        assert self.held is not None
        return Shortlist(
            self.poses[which], self.row[which], self.travel[which], self.outcomes, self.tried,
            WayScores(self.held.scores[which], self.held.asked),
        )  # fmt: skip

    def ways(self, i: int) -> Int[np.ndarray, " k"]:
        """Ways of holding within reach of pose i, the best reached first."""
        order = np.argsort(-self.scores[i], kind="stable")
        return order[self.scores[i, order] > 0]


def cull(problem: Problem, poses: Float[np.ndarray, "n 3"], found: Search) -> Shortlist:
    """Footprint first, then the way there."""
    status, _ = base_pose_status(problem.geometry, poses)
    outcomes = np.full(len(poses), NOT_TRIED, object)
    for code, outcome in BASE_OUTCOMES.items():
        outcomes[status == code] = outcome
    row = np.flatnonzero(status == BaseStatus.CLEAR)
    travel = problem.travel_cost(poses[row, :2])
    left = Shortlist(poses[row], row, travel, outcomes, np.zeros(len(poses), bool))
    left.keep(np.isfinite(travel), PoseOutcome(PoseStatus.NO_ROUTE))
    for rule in (*rules(problem.region, problem.geometry), *problem.rules):
        left.keep(rule.keeps(left.poses, left.travel), rule.otherwise)
    if problem.pose_filter is not None:
        left.keep(~problem.pose_filter(left.poses), PoseOutcome(PoseStatus.FILTERED))
    found.note(poses, outcomes)
    return left


@dataclass(frozen=True)
class Candidate:
    """A base pose with an arm path."""

    left: Shortlist
    index: int
    """Of the pose in its shortlist."""
    path: ArmPathResult
    known: float
    """What it costs before it has a path."""

    @property
    def pose(self) -> Float[np.ndarray, "3"]:
        """x [m], y [m], yaw [rad]."""
        return self.left.poses[self.index]


@dataclass(frozen=True)
class Near:
    """The poses of one round where the base stands clear."""

    clear: Shortlist
    own: Int[np.ndarray, " m"] | None
    """The one way of holding of each pose of the round, where they are fitted to it."""

    def reached(self, problem: Problem, score: ScoreWays, *, on_grid: bool) -> Shortlist:
        """Those from which one of the ways of holding that are scored is within reach."""
        scores = score(problem.grid_reach if on_grid else problem.reach, self.clear.poses)
        own = self.own
        return self.clear.reached(scores if own is None else scores.of_way(own[self.clear.row]))


def near_poses(problem: Problem, poses: Float[np.ndarray, "n 3"], found: Search) -> Near | None:
    """Fit and cull the poses of a round; None: out of time."""
    near = fitted(problem.fit, problem.geometry, poses, problem.out_of_time)
    if near is None:
        return None
    poses, own = near
    clear = cull(problem, poses, found)
    if own is not None:
        clear.keep(own[clear.row] >= 0, PoseOutcome(PoseStatus.TOO_FEW_JOINTS))
    return Near(clear, own)


def screen(
    problem: Problem,
    left: Shortlist,
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


def hopeless(problem: Problem, pose: Float[np.ndarray, "3"], found: Search) -> bool:
    """Whether a base pose is known to be no better than the spare."""
    if found.spare is None or problem.leads_on is None:
        return False
    return problem.leads_on.hopeless(pose)


def complete(
    problem: Problem,
    left: Shortlist,
    passed: dict[int, ArmPathResult],
    most: int | None,
    found: Search,
) -> None:
    """Complete the first of some arm paths that can be completed; one after which the robot cannot
    drive on is a spare."""
    for i in passed:
        if problem.out_of_time():
            found.timed_out = True
            return
        pose, travel = left.poses[i], float(left.travel[i])
        if hopeless(problem, pose, found):
            continue
        result = problem.attempt(pose, passed[i], left.ways(i)[:most])
        left.outcomes[left.row[i]] = result.outcome
        if result.motion is None:
            continue
        if problem.leads_on is None or problem.leads_on(pose):
            found.base, found.motion, found.cost = pose, result.motion, travel
            return
        found.spare = found.spare or (pose, result.motion, travel)
