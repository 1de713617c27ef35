"""Which poses of the real, turning footprint are free, for all cells and headings of a room."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from momapos.errors import SceneError
from momapos.geometry.polygons import contains, inscribed_radius
from momapos.navigation.clearance import gap, select
from momapos.navigation.cost_map import CELL
from momapos.navigation.outlines import Body, Outlines, body_of, obstacles_of, thinned
from momapos.robots.robot import Robot
from momapos.scene.scene import Scene

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32

_QUADRANT = ((1, 0), (3, 1), (2, 1), (3, 2), (1, 1), (2, 3), (1, 2), (1, 3))
MOVES = np.array([(a, b) for a, b in _QUADRANT] + [(-b, a) for a, b in _QUADRANT])
MOVES = np.concatenate([MOVES, -MOVES])
"""Steps (columns, rows) along each heading, anticlockwise from x."""
HEADINGS = np.arctan2(MOVES[:, 1], MOVES[:, 0])
"""The 32 headings of the map, those along which cells lie [rad]."""
FARTHEST = 0.2
"""Gaps are told apart up to this [m]."""
BORDER = 2.0
"""Free border that is mapped around a room without a known floor [m]."""
MOST_CELLS = 1_000_000


@dataclass(frozen=True, eq=False)
class Ground:
    """All that driving knows of one robot in one room."""

    robot: Robot
    body: Body
    obstacles: Outlines
    """Everything in the way, hull by hull."""
    things: Outlines
    """The same without what lies inside other outlines, and with the floor's edges."""
    floor: Float[np.ndarray, "k 2"] | None
    origin: Float[np.ndarray, "2"]
    """World position of the corner of cell (0, 0) [m]."""
    gap: Float32[np.ndarray, "headings rows columns"]
    """Gap around the robot at the centre of each cell [m], at most FARTHEST; negative where it
    does not fit."""

    @property
    def free(self) -> Bool[np.ndarray, "headings rows columns"]:
        """Where the robot fits."""
        return self.gap > 0.0


def survey(scene: Scene, robot: Robot) -> Ground:
    """Map where a robot with its arm at home fits.

    Raises:
        SceneError: The room is too large to be mapped.
    """
    body = body_of(robot)
    obstacles = obstacles_of(scene, body)
    return ground_of(robot, body, obstacles, scene.floor)


def ground_of(
    robot: Robot, body: Body, obstacles: Outlines, floor: Float[np.ndarray, "k 2"] | None
) -> Ground:
    """Map where a robot fits among outlines; see `survey`."""
    things = thinned(obstacles, floor)
    if floor is not None:
        low, high = floor.min(0), floor.max(0)
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
    j, i = np.meshgrid(np.arange(columns), np.arange(rows))
    centers = origin + (np.stack([j, i], -1) + 0.5) * CELL
    inside = np.ones((rows, columns), bool)
    if floor is not None:
        inside = contains(floor, centers.reshape(-1, 2)).reshape(rows, columns)
    inner = inscribed_radius(body.outlines[0])
    values = _fill(centers, inside, HEADINGS, inner, body.arrays, things.arrays)
    return Ground(robot, body, obstacles, things, floor, origin, values)


@njit(cache=True, nogil=True)
def _fill(centers, inside, headings, inner, body, things):
    rows, columns = inside.shape
    box = things[5]
    out = np.empty((len(headings), rows, columns), np.float32)
    near, work = np.empty(len(box), np.int64), np.empty((len(body[0]), 5))
    for i in range(rows):
        for j in range(columns):
            x, y = centers[i, j, 0], centers[i, j, 1]
            count = select(x, y, body[4] + FARTHEST, box, near)
            for h in range(len(headings)):
                if not inside[i, j]:
                    out[h, i, j] = -inner
                elif count == 0:
                    out[h, i, j] = FARTHEST
                else:
                    out[h, i, j] = gap(x, y, headings[h], body, things, near, count, FARTHEST, work)
    return out
