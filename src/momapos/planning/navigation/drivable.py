"""Find the part of the floor to which the inscribed circle of a base can drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import inscribed_radius
from momapos.model.robots import Robot
from momapos.model.scene import Scene

from .convex_polygons import RobotPrisms, obstacles_of
from .cost_map import CELL, base_height
from .footprint_map import navigation_map_of
from .grid_distance import path_lengths
from .outline_gaps import gaps

if TYPE_CHECKING:
    from jaxtyping import Float

_CORNERS = 24
"""Corners of the polygon inside the inscribed circle [-]."""
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

    The circle is within the base, so the robot gets nowhere else. It may get less far.

    Args:
        scene: The room, with the hulls of its objects up to the height of the base.
        robot: The robot.
        start: x [m], y [m], yaw [rad].

    Raises:
        SceneError: The scene is too large for a map.
    """
    angle = np.linspace(0.0, 2 * np.pi, _CORNERS, endpoint=False)
    circle = inscribed_radius(robot.footprint) * np.column_stack([np.cos(angle), np.sin(angle)])
    prism = RobotPrisms((circle,), np.array([0.0, base_height(robot)]))
    room = navigation_map_of(robot, prism, obstacles_of(scene, prism), scene.floor_polygon)
    i, j = np.nonzero(room.inside)
    centers = room.origin + (np.column_stack([j, i]) + 0.5) * CELL
    poses = np.column_stack([centers, np.zeros(len(centers))])
    fits = gaps(poses, prism, room.planning_obstacles, cap=_SIGN_CAP) > 0.0
    free = np.zeros(room.shape, bool)
    free[i[fits], j[fits]] = True
    rows, columns = room.shape
    column, row = np.clip(
        np.floor((start[:2] - room.origin) / CELL).astype(int), 0, [columns - 1, rows - 1]
    ).tolist()
    free[row, column] = True  # its center may be a little closer to an obstacle than the start
    lengths = path_lengths(free, np.array([row * columns + column]), CELL)
    i, j = np.nonzero(np.isfinite(lengths))
    cells = room.origin + (np.column_stack([j, i]) + 0.5) * CELL
    return DrivableFloor(float(free.sum()) * CELL**2, len(cells) * CELL**2, cells)
