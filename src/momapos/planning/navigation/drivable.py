"""Find the part of the floor to which the inscribed circle of a base can drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import inscribed_radius
from momapos.model.robots import Robot
from momapos.model.scene import Scene

from .convex_polygons import RobotPrisms, obstacles_of, planning_outlines
from .cost_map import CELL, FloorPlan, base_height, blocked_cells
from .grid_distance import clearance, path_lengths
from .outline_gaps import gaps

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_CORNERS = 24
"""Corners of the polygon inside the inscribed circle [-]."""
_UNSURE = 2.0
"""Distances between cells are that inexact [cells]."""
_SIGN_CAP = 0.01
"""Upper bound of gaps of which only the sign counts [m]."""


@dataclass(frozen=True, eq=False)
class DrivableFloor:
    """Where the inscribed circle of a base fits, and where it gets from a start."""

    free_area: float
    """Area of the cells in which it fits [m^2]."""
    reachable_area: float
    """Area of those that it reaches from the start [m^2]."""
    cells: Float[np.ndarray, "n 2"]
    """Centers of the reachable cells [m]."""


def drivable_floor(scene: Scene, robot: Robot, start: Float[np.ndarray, "3"]) -> DrivableFloor:
    """Find where the inscribed circle of a robot's base can drive.

    The circle is within the base, so the robot gets nowhere else, and may get less far. Passages
    that are wider than the circle by less than a cell may be missed, as when a path is planned.

    Args:
        scene: The room, with the hulls of its objects up to the height of the base.
        robot: The robot.
        start: x [m], y [m], yaw [rad].
    """
    radius = inscribed_radius(robot.footprint)
    angle = np.linspace(0.0, 2 * np.pi, _CORNERS, endpoint=False)
    circle = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    prism = RobotPrisms((circle,), np.array([0.0, base_height(robot)]))
    outlines = planning_outlines(obstacles_of(scene, prism), scene.floor_polygon)
    shapes = [outlines.polygon(k) for k in range(len(outlines))]
    plan = blocked_cells(shapes, floor_polygon=scene.floor_polygon, start=start[:2])
    # Cells tell whether the circle fits to within two of them; outlines tell the rest.
    distance = clearance(plan.blocked, cap=radius / CELL + _UNSURE + 1.0)
    free = distance > radius / CELL + _UNSURE
    rows, columns = np.nonzero(~free & (distance > radius / CELL - _UNSURE))
    poses = np.column_stack([_centers(plan, rows, columns), np.zeros(len(rows))])
    free[rows, columns] = gaps(poses, prism, outlines, cap=_SIGN_CAP) > 0.0
    row, column = np.floor((start[:2] - plan.origin) / CELL).astype(int)[::-1].tolist()
    row, column = (min(max(k, 0), n - 1) for k, n in zip((row, column), free.shape, strict=True))
    free[row, column] = True  # its center may be a little closer to an obstacle than the start
    lengths = path_lengths(free, np.array([row * free.shape[1] + column]), CELL)
    cells = _centers(plan, *np.nonzero(np.isfinite(lengths)))
    return DrivableFloor(float(free.sum()) * CELL**2, len(cells) * CELL**2, cells)


def _centers(
    plan: FloorPlan, rows: Int[np.ndarray, " n"], columns: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "n 2"]:
    return np.asarray(plan.origin + (np.column_stack([columns, rows]) + 0.5) * CELL)
