"""Score base poses: reach of the grasp modes, and attraction of the waypoints.

The attraction: source MoMa-Pos, section III-C. The paper sums over waypoints and tests the line of
sight against whole boxes. Here the weakest waypoint counts, the value lies in [0, 1], and the boxes
are those of the static parts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from momapos.core.compiled import F2, F3, entry
from momapos.model.records import ReachScorer
from momapos.model.urdf import Boxes

from .area import PlacementGeometry

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


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
        # Few poses reach the end of the second grasp.
        rows = np.flatnonzero(reach.min_score(poses, end).max(1, initial=0.0) > 0)
        one = reach.min_score(poses[rows], first)
        reached = one.max(1, initial=0.0) > 0
        rows, one = rows[reached], one[reached]
        report(len(rows))
        other = reach.min_score(poses[rows], second)
        both = other.max(1, initial=0.0) > 0
        scores[rows[both]] = np.concatenate([one[both], other[both]], axis=1)
        return GraspModeScores(scores, scores.shape[1])

    return score


FULL_ATTRACTION_DISTANCE = 0.3
"""Distance up to which the attraction is 1 [m]; bounds 1 / distance."""
_SKIN = 0.03
"""A box this close to a target does not hide it: handles are mounted on doors [m]."""


@entry
def _sees(
    sources: F2,
    targets: F2,
    center: F2,
    rotation: F3,
    half: F2,
) -> np.ndarray:
    """Check that the segment from each source to each target misses all boxes."""
    out = np.empty((len(sources), len(targets)), np.bool_)
    for n in range(len(sources)):
        for w in range(len(targets)):
            out[n, w] = True
            dx = targets[w, 0] - sources[n, 0]
            dy = targets[w, 1] - sources[n, 1]
            dz = targets[w, 2] - sources[n, 2]
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            stop = 1.0 - _SKIN / max(length, 1e-9)
            for b in range(len(center)):
                x = sources[n, 0] - center[b, 0]
                y = sources[n, 1] - center[b, 1]
                z = sources[n, 2] - center[b, 2]
                near, far = 0.0, stop
                for k in range(3):
                    o = x * rotation[b, 0, k] + y * rotation[b, 1, k] + z * rotation[b, 2, k]
                    d = dx * rotation[b, 0, k] + dy * rotation[b, 1, k] + dz * rotation[b, 2, k]
                    if abs(d) < 1e-12:
                        if abs(o) > half[b, k]:
                            far = -1.0
                        continue
                    t0, t1 = (-half[b, k] - o) / d, (half[b, k] - o) / d
                    near, far = max(near, min(t0, t1)), min(far, max(t0, t1))
                if near < far:
                    out[n, w] = False
                    break
    return out


def sees(
    sources: Float[np.ndarray, "n 3"], targets: Float[np.ndarray, "w 3"], boxes: Boxes
) -> Bool[np.ndarray, "n w"]:
    """Check that no box lies between each source and each target."""
    return _sees(sources, targets, boxes.center, boxes.rotation, boxes.half)


def attraction(
    geometry: PlacementGeometry,
    positions: Float[np.ndarray, "n 2"],
    heights: Float[np.ndarray, " z"],
    *,
    waypoints: int = 4,
) -> Float[np.ndarray, " n"]:
    """Return the field F in [0, 1]: bounded 1 / distance if the target is visible, else 0.

    Args:
        geometry: Scene and task.
        positions: Base positions [m].
        heights: Heights of the viewpoint [m]; the best counts.
        waypoints: Number of waypoints, evenly chosen, that must be visible [-]; the weakest counts.
    """
    plain = geometry.Ts_world_tool[0, :, :3, 3]
    targets = np.ascontiguousarray(
        plain[np.linspace(0, len(plain) - 1, waypoints).round().astype(int)]
    )
    distance = np.linalg.norm(positions[:, None] - targets[None, :, :2], axis=-1)
    field = np.minimum(1.0, FULL_ATTRACTION_DISTANCE / np.maximum(distance, 1e-9))
    seen = np.zeros(distance.shape, bool)
    for z in heights:
        sources = np.column_stack([positions, np.full(len(positions), z)])
        seen |= sees(sources, targets, geometry.static)
    return (field * seen).min(1)
