"""How well base poses reach the ways of holding: every grasp by itself, then groups that turn."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.placement.area import PlacementGeometry
from momapos.protocols import ReachScorer

if TYPE_CHECKING:
    from jaxtyping import Float

ScoreWays: TypeAlias = (
    "Callable[[ReachScorer, Float[np.ndarray, 'n 3'], PlacementGeometry], Float[np.ndarray, 'n h']]"
)
"""Scores of ways of holding from some base poses: of grasps, then, where asked for, of groups."""
_BLOCK = 4096
"""Poses whose scores at every waypoint are held at a time [-]."""


def score_grasps(
    reach: ReachScorer, poses: Float[np.ndarray, "n 3"], geometry: PlacementGeometry
) -> Float[np.ndarray, "n h"]:
    """Smallest score over the waypoints of every grasp; groups that turn are not asked for."""
    return reach.min_score(poses, geometry.Ts_world_tool)


def score_turning(
    reach: ReachScorer, poses: Float[np.ndarray, "n 3"], geometry: PlacementGeometry
) -> Float[np.ndarray, "n h"]:
    """Smallest score over the waypoints of every group, of whose grasps the best counts there.

    The approach is straight: there the hand does not turn, so that its two waypoints count as one.
    Single grasps get 0, being tried before.
    """
    grasps, waypoints = geometry.Ts_world_tool.shape[:2]
    each = np.ascontiguousarray(geometry.Ts_world_tool.reshape(-1, 1, 4, 4))
    scores = np.zeros((len(poses), grasps + len(geometry.groups)), np.float32)
    for first in range(0, len(poses), _BLOCK):
        block = slice(first, first + _BLOCK)
        at = reach.min_score(poses[block], each).reshape(-1, grasps, waypoints)
        at[:, :, 1] = np.minimum(at[:, :, 0], at[:, :, 1])
        members = at[:, geometry.groups, 1:] * (geometry.groups >= 0)[None, :, :, None]
        scores[block, grasps:] = members.max(2, initial=0.0).min(2)
    return scores
