"""Remember at which poses of a grid the base stands clear of everything that does not move.

Questions for other values of the same joint, and for other grasps, use the same grid: only the
moving part and the arm's reach differ.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from .area import OFF_FLOOR, PlacementGeometry, standing_codes, task_frame

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from .area import StandingCodes

_UNKNOWN = OFF_FLOOR - 1
_TABLES = 8
"""Number of grids that are remembered; one takes 0.3 MB [-]."""


@dataclass(eq=False)
class _Table:
    """The codes of the poses of one grid, as far as they are known."""

    codes: Int[np.ndarray, "x y yaw"] = field(default_factory=lambda: np.zeros((0, 0, 0), np.int32))


def grid_standing(
    geometry: PlacementGeometry,
    poses: Float[np.ndarray, "n 3"],
    local: Float[np.ndarray, "n 3"],
    cell: float,
    turn: float,
) -> StandingCodes:
    """Return a function that returns the standing codes of some poses of a grid.

    Args:
        geometry: The scene and the task.
        poses: The grid's base poses (x [m], y [m], yaw [rad]).
        local: The same in the task frame: whole multiples of the cell, and of the turn from -pi.
        cell: Cell size [m].
        turn: Yaw step [deg].
    """
    table = _table(*_key(geometry), cell, turn)
    steps = (local - [0.0, 0.0, -np.pi]) / [cell, cell, np.radians(turn)]
    index = np.rint(steps).astype(np.int64)

    def stands(rows: Int[np.ndarray, " k"]) -> Int[np.ndarray, " k"]:
        middle = _grow(table, index)
        at = tuple((index[rows] + middle).T)
        codes = table.codes[at]
        unknown = codes == _UNKNOWN
        codes[unknown] = standing_codes(geometry, poses[rows[unknown]])
        table.codes[at] = codes
        return codes.astype(np.int64)

    return stands


def _grow(table: _Table, index: Int[np.ndarray, "n 3"]) -> Int[np.ndarray, "3"]:
    """Make room for all cells of a grid; return the cell of the frame's origin."""
    most = np.abs(index).max(0, initial=0)
    most[:2] = most[:2].max()
    old = np.array(table.codes.shape)
    size = np.maximum(old, [2 * most[0] + 1, 2 * most[1] + 1, most[2] + 1])
    if (size > old).any():
        codes = np.full(size, _UNKNOWN, np.int32)
        shift = (size - old) // 2 * [1, 1, 0]
        codes[tuple(map(slice, shift, shift + old))] = table.codes
        table.codes = codes
    return size // 2 * [1, 1, 0]


@lru_cache(maxsize=_TABLES)
def _table(*_: object) -> _Table:
    return _Table()


def _key(geometry: PlacementGeometry) -> tuple[object, ...]:
    """Return everything that the standing codes of a grid depend on."""
    robot, static, polygon = geometry.robot, geometry.static, geometry.floor_polygon
    arrays = (
        task_frame(geometry), robot.footprint, robot.base.center, robot.base.rotation,
        robot.base.half, static.center, static.rotation, static.half,
    )  # fmt: skip
    bounds = None if polygon is None else polygon.tobytes()
    return (*(array.tobytes() for array in arrays), bounds, geometry.clearance)
