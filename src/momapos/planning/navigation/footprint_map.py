"""Map of the free poses of the real footprint, for all cells and headings of a scene."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError, owner_cache
from momapos.core.geometry import contains, convex_parts
from momapos.model.records import Outline
from momapos.model.robots import Robot
from momapos.model.scene import Scene, area_name

from .convex_polygons import (
    ConvexPolygons,
    HeldObject,
    RobotPrisms,
    concatenate,
    obstacles_of,
    pack,
    planning_outlines,
    prisms_of,
)
from .cost_map import CELL, MAP_MARGIN
from .outline_gaps import gaps

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32

_QUADRANT = ((1, 0), (3, 1), (2, 1), (3, 2), (1, 1), (2, 3), (1, 2), (1, 3))
MOVES = np.array([(a, b) for a, b in _QUADRANT] + [(-b, a) for a, b in _QUADRANT])
MOVES = np.concatenate([MOVES, -MOVES])
"""Steps (columns, rows) along each heading, counterclockwise from x."""
HEADINGS: np.ndarray = np.arctan2(MOVES[:, 1], MOVES[:, 0])
"""The 32 headings of the map: the directions of `MOVES` [rad]."""
MAX_GAP = 0.2
"""Upper bound of the map's gaps [m]."""
OFF_FLOOR = -1.0
"""Gap of cells whose center is not on the floor [m]."""
MAX_CELLS = 1_000_000
_TOLERANCE = 1e-6
"""Tolerance for outlines that contain each other [m]."""


@dataclass(frozen=True, eq=False)
class NavigationMap:
    """Navigation data of one robot in one scene."""

    robot: Robot
    prisms: RobotPrisms
    obstacles: ConvexPolygons
    """Outlines of all obstacles, hull by hull."""
    planning_obstacles: ConvexPolygons
    """The same without outlines inside other ones, and with the edges of the floor."""
    floor_polygon: Float[np.ndarray, "k 2"] | None
    origin: Float[np.ndarray, "2"]
    """World position of the corner of cell (0, 0) [m]."""
    shape: tuple[int, int]
    """Rows and columns of the map."""

    @cached_property
    def inside(self) -> Bool[np.ndarray, "rows columns"]:
        """Whether the center of a cell is on the floor."""
        if self.floor_polygon is None:
            return np.ones(self.shape, bool)
        return contains(self.floor_polygon, self._centers().reshape(-1, 2)).reshape(self.shape)

    @cached_property
    def known_gaps(self) -> Float32[np.ndarray, "headings rows columns"]:
        """Gaps of the states that searches have visited so far, NaN elsewhere; see `gap`. Searches
        visit few states, and store their gaps here."""
        known = np.full((len(HEADINGS), *self.shape), np.nan, np.float32)
        known[:, ~self.inside] = OFF_FLOOR
        return known

    @cached_property
    def gap(self) -> Float32[np.ndarray, "headings rows columns"]:
        """Gap around the robot at the center of each cell [m], at most `MAX_GAP`; negative where it
        does not fit. Slow, because it is computed for all states."""
        centers = self._centers()[self.inside]
        found = np.full((len(HEADINGS), *self.shape), OFF_FLOOR, np.float32)
        for heading, layer in zip(HEADINGS, found, strict=True):
            poses = np.column_stack([centers, np.full(len(centers), heading)])
            layer[self.inside] = gaps(poses, self.prisms, self.planning_obstacles, cap=MAX_GAP)
        return found

    def _centers(self) -> Float[np.ndarray, "rows columns 2"]:
        rows, columns = self.shape
        j, i = np.meshgrid(np.arange(columns), np.arange(rows))
        return self.origin + (np.stack([j, i], -1) + 0.5) * CELL

    @property
    def free(self) -> Bool[np.ndarray, "headings rows columns"]:
        """Where the robot fits."""
        return self.gap > 0.0


def build_navigation_map(
    scene: Scene,
    robot: Robot,
    keep_out: tuple[Outline, ...] = (),
    held: HeldObject | None = None,
) -> NavigationMap:
    """Build the navigation map of a robot with its arm at home, cached.

    Args:
        scene: The scene.
        robot: The robot.
        keep_out: Areas that the base does not touch, see `BaseRegion`.
        held: What the robot holds; it is not where it is in the scene.

    Raises:
        SceneError: The scene is too large for a map.
    """
    return _navigation_map(robot, scene, keep_out, held)


@owner_cache(8)  # one takes about 1 MB; a question has a few versions of its scene
def _navigation_map(
    robot: Robot, scene: Scene, keep_out: tuple[Outline, ...], held: HeldObject | None
) -> NavigationMap:
    prisms = prisms_of(robot, held)
    obstacles = obstacles_of(scene if held is None else scene.without(held.name), prisms)
    if keep_out:
        # The base's outline at any height is one more prism, and only areas obstruct it.
        prisms = replace(prisms, outlines=(*prisms.outlines, robot.base_outline))
        obstacles = concatenate((obstacles, _closed(scene, keep_out, len(prisms.outlines) - 1)))
    return navigation_map_of(robot, prisms, obstacles, scene.floor_polygon)


def _closed(scene: Scene, keep_out: tuple[Outline, ...], layer: int) -> ConvexPolygons:
    """Return areas as obstacles of one prism."""
    parts = [
        (f"the keep-out {area_name(area, scene)}", part)
        for area in keep_out
        for part in convex_parts(np.array(area))
    ]
    names, polygons = zip(*parts, strict=True)
    return pack(polygons, [layer] * len(parts), names)


def navigation_map_of(
    robot: Robot,
    prisms: RobotPrisms,
    obstacles: ConvexPolygons,
    floor_polygon: Float[np.ndarray, "k 2"] | None,
) -> NavigationMap:
    """Build the navigation map of a robot among outlines, see `build_navigation_map`."""
    planning_obstacles = planning_outlines(obstacles, floor_polygon)
    if floor_polygon is not None:
        low, high = floor_polygon.min(0), floor_polygon.max(0)
    elif len(obstacles):
        low = obstacles.bounds[:, :2].min(0) - MAP_MARGIN
        high = obstacles.bounds[:, 2:].max(0) + MAP_MARGIN
    else:
        low, high = np.full(2, -MAP_MARGIN), np.full(2, MAP_MARGIN)
    origin = np.floor(low / CELL) * CELL
    columns, rows = (max(1, int(np.ceil(v))) for v in (high - origin) / CELL)
    if columns * rows > MAX_CELLS:
        width, depth = high - low
        raise SceneError(
            f"the scene is {width:.0f} m x {depth:.0f} m; a navigation map covers at most "
            f"{MAX_CELLS * CELL**2:.0f} m^2"
        )
    return NavigationMap(
        robot, prisms, obstacles, planning_obstacles, floor_polygon, origin, (rows, columns)
    )


def with_object_moved(nav_map: NavigationMap, name: str, outlines: ConvexPolygons) -> NavigationMap:
    """Update a map in which one object has changed its outlines.

    Outlines inside the object's old outlines are planning obstacles again, because they may be
    exposed now.

    Args:
        nav_map: The map before.
        name: Name of the object.
        outlines: New outlines of the object, for the prisms of the same robot.
    """
    every, planned = nav_map.obstacles, nav_map.planning_obstacles
    was = every.of_object(name)
    low, high = every.bounds[:, None, :2], every.bounds[:, None, 2:]
    above = (low >= every.bounds[was, :2] - _TOLERANCE).all(axis=2)
    within = above & (high <= every.bounds[was, 2:] + _TOLERANCE).all(axis=2)
    exposed = every.subset(np.any(within, axis=1) & ~was)
    added = planning_outlines(concatenate((exposed, outlines)), None)
    return replace(
        nav_map,
        obstacles=concatenate((every.subset(~was), outlines)),
        planning_obstacles=concatenate((planned.subset(~planned.of_object(name)), added)),
    )
