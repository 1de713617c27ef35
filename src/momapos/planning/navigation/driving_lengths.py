"""Lower bounds of the driving length to many places at once, which order base poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.robots import Robot

from .car_connection import shortest_lengths
from .cost_map import CostMap
from .lattice_moves import planned_radius

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class TravelLengths:
    """Driving lengths from a start."""

    costs: CostMap
    """Lengths of a disc among the obstacles."""
    robot: Robot
    start: Float[np.ndarray, "3"]
    """x [m], y [m], yaw [rad]."""

    def __call__(self, places: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
        """Return the lengths to places [m], infinite without a path.

        A car-like base drives at least the shortest curve without obstacles, too.

        Args:
            places: Positions x, y [m], or base poses with the yaw [rad].
        """
        lengths, radius = self.costs.lengths(places), planned_radius(self.robot)
        if radius <= 0 or places.shape[1] == 2:
            return lengths
        start = np.broadcast_to(self.start, places.shape)
        curves = shortest_lengths(*map(np.ascontiguousarray, (start, places)), radius)
        return np.asarray(np.maximum(lengths, curves))
