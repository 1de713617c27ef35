"""Score how well base poses reach the grasp modes: rigid grasps, then groups of turning grasps."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from momapos.model.records import ReachScorer

if TYPE_CHECKING:
    from jaxtyping import Float, Int

MIN_MODE_SCORE = 1e-6
"""Score of grasp modes that the reachability map excludes, where all modes are tried: they come
last, turning modes after rigid ones [-]."""
_BLOCK = 4096
"""Poses whose scores at every waypoint are in memory at a time [-]."""


class GraspModeScores(NamedTuple):
    """Reachability of the grasp modes from some base poses."""

    scores: Float[np.ndarray, "n h"]
    """In [0, 1]; 0 also for modes that are not scored."""
    scored: int
    """Number of modes that are scored, the last columns [-]."""

    def of_mode(self, own: Int[np.ndarray, " n"]) -> GraspModeScores:
        """Set the scores of all modes but one of each pose to 0; -1 stands for none."""
        modes = np.arange(self.scores.shape[1])
        return GraspModeScores(np.where(modes == own[:, None], self.scores, 0.0), self.scored)

    def at_least(self, score: float) -> GraspModeScores:
        """Raise lower scores of the scored modes to a minimum."""
        scores = self.scores.copy()
        scored = scores[:, scores.shape[1] - self.scored :]
        np.maximum(scored, score, out=scored)
        return GraspModeScores(scores, self.scored)


GraspModeScorer: TypeAlias = "Callable[[ReachScorer, Float[np.ndarray, 'n 3']], GraspModeScores]"


def rigid_grasp_scorer(Ts_world_tool: Float[np.ndarray, "g w 4 4"]) -> GraspModeScorer:
    """Score each grasp by its smallest reachability over the waypoints."""

    def score(reach: ReachScorer, poses: Float[np.ndarray, "n 3"]) -> GraspModeScores:
        return GraspModeScores(reach.min_score(poses, Ts_world_tool), len(Ts_world_tool))

    return score


def turning_grasp_scorer(
    Ts_world_tool: Float[np.ndarray, "g w 4 4"], groups: Int[np.ndarray, "t k"]
) -> GraspModeScorer:
    """Score each group by its smallest score over the waypoints; at each, the best grasp counts.

    The hand does not turn during the approach, so its two waypoints count as one. Single grasps,
    which precede the groups, get 0.
    """
    grasps, waypoints = Ts_world_tool.shape[:2]
    turning, index = np.unique(groups, return_inverse=True)
    member, held = index.reshape(groups.shape), groups >= 0
    middle = (waypoints + 1) // 2
    rest = [w for w in range(2, waypoints - 1) if w != middle]
    # Most poses reach the end of the motion with no grasp of any group, and few of the others the
    # approach and the middle.
    stages = [
        np.ascontiguousarray(Ts_world_tool[turning][:, steps])
        for steps in ([[waypoints - 1]], [[0, 1], [middle, middle]], [[w] for w in rest])
        if len(steps)
    ]

    def worst(
        reach: ReachScorer, poses: Float[np.ndarray, "n 3"], Ts: Float[np.ndarray, "m s k 4 4"]
    ) -> Float[np.ndarray, "n t"]:
        """Return the smallest score of each group over some steps of one or two waypoints."""
        at = reach.min_score(poses, Ts.reshape(-1, *Ts.shape[2:])).reshape(
            len(poses), *Ts.shape[:2]
        )
        return (at[:, member] * held[:, :, None]).max(2, initial=0.0).min(2)

    def score(reach: ReachScorer, poses: Float[np.ndarray, "n 3"]) -> GraspModeScores:
        scores = np.zeros((len(poses), grasps + len(groups)), np.float32)
        for first in range(0, len(poses), _BLOCK):
            rows = np.arange(first, min(first + _BLOCK, len(poses)))
            least = np.full((len(rows), len(groups)), np.inf, np.float32)
            for Ts in stages:
                least = np.minimum(least, worst(reach, poses[rows], Ts))
                reached = least.max(1) > 0
                rows, least = rows[reached], least[reached]
            scores[rows, grasps:] = least
        return GraspModeScores(scores, len(groups))

    return score


def grasp_mode_scorers(
    Ts_world_tool: Float[np.ndarray, "g w 4 4"], groups: Int[np.ndarray, "t k"]
) -> tuple[GraspModeScorer, ...]:
    """Return the scorer of rigid grasps, then the more expensive one of turning grasps, if any."""
    rigid = rigid_grasp_scorer(Ts_world_tool)
    return (rigid, turning_grasp_scorer(Ts_world_tool, groups)) if len(groups) else (rigid,)


def two_grasp_scorer(
    first: Float[np.ndarray, "g w 4 4"],
    second: Float[np.ndarray, "h v 4 4"],
    report: Callable[[int], None] = lambda _: None,
) -> GraspModeScorer:
    """Score two successive grasps, in adjacent columns; 0 if either is out of reach.

    Args:
        first, second: Tool poses of the grasps at the waypoints.
        report: Receives how many poses reach the first grasp and the end of the second.
    """
    end = np.ascontiguousarray(second[:, -1:])

    def score(reach: ReachScorer, poses: Float[np.ndarray, "n 3"]) -> GraspModeScores:
        scores = np.zeros((len(poses), len(first) + len(second)), np.float32)
        one = reach.min_score(poses, first)
        rows = np.flatnonzero(one.max(1, initial=0.0) > 0)
        rows = rows[reach.min_score(poses[rows], end).max(1, initial=0.0) > 0]
        report(len(rows))
        other = reach.min_score(poses[rows], second)
        both = other.max(1, initial=0.0) > 0
        scores[rows[both]] = np.concatenate([one[rows[both]], other[both]], axis=1)
        return GraspModeScores(scores, scores.shape[1])

    return score
