"""How well base poses reach the ways of holding: every grasp by itself, then groups that turn."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from momapos.model.records import ReachScorer

if TYPE_CHECKING:
    from jaxtyping import Float, Int

LEAST_SCORE = 1e-6
"""Score of ways that the reachability map calls out of reach, where all are tried: they come last,
those that turn after the others [-]."""
_BLOCK = 4096
"""Poses whose scores at every waypoint are held at a time [-]."""


class WayScores(NamedTuple):
    """How well some base poses reach ways of holding."""

    scores: Float[np.ndarray, "n h"]
    """In [0, 1]; 0 for ways that are not asked for, too."""
    asked: int
    """How many ways are asked for [-]."""

    def of_way(self, own: Int[np.ndarray, " n"]) -> WayScores:
        """The same with 0 for all but one way of each pose; -1 stands for none."""
        ways = np.arange(self.scores.shape[1])
        return WayScores(np.where(ways == own[:, None], self.scores, 0.0), self.asked)

    def at_least(self, score: float) -> WayScores:
        """The same, no way that is asked for scoring less."""
        scores = self.scores.copy()
        asked = scores[:, scores.shape[1] - self.asked :]
        np.maximum(asked, score, out=asked)
        return WayScores(scores, self.asked)


ScoreWays: TypeAlias = "Callable[[ReachScorer, Float[np.ndarray, 'n 3']], WayScores]"


def scores_of_grasps(Ts_world_tool: Float[np.ndarray, "g w 4 4"]) -> ScoreWays:
    """Score every grasp by its smallest score over the waypoints."""

    def score(reach: ReachScorer, poses: Float[np.ndarray, "n 3"]) -> WayScores:
        return WayScores(reach.min_score(poses, Ts_world_tool), len(Ts_world_tool))

    return score


def scores_of_turning(
    Ts_world_tool: Float[np.ndarray, "g w 4 4"], groups: Int[np.ndarray, "t k"]
) -> ScoreWays:
    """Score every group by its smallest score over the waypoints, the best grasp counting there.

    The approach is straight: there the hand does not turn, so that its two waypoints count as one.
    Single grasps, which come before the groups, get 0.
    """
    grasps, waypoints = Ts_world_tool.shape[:2]
    turning, index = np.unique(groups, return_inverse=True)
    member, held = index.reshape(groups.shape), groups >= 0
    each = np.ascontiguousarray(Ts_world_tool[turning].reshape(-1, 1, 4, 4))
    last = np.ascontiguousarray(Ts_world_tool[turning, -1:])

    def score(reach: ReachScorer, poses: Float[np.ndarray, "n 3"]) -> WayScores:
        scores = np.zeros((len(poses), grasps + len(groups)), np.float32)
        for first in range(0, len(poses), _BLOCK):
            block = slice(first, first + _BLOCK)
            # From most poses no grasp of any group reaches the end of the motion.
            ends = reach.min_score(poses[block], last).max(1)
            rows = first + np.flatnonzero(ends > 0)
            at = reach.min_score(poses[rows], each).reshape(-1, len(turning), waypoints)
            at[:, :, 1] = np.minimum(at[:, :, 0], at[:, :, 1])
            members = at[:, member, 1:] * held[None, :, :, None]
            scores[rows, grasps:] = members.max(2, initial=0.0).min(2)
        return WayScores(scores, len(groups))

    return score


def ways_of_holding(
    Ts_world_tool: Float[np.ndarray, "g w 4 4"], groups: Int[np.ndarray, "t k"]
) -> tuple[ScoreWays, ...]:
    """Grasps that stay as they are first; those that turn cost more."""
    rigid = scores_of_grasps(Ts_world_tool)
    return (rigid, scores_of_turning(Ts_world_tool, groups)) if len(groups) else (rigid,)


def scores_of_two_holds(
    first: Float[np.ndarray, "g w 4 4"],
    second: Float[np.ndarray, "h v 4 4"],
    tell: Callable[[int], None] = lambda _: None,
) -> ScoreWays:
    """Score the grasps of two holds, side by side; 0 where one of the two is out of reach.

    Args:
        first, second: Tool poses of the grasps at the waypoints.
        tell: Is told from how many poses the first hold and the end of the second are within reach.
    """
    end = np.ascontiguousarray(second[:, -1:])

    def score(reach: ReachScorer, poses: Float[np.ndarray, "n 3"]) -> WayScores:
        scores = np.zeros((len(poses), len(first) + len(second)), np.float32)
        one = reach.min_score(poses, first)
        rows = np.flatnonzero(one.max(1, initial=0.0) > 0)
        rows = rows[reach.min_score(poses[rows], end).max(1, initial=0.0) > 0]
        tell(len(rows))
        other = reach.min_score(poses[rows], second)
        both = other.max(1, initial=0.0) > 0
        scores[rows[both]] = np.concatenate([one[rows[both]], other[both]], axis=1)
        return WayScores(scores, scores.shape[1])

    return score
