"""The potential map: the score of each floor position at its best yaw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import ReachScorer
from momapos.planning.placement import (
    BaseStatus,
    PlacementGeometry,
    attraction,
    base_pose_status,
    reachable_rectangle,
    within_reach,
)

if TYPE_CHECKING:
    from jaxtyping import Float

YAWS = 8
"""Yaws sampled at each position [-]."""


@dataclass(frozen=True, eq=False)
class PotentialMap:
    """The potential on a grid over the floor."""

    value: Float[np.ndarray, "rows columns"]
    """Potential in [0, 1]; 0 where the base cannot stand or the arm cannot reach."""
    low: Float[np.ndarray, "2"]
    """Lower corner of cell (0, 0) [m]."""
    cell: float
    """Edge of a cell [m]."""

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top [m]."""
        rows, columns = self.value.shape
        right, top = self.low + self.cell * np.array([columns, rows])
        return (float(self.low[0]), float(right), float(self.low[1]), float(top))


def potential_map(
    geometry: PlacementGeometry, reach: ReachScorer, *, cell: float
) -> PotentialMap | None:
    """Compute the mean of reachability, for the worst waypoint, and attraction on a grid.

    Args:
        geometry: Room and task.
        reach: The robot's reachability map.
        cell: Edge of a cell [m].

    Returns:
        The map, or None if no position is within the arm's length of all waypoints.
    """
    corners = reachable_rectangle(geometry)
    if corners is None:
        return None
    low = np.floor(corners[0] / cell) * cell
    columns, rows = np.ceil((corners[1] - low) / cell).astype(int)
    x = low[0] + (np.arange(columns) + 0.5) * cell
    y = low[1] + (np.arange(rows) + 0.5) * cell
    xy = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    yaw = 2 * np.pi / YAWS * np.arange(YAWS)
    poses = np.column_stack([np.repeat(xy, YAWS, axis=0), np.tile(yaw, len(xy))])
    # Reachability first, as it is cheaper to compute.
    score = np.zeros(len(poses))
    near = np.flatnonzero(within_reach(geometry, poses))
    score[near] = reach.min_score(poses[near], geometry.Ts_world_tool).max(1, initial=0.0)
    near = near[score[near] > 0]
    score[near[base_pose_status(geometry, poses[near])[0] != BaseStatus.CLEAR]] = 0.0
    best = score.reshape(-1, YAWS).max(1)
    seen = np.flatnonzero(best > 0)
    value = np.zeros(len(xy))
    field = attraction(geometry, xy[seen], np.array([geometry.shoulder[2]]))
    value[seen] = (best[seen] + field) / 2
    return PotentialMap(value.reshape(rows, columns), low, cell)
