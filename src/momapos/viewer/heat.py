"""The potential map: how promising each floor position is, at its best yaw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from momapos.placement.area import CLEAR, Site, sampling_box, standing
from momapos.placement.potential import attraction
from momapos.protocols import ReachScorer

YAWS = 8
"""Yaws that are tried at each position [-]."""


@dataclass(frozen=True)
class Heat:
    """A grid of values over the floor."""

    value: Float[np.ndarray, "rows columns"]
    """Potential in [0, 1], 0 where the base cannot stand or the arm cannot reach."""
    low: Float[np.ndarray, "2"]
    """Corner of cell (0, 0) [m]."""
    cell: float
    """Edge of a cell [m]."""

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top [m]."""
        rows, columns = self.value.shape
        right, top = self.low + self.cell * np.array([columns, rows])
        return (float(self.low[0]), float(right), float(self.low[1]), float(top))


def potential_map(site: Site, reach: ReachScorer, *, cell: float) -> Heat | None:
    """Evaluate reachability plus attraction on a grid, as the weakest waypoint has them.

    Args:
        site: Room and task.
        reach: The robot's reachability map.
        cell: Edge of a cell [m].

    Returns:
        None where no position is within the arm's length of all waypoints.
    """
    corners = sampling_box(site)
    if corners is None:
        return None
    low = np.floor(corners[0] / cell) * cell
    columns, rows = np.ceil((corners[1] - low) / cell).astype(int)
    x = low[0] + (np.arange(columns) + 0.5) * cell
    y = low[1] + (np.arange(rows) + 0.5) * cell
    xy = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    yaw = 2 * np.pi / YAWS * np.arange(YAWS)
    poses = np.column_stack([np.repeat(xy, YAWS, axis=0), np.tile(yaw, len(xy))])
    clear = np.flatnonzero(standing(site, poses)[0] == CLEAR)
    score = np.zeros(len(poses))
    score[clear] = reach.weakest(poses[clear], site.Ts_world_tool).max(1, initial=0.0)
    best = score.reshape(-1, YAWS).max(1)
    seen = np.flatnonzero(best > 0)
    value = np.zeros(len(xy))
    field = attraction(site, xy[seen], np.array([site.shoulder[2]]))
    value[seen] = (best[seen] + field) / 2
    return Heat(value.reshape(rows, columns), low, cell)
