"""Which poses of the real, turning footprint are free, for all cells and headings of a room."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError
from momapos.core.geometry import contains
from momapos.model.robots import Robot
from momapos.model.scene import Scene

from .convex_polygons import ConvexPolygons, RobotPrisms, joined, obstacles_of, prisms_of, thinned
from .cost_map import CELL
from .outline_gaps import gaps

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32

_QUADRANT = ((1, 0), (3, 1), (2, 1), (3, 2), (1, 1), (2, 3), (1, 2), (1, 3))
MOVES = np.array([(a, b) for a, b in _QUADRANT] + [(-b, a) for a, b in _QUADRANT])
MOVES = np.concatenate([MOVES, -MOVES])
"""Steps (columns, rows) along each heading, counterclockwise from x."""
HEADINGS: np.ndarray = np.arctan2(MOVES[:, 1], MOVES[:, 0])
"""The 32 headings of the map, those along which cells lie [rad]."""
FARTHEST = 0.2
"""Gaps are told apart up to this [m]."""
OFF_FLOOR = -1.0
"""Gap at cells whose center is not on the floor [m]."""
BORDER = 2.0
"""Free border that is mapped around a room without a known floor [m]."""
MOST_CELLS = 1_000_000
_TOUCH = 1e-6
"""Outlines that end together within this lie within each other [m]."""


@dataclass(frozen=True, eq=False)
class NavigationMap:
    """All that driving knows of one robot in one room."""

    robot: Robot
    prisms: RobotPrisms
    obstacles: ConvexPolygons
    """Everything in the way, hull by hull."""
    planning_obstacles: ConvexPolygons
    """The same without what lies inside other outlines, and with the floor's edges."""
    floor_polygon: Float[np.ndarray, "k 2"] | None
    origin: Float[np.ndarray, "2"]
    """World position of the corner of cell (0, 0) [m]."""
    shape: tuple[int, int]
    """Rows and columns of the map."""

    @cached_property
    def inside(self) -> Bool[np.ndarray, "rows columns"]:
        """Cells whose center is on the floor."""
        if self.floor_polygon is None:
            return np.ones(self.shape, bool)
        return contains(self.floor_polygon, self._centers().reshape(-1, 2)).reshape(self.shape)

    @cached_property
    def known_gaps(self) -> Float32[np.ndarray, "headings rows columns"]:
        """Gaps of the states that searches have come to so far, NaN elsewhere, see `gap`: a search
        comes to few of them, and writes those down here."""
        known = np.full((len(HEADINGS), *self.shape), np.nan, np.float32)
        known[:, ~self.inside] = OFF_FLOOR
        return known

    @cached_property
    def gap(self) -> Float32[np.ndarray, "headings rows columns"]:
        """Gap around the robot at the center of each cell [m], at most FARTHEST; negative where it
        does not fit. For all states, which takes long."""
        centers = self._centers()[self.inside]
        found = np.full((len(HEADINGS), *self.shape), OFF_FLOOR, np.float32)
        for heading, layer in zip(HEADINGS, found, strict=True):
            poses = np.column_stack([centers, np.full(len(centers), heading)])
            layer[self.inside] = gaps(poses, self.prisms, self.planning_obstacles, cap=FARTHEST)
        return found

    def _centers(self) -> Float[np.ndarray, "rows columns 2"]:
        rows, columns = self.shape
        j, i = np.meshgrid(np.arange(columns), np.arange(rows))
        return self.origin + (np.stack([j, i], -1) + 0.5) * CELL

    @property
    def free(self) -> Bool[np.ndarray, "headings rows columns"]:
        """Where the robot fits."""
        return self.gap > 0.0


@lru_cache(maxsize=8)
def build_navigation_map(scene: Scene, robot: Robot) -> NavigationMap:
    """Map where a robot with its arm at home fits.

    Raises:
        SceneError: The room is too large to be mapped.
    """
    prisms = prisms_of(robot)
    obstacles = obstacles_of(scene, prisms)
    return navigation_map_of(robot, prisms, obstacles, scene.floor_polygon)


def navigation_map_of(
    robot: Robot,
    prisms: RobotPrisms,
    obstacles: ConvexPolygons,
    floor_polygon: Float[np.ndarray, "k 2"] | None,
) -> NavigationMap:
    """Map where a robot fits among outlines; see `build_navigation_map`."""
    planning_obstacles = thinned(obstacles, floor_polygon)
    if floor_polygon is not None:
        low, high = floor_polygon.min(0), floor_polygon.max(0)
    elif len(obstacles):
        low = obstacles.bounds[:, :2].min(0) - BORDER
        high = obstacles.bounds[:, 2:].max(0) + BORDER
    else:
        low, high = np.full(2, -BORDER), np.full(2, BORDER)
    origin = np.floor(low / CELL) * CELL
    columns, rows = (max(1, int(np.ceil(v))) for v in (high - origin) / CELL)
    if columns * rows > MOST_CELLS:
        width, depth = high - low
        raise SceneError(
            f"the room is {width:.0f} m x {depth:.0f} m; at most "
            f"{MOST_CELLS * CELL**2:.0f} m^2 can be mapped to drive in"
        )
    return NavigationMap(
        robot, prisms, obstacles, planning_obstacles, floor_polygon, origin, (rows, columns)
    )


def with_object_moved(nav_map: NavigationMap, name: str, outlines: ConvexPolygons) -> NavigationMap:
    """The map of a room in which one object has changed its outlines.

    What lay within its outlines before is no longer left out of the obstacles to plan with, for it
    may lie bare now.

    Args:
        nav_map: Of the room before.
        name: Of the object.
        outlines: Of the object, for the prisms of the same robot.
    """
    every, planned = nav_map.obstacles, nav_map.planning_obstacles
    was = every.of(name)
    low, high = every.bounds[:, None, :2], every.bounds[:, None, 2:]
    above = (low >= every.bounds[was, :2] - _TOUCH).all(axis=2)
    within = above & (high <= every.bounds[was, 2:] + _TOUCH).all(axis=2)
    bare = every.only(np.any(within, axis=1) & ~was)
    anew = thinned(joined((bare, outlines)), None)
    return replace(
        nav_map,
        obstacles=joined((every.only(~was), outlines)),
        planning_obstacles=joined((planned.only(~planned.of(name)), anew)),
    )
