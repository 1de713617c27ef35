"""A cost map of driving distances from the start, over the cells of a floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageDraw

from momapos.core.compiled import B2, F1, I1, I2, entry
from momapos.core.geometry import convex_hull
from momapos.model.records import Outline
from momapos.model.robots import Robot
from momapos.model.urdf import Boxes

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


_QUADRANT = ((1, 0), (1, 1), (2, 1), (1, 2))
_MOVES = np.array([m for a, b in _QUADRANT for m in ((a, b), (-b, a), (-a, -b), (b, -a))])
"""Steps (rows, columns) to sixteen neighbors of a cell: lengths are at most 2.7 % too long."""
_LENGTHS: np.ndarray = np.hypot(_MOVES[:, 0], _MOVES[:, 1])


def clearance(
    blocked: Bool[np.ndarray, "rows columns"], *, cap: float = np.inf
) -> Float[np.ndarray, "rows columns"]:
    """Compute the distance between the centers of each cell and the nearest blocked cell [cells].

    Args:
        blocked: Which cells are blocked; without any, distances are infinite.
        cap: Upper bound of the distances [cells].
    """
    return _clearance(np.ascontiguousarray(blocked), float(cap))


def path_lengths(
    free: Bool[np.ndarray, "rows columns"], sources: Int[np.ndarray, " s"], cell: float
) -> Float[np.ndarray, "rows columns"]:
    """Compute the length of the shortest path over free cells from the nearest source to each cell.

    Args:
        free: Which cells are free.
        sources: Flat indices of free cells.
        cell: Edge of a cell [m].

    Returns:
        Lengths [m], infinite without a path.
    """
    sources = np.ascontiguousarray(sources, np.int64)
    return _path_lengths(np.ascontiguousarray(free), sources, _MOVES, cell * _LENGTHS)


@entry
def _clearance(blocked: B2, most: float) -> np.ndarray:
    """Compute the exact Euclidean distance transform: along the columns, then along the rows."""
    rows, columns = blocked.shape
    out = np.full((rows, columns), np.inf)
    for j in range(columns):
        last = np.inf
        for i in range(rows):
            last = 0.0 if blocked[i, j] else last + 1
            out[i, j] = last
        for i in range(rows - 2, -1, -1):
            out[i, j] = min(out[i, j], out[i + 1, j] + 1)
    line = np.empty(columns)
    for i in range(rows):
        for j in range(columns):
            line[j] = out[i, j]
        for j in range(columns):
            best = min(line[j], most) ** 2
            for d in range(1, columns):
                if d * d >= best:
                    break
                if j - d >= 0:
                    best = min(best, line[j - d] ** 2 + d * d)
                if j + d < columns:
                    best = min(best, line[j + d] ** 2 + d * d)
            out[i, j] = np.sqrt(best)
    return out


@entry
def _path_lengths(free: B2, sources: I1, moves: I2, lengths: F1) -> np.ndarray:
    """Run Dijkstra's algorithm (1959) with two unsorted lists as queue (Davidson et al. 2014).

    Cells below a bound are processed in any order, the others wait; then the bound rises by the
    shortest step. A cell whose length decreases is processed again, so the lengths equal those of
    a sorted queue to the last bit.
    """
    rows, columns = free.shape
    out, taken = np.full((rows, columns), np.inf), np.full((rows, columns), np.inf)
    step = lengths.min()
    bound = step
    near, far = [np.int64(-1)], [np.int64(-1)]
    for source in sources:
        out[source // columns, source % columns] = 0.0
        near.append(source)
    while True:
        while near[-1] >= 0:
            cell = near.pop()
            i, j = cell // columns, cell % columns
            length = out[i, j]
            if length == taken[i, j]:
                continue
            taken[i, j] = length
            for k in range(len(moves)):
                a, b = i + moves[k, 0], j + moves[k, 1]
                if a < 0 or b < 0 or a >= rows or b >= columns or not free[a, b]:
                    continue
                if length + lengths[k] < out[a, b]:
                    out[a, b] = length + lengths[k]
                    (near if out[a, b] < bound else far).append(a * columns + b)
        if len(far) == 1:
            return out
        bound += step
        waiting, far = far, [np.int64(-1)]
        for cell in waiting[1:]:
            length = out[cell // columns, cell % columns]
            if length < taken[cell // columns, cell % columns]:
                (near if length < bound else far).append(cell)


CELL = 0.05
"""Edge of a cell [m]."""
MAP_MARGIN = 2.0
"""Width of the free border around a scene without a known floor [m]."""
_NEIGHBORS = np.array([(dj, di) for di in (-1, 0, 1) for dj in (-1, 0, 1)])
"""Steps (columns, rows) to a cell and its neighbors."""
_MAX_EXTENSION = 10.0
"""Largest extension of the map toward a start outside it [m]."""


_NEAR = 0.25
"""Largest distance of a base pose next to furniture from a place with more clearance [m]."""


@dataclass(frozen=True, eq=False)
class CostMap:
    """Geodesic distance from the start to every cell, for a disc inscribed in the base."""

    origin: Float[np.ndarray, "2"]
    """World position of the corner of cell (0, 0) [m]."""
    distance: Float[np.ndarray, "rows columns"]
    """Driving length to the center of each cell [m], infinite without a path."""
    free: Bool[np.ndarray, "rows columns"]
    wide: Bool[np.ndarray, "rows columns"]
    """Cells where the disc fits with a cell to spare, so that the grid does not decide."""

    def lengths(self, places: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
        """Return the driving lengths to positions or base poses [m], infinite without a path.

        The best of the neighboring cells counts, because a base can stand closer to furniture than
        a cell center that the disc can reach.
        """
        rows, columns = self.distance.shape
        x, y = np.ascontiguousarray(places.T[:2], float)
        j = np.floor((x - self.origin[0]) / CELL).astype(int) + _NEIGHBORS[:, :1]
        i = np.floor((y - self.origin[1]) / CELL).astype(int) + _NEIGHBORS[:, 1:]
        dx = self.origin[0] + (j + 0.5) * CELL - x
        dy = self.origin[1] + (i + 0.5) * CELL - y
        # Positions off the map are clipped to its border.
        value = self._bordered[np.clip(i + 1, 0, rows + 1), np.clip(j + 1, 0, columns + 1)]
        return (value + np.sqrt(dx * dx + dy * dy)).min(axis=0)

    def is_plainly_reached(self, xy: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Return which positions are next to cells that wide passages connect to the start."""
        rows, columns = self.distance.shape
        j, i = np.floor((xy - self.origin) / CELL).astype(int).T
        near = self._near_wide[np.clip(i, 0, rows - 1), np.clip(j, 0, columns - 1)]
        return np.asarray(near)

    def is_rectangle_plainly_reached(self, corners: Float[np.ndarray, "2 2"]) -> bool:
        """Return whether some position in a rectangle is plainly reached."""
        rows, columns = self.distance.shape
        low, high = np.floor((corners - self.origin) / CELL).astype(int)
        low, high = np.clip([low, high + 1], 0, [columns, rows])
        return bool(self._near_wide[low[1] : high[1], low[0] : high[0]].any())

    @cached_property
    def _near_wide(self) -> Bool[np.ndarray, "rows columns"]:
        sources = np.flatnonzero(self.wide & (self.distance <= self.distance.min() + _NEAR))
        reached = np.isfinite(path_lengths(self.wide, sources, CELL))
        return clearance(reached, cap=_NEAR / CELL + 1.0) * CELL <= _NEAR

    @cached_property
    def _bordered(self) -> Float[np.ndarray, "rows_and_2 columns_and_2"]:
        """The distances with a border of unreachable cells [m]."""
        return np.pad(self.distance, 1, constant_values=np.inf)


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """Cells that are occupied or not on the floor."""

    origin: Float[np.ndarray, "2"]
    blocked: Bool[np.ndarray, "rows columns"]


def base_height(robot: Robot) -> float:
    """Return the height of the base, up to which objects obstruct it [m]."""
    return float((robot.base.center + robot.base.half)[:, 2].max(initial=0.3))


def floor_plan(
    boxes: Boxes,
    *,
    height: float,
    floor_polygon: Float[np.ndarray, "k 2"] | None,
    margin: float = MAP_MARGIN,
    start: Float[np.ndarray, "2"] | None = None,
    keep_out: Sequence[Outline] = (),
) -> FloorPlan:
    """Project the obstacles of a base onto the floor.

    Args:
        boxes: Boxes of the scene, world frame.
        height: Height of the base; boxes above it are no obstacles [m].
        floor_polygon: Outline of the floor; None if unknown.
        margin: Width of the free border around the mapped area [m].
        start: Start position, to which the map is extended if the floor is unknown [m].
        keep_out: Areas that the base does not touch.
    """
    low_z = boxes.center[:, 2] - np.einsum("bj,bj->b", np.abs(boxes.rotation[:, 2]), boxes.half)
    outlines = [*_outlines(boxes, np.flatnonzero(low_z < height)), *map(np.array, keep_out)]
    return blocked_cells(outlines, floor_polygon=floor_polygon, margin=margin, start=start)


def blocked_cells(
    outlines: Sequence[Float[np.ndarray, "_ 2"]],
    *,
    floor_polygon: Float[np.ndarray, "k 2"] | None,
    margin: float = MAP_MARGIN,
    start: Float[np.ndarray, "2"] | None = None,
) -> FloorPlan:
    """Draw the outlines of obstacles into cells; see `floor_plan`."""
    points = np.concatenate(outlines) if outlines else np.zeros((1, 2))
    if floor_polygon is not None:
        points = floor_polygon
    low, high = points.min(0) - margin, points.max(0) + margin
    if start is not None and floor_polygon is None:
        low = np.minimum(low, np.maximum(start - CELL, low - _MAX_EXTENSION))
        high = np.maximum(high, np.minimum(start + CELL, high + _MAX_EXTENSION))
    low = np.floor(low / CELL) * CELL
    columns, rows = (int(np.ceil(v)) for v in (high - low) / CELL)
    image = Image.new("L", (columns, rows), 0 if floor_polygon is None else 1)
    draw = ImageDraw.Draw(image)

    def fill(outline: Float[np.ndarray, "k 2"], value: int) -> None:
        draw.polygon((((outline - low) / CELL) - 0.5).ravel().tolist(), fill=value)

    if floor_polygon is not None:
        fill(floor_polygon, 0)
    for outline in outlines:
        fill(outline, 1)
    return FloorPlan(low, np.array(image, bool))


def _outlines(boxes: Boxes, which: Int[np.ndarray, " k"]) -> list[Float[np.ndarray, "_ 2"]]:
    """Project boxes onto the floor, as convex polygons."""
    R, h, c = boxes.rotation[which], boxes.half[which], boxes.center[which, :2]
    if not len(which):
        return []
    up = np.argmax(np.abs(R[:, 2]), axis=1)
    upright = np.abs(R[np.arange(len(up)), 2, up]) > 1 - 1e-9
    sides = np.stack([(up + 1) % 3, (up + 2) % 3], -1)
    edges = np.take_along_axis(R[:, :2] * h[:, None], sides[:, None], axis=2)
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    rectangles = c[:, None] + np.einsum("bij,kj->bki", edges, signs)
    found = list(rectangles[upright])
    if upright.all():
        return found
    cube = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    for b in np.flatnonzero(~upright):
        corners = c[b] + (cube * h[b]) @ R[b, :2].T
        found.append(convex_hull(corners))
    return found


def build_cost_map(plan: FloorPlan, start: Float[np.ndarray, "2"], *, radius: float) -> CostMap:
    """Compute the driving lengths from a start.

    Args:
        plan: The blocked cells.
        start: Position of the base [m]; from outside the map, the path to it is straight.
        radius: Radius of the base's inscribed circle [m].
    """
    rows, columns = plan.blocked.shape
    clear = clearance(plan.blocked, cap=radius / CELL + 2.0) * CELL
    free, wide = clear > radius, clear > radius + CELL
    j, i = np.clip(((start - plan.origin) / CELL).astype(int), 0, [columns - 1, rows - 1])
    free[i, j] = True
    distance = path_lengths(free, np.array([i * columns + j]), CELL)
    edge = plan.origin + np.array([columns, rows]) * CELL
    beyond = float(np.linalg.norm(start - np.clip(start, plan.origin, edge)))
    return CostMap(plan.origin, distance + beyond, free, wide)
