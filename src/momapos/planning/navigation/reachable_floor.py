"""Where a base can drive to, and how far at least: floods and lower bounds.

Each prism of the robot contains a disc around the base's origin. Where these discs cannot pass, no
path exists for the whole robot. A cell counts as passable unless no point in it is free, so the
fill never excludes a place that the robot can drive to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import inscribed_radius
from momapos.model.robots import Robot
from momapos.model.scene import Scene

from .convex_polygons import ConvexPolygons, RobotPrisms, obstacles_of, planning_outlines
from .cost_map import CELL, CostMap, FloorPlan, base_height, blocked_cells, clearance, path_lengths
from .footprint_map import NavigationMap
from .lattice import planned_radius
from .outline_gaps import gaps
from .reeds_shepp import shortest_lengths

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


COARSE = 0.1
"""Edge of the cells that are divided near obstacles [m]; their half diagonal is below the depth at
which gaps stop being exact, see `DEEP_GAP`."""
DIVISIONS = 3
"""Number of halvings of a cell near obstacles: down to 1.25 cm, so that a passage that is 2 cm too
narrow is found [-]."""
_DISC_CORNERS = 32
"""Corners of the polygon in a disc; it is 0.5 % narrower [-]."""
_MIN_RADIUS = 0.01
"""Prisms with a smaller disc are left out [m]."""
_ANY = np.ones((3, 3), bool)
"""Cells connect across edges and corners."""


@dataclass(frozen=True)
class Passage:
    """The narrowest place on the widest way to some base poses."""

    width: float
    """[m]"""
    between: tuple[str, ...]
    """The one or two objects next to it."""
    needed: float
    """Width of the robot's smallest cross-section [m]."""

    def __str__(self) -> str:
        """Return it in words."""
        sides = " and ".join(self.between)
        gap = f"{100 * self.width:.0f} cm"
        where = f"{gap} between {sides}" if len(self.between) > 1 else f"{gap} at {sides}"
        return f"{where}, and the robot needs {100 * self.needed:.0f} cm"


@dataclass(frozen=True, eq=False)
class ReachableFloor:
    """The places that the robot's smallest cross-section can reach from a start."""

    nav_map: NavigationMap
    start: tuple[float, float]
    """x, y [m]."""

    def contains(self, xy: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Return which positions may be reachable [m]; the others are not."""
        found = _reached(self.nav_map, self.start)
        i, j = found.cells.index(xy)
        return np.asarray(found.reached[i, j])

    def meets(self, corners: Float[np.ndarray, "2 2"]) -> bool:
        """Return whether some position in a rectangle may be reachable [m]."""
        found = _reached(self.nav_map, self.start)
        (i0, i1), (j0, j1) = found.cells.index(corners)
        return bool(found.reached[i0 : i1 + 1, j0 : j1 + 1].any())

    def centers(self, corners: Float[np.ndarray, "2 2"]) -> Float[np.ndarray, "n 2"]:
        """Return the centers of the cells in a rectangle [m]."""
        cells = _Cells.around(self.nav_map, CELL)
        (i0, i1), (j0, j1) = cells.index(corners)
        index = np.stack(np.meshgrid(np.arange(i0, i1 + 1), np.arange(j0, j1 + 1), indexing="ij"))
        return cells.center(index.reshape(2, -1))

    def passage(self, xy: Float[np.ndarray, "n 2"]) -> Passage | None:
        """Return the narrowest place on the widest way to any of some positions.

        It is for messages and exact to about a centimeter.

        Args:
            xy: Positions that are not reachable [m].

        Returns:
            The place; None if no way between the obstacles leads there, however narrow.
        """
        discs, obstacles = _discs(self.nav_map)
        points = RobotPrisms(
            tuple(_MIN_RADIUS / 10 * _circle() for _ in discs.outlines), discs.heights
        )
        cells = _Cells.around(self.nav_map, CELL)
        radius = discs.radius
        clear = gaps(cells.poses(), points, obstacles, cap=radius).reshape(cells.shape)
        start, goals = cells.index(np.array([self.start])), cells.index(xy)
        low, high = 0.0, radius
        if not _connected(clear > low, start, goals):
            return None
        while high - low > CELL / 20:
            middle = (low + high) / 2
            low, high = (
                (middle, high) if _connected(clear > middle, start, goals) else (low, middle)
            )
        place = _narrowest(clear, low, high, start, goals)
        return _passage(cells.center(place), obstacles, 2 * radius)


@dataclass(frozen=True, eq=False)
class _Cells:
    """Square cells around a navigation map, with a border of one cell."""

    origin: Float[np.ndarray, "2"]
    shape: tuple[int, int]
    edge: float

    @classmethod
    def around(cls, nav_map: NavigationMap, edge: float) -> _Cells:
        rows, columns = (math.ceil(n * CELL / edge) + 2 for n in nav_map.shape)
        return cls(nav_map.origin - edge, (rows, columns), edge)

    def index(self, xy: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "2 n"]:
        """Return the row and column of positions; those outside belong to the border."""
        j, i = np.floor((xy - self.origin) / self.edge).astype(int).T
        return np.stack([np.clip(i, 0, self.shape[0] - 1), np.clip(j, 0, self.shape[1] - 1)])

    def center(self, index: Int[np.ndarray, "2 *n"]) -> Float[np.ndarray, "*n 2"]:
        return self.origin + (np.stack([index[1], index[0]], -1) + 0.5) * self.edge

    def poses(self) -> Float[np.ndarray, "n 3"]:
        xy = self.center(np.indices(self.shape).reshape(2, -1))
        return np.column_stack([xy, np.zeros(len(xy))])


@dataclass(frozen=True, eq=False)
class _Reached:
    """Fine cells that are connected to the start."""

    cells: _Cells
    reached: Bool[np.ndarray, "rows columns"]


@owner_cache(4)
def _reached(nav_map: NavigationMap, start: tuple[float, float]) -> _Reached:
    from scipy import ndimage

    discs, obstacles = _discs(nav_map)
    cells, passable = _passable(nav_map, discs, obstacles)
    label, _ = ndimage.label(passable, structure=_ANY)
    i, j = cells.index(np.array([start]))[:, 0]
    return _Reached(cells, passable & (label == label[i, j]))


def _discs(nav_map: NavigationMap) -> tuple[RobotPrisms, ConvexPolygons]:
    """Return the discs in the prisms of a robot, and the obstacles of the prisms that have one."""
    radii = np.array([inscribed_radius(outline) for outline in nav_map.prisms.outlines])
    outlines = tuple(max(r, _MIN_RADIUS) * _circle() for r in radii)
    obstacles = nav_map.planning_obstacles
    return (
        replace(nav_map.prisms, outlines=outlines),
        obstacles.subset(radii[obstacles.layer] >= _MIN_RADIUS),
    )


def _circle() -> Float[np.ndarray, "k 2"]:
    angle = np.arange(_DISC_CORNERS) * 2 * np.pi / _DISC_CORNERS
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def _passable(
    nav_map: NavigationMap, discs: RobotPrisms, obstacles: ConvexPolygons
) -> tuple[_Cells, Bool[np.ndarray, "rows columns"]]:
    """Return fine cells, and which of them the discs may pass.

    A gap changes at most as much as the robot moves. So one at the center decides for a cell,
    unless its size is below the half diagonal; then the cell is divided.
    """
    coarse = _Cells.around(nav_map, COARSE)
    state = np.zeros(coarse.shape, np.int8)  # 1: free, -1: blocked, 0: divided further
    border = np.ones(coarse.shape, bool)
    border[1:-1, 1:-1] = False
    cells = coarse
    for level in range(DIVISIONS + 1):
        if level:
            state = np.repeat(np.repeat(state, 2, axis=0), 2, axis=1)
            shape = state.shape
            cells = _Cells(coarse.origin, (shape[0], shape[1]), coarse.edge / 2**level)
        index = np.stack(np.nonzero(state == 0))
        poses = np.column_stack([cells.center(index), np.zeros(index.shape[1])])
        slack = cells.edge / math.sqrt(2)
        found = gaps(poses, discs, obstacles, cap=2 * slack)
        certain = found > slack if level < DIVISIONS else found > -slack
        state[tuple(index)] = np.where(certain, 1, np.where(found <= -slack, -1, 0))
        if not level:
            state[border] = 1  # a path may leave the map
    return cells, state > 0


def _connected(
    free: Bool[np.ndarray, "rows columns"],
    start: Int[np.ndarray, "2 1"],
    goals: Int[np.ndarray, "2 n"],
) -> bool:
    label = _labels(free, start)
    return bool((label[tuple(goals)] == label[tuple(start)][0]).any())


def _labels(
    free: Bool[np.ndarray, "rows columns"], start: Int[np.ndarray, "2 1"]
) -> Int[np.ndarray, "rows columns"]:
    """Return the connected parts; blocked cells are -1."""
    from scipy import ndimage

    free = free.copy()
    free[tuple(start)] = True
    label, _ = ndimage.label(free, structure=_ANY)
    return np.where(free, label, -1)


def _narrowest(
    clear: Float[np.ndarray, "rows columns"],
    low: float,
    high: float,
    start: Int[np.ndarray, "2 1"],
    goals: Int[np.ndarray, "2 n"],
) -> Int[np.ndarray, "2"]:
    """Return the cell between the part of the start and that of the goals.

    Args:
        clear: Distance to the nearest obstacle [m].
        low: Distance above which the parts are connected [m].
        high: Distance above which they are not [m].
        start: Cell of the start.
        goals: Cells of the goals.
    """
    from scipy import ndimage

    joined, apart = _labels(clear > low, start), _labels(clear > high, start)
    whole = joined == joined[tuple(start)][0]
    near = apart == apart[tuple(start)][0]
    ends = goals[:, whole[tuple(goals)]]
    beyond = np.isin(apart, np.setdiff1d(apart[tuple(ends)], [-1])) & ~near
    beyond[tuple(ends)] = True
    far = ndimage.distance_transform_edt(~near) + ndimage.distance_transform_edt(~beyond)
    return np.array(np.unravel_index(np.argmin(np.where(whole & ~near, far, np.inf)), far.shape))


def _passage(xy: Float[np.ndarray, "2"], obstacles: ConvexPolygons, needed: float) -> Passage:
    """Return the passage at a position between the obstacles next to it."""
    side = obstacles.normal @ xy - obstacles.level
    away = np.maximum.reduceat(side, obstacles.first[:-1])
    box = obstacles.bounds
    past = np.maximum(np.maximum(box[:, :2] - xy, xy - box[:, 2:]), 0.0)
    away = np.maximum(away, np.hypot(past[:, 0], past[:, 1]))
    order = np.argsort(away, kind="stable")
    first = int(order[0])
    middle = (box[:, :2] + box[:, 2:]) / 2
    nearest = np.clip(xy, box[:, :2], box[:, 2:])  # of each bounding box
    toward = nearest - xy
    flat = np.hypot(toward[:, 0], toward[:, 1]) < 1e-9
    toward[flat] = (middle - xy)[flat]
    others = [int(k) for k in order[1:] if toward[k] @ toward[first] < 0]
    names = [obstacles.names[k].partition("/")[0] for k in (first, *others[:1])]
    width = away[first] + (away[others[0]] if others else away[first])
    return Passage(float(width), tuple(dict.fromkeys(names)), needed)


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
