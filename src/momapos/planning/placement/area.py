"""Compute the free area A: the base is collision-free and the arm is long enough for all waypoints.

Source: MoMa-Pos, section III-C.

What stands still is remembered on a grid: questions for other values of the same joint, and for
other grasps, use the same grid: only the moving part and the arm's reach differ.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.compiled import F1, F2, entry
from momapos.core.geometry import all_inside, local_points, place_points
from momapos.model.collision import FREE, base_hits
from momapos.model.robots import Robot
from momapos.model.urdf import Boxes

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Bool, Float, Int

    StandingCodes = Callable[[Int[np.ndarray, " k"]], Int[np.ndarray, " k"]]

OFF_FLOOR: int = FREE - 1
"""Code of a base pose that is not on the floor; other codes are boxes or FREE."""


class BaseStatus(IntEnum):
    """Whether the base can stand at a pose."""

    CLEAR = 0
    BLOCKED = 1
    OFF_FLOOR = 2
    BEYOND_ARM = 3


@dataclass(frozen=True, eq=False)
class PlacementGeometry:
    """The geometry of a scene and a task, without objects and joints."""

    robot: Robot
    Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    """Tool poses of every grasp at every waypoint."""
    static: Boxes
    """Boxes of everything that does not move."""
    sweep: Boxes
    """Boxes of the moving part at every opening value."""
    floor_polygon: Float[np.ndarray, "k 2"] | None
    clearance: float
    """Minimum distance of the base to all boxes [m]."""

    @cached_property
    def boxes(self) -> Boxes:
        """All boxes, the static ones first."""
        return Boxes.join([self.static, self.sweep])

    @cached_property
    def shoulder(self) -> Float[np.ndarray, "3"]:
        """The arm's first revolute axis at mid-height of its range, base frame [m]."""
        chain = self.robot.chain
        first = chain.first_turn
        return chain.d[: first + 1].sum(0) + chain.middle[:first] @ chain.h[:first]

    @property
    def lift(self) -> float:
        """Half the vertical travel (torso) before that axis [m]."""
        return self._travel(upright=True)

    @property
    def telescope(self) -> float:
        """Half the horizontal travel before that axis [m]."""
        return self._travel(upright=False)

    def _travel(self, *, upright: bool) -> float:
        chain = self.robot.chain
        first = chain.first_turn
        along = (np.abs(chain.h[:first, 2]) > 0.5) == upright
        return float(chain.half_travel[:first][along].sum())


@owner_cache()
def arm_radius(geometry: PlacementGeometry) -> Float[np.ndarray, " w"]:
    """Return the horizontal reach Delta_r at each waypoint's height; NaN if it is out of reach [m].

    Source: MoMa-Pos, section III-C, `sqrt(r_l^2 - dz^2)`, plus the spread of the grasps.
    """
    plain = geometry.Ts_world_tool[0, :, :3, 3]
    spread = np.linalg.norm(geometry.Ts_world_tool[..., :3, 3] - plain, axis=-1).max(0)
    reach = geometry.robot.reach + geometry.telescope + spread
    dz = np.maximum(np.abs(plain[:, 2] - geometry.shoulder[2]) - geometry.lift, 0.0)
    with np.errstate(invalid="ignore"):
        return np.sqrt(reach**2 - dz**2)


def task_frame(geometry: PlacementGeometry) -> Float[np.ndarray, "3"]:
    """Return a floor frame at the grasp, x along the approach: x [m], y [m], yaw [rad].

    Samples and grids are laid out in this frame, so that results move with the scene.
    """
    T = geometry.Ts_world_tool[0, 1]
    along = T[:2, :3] @ geometry.robot.approach_axis
    if np.hypot(*along) < 0.1:  # the hand comes from above: use the closing direction
        along = T[:2, :3] @ geometry.robot.closing_axis
    return np.array([T[0, 3], T[1, 3], np.arctan2(along[1], along[0])])


def sampling_box(geometry: PlacementGeometry) -> Float[np.ndarray, "2 2"] | None:
    """Return corners of a rectangle in the task frame that contains A [m]; None if A is empty."""
    radius = arm_radius(geometry)
    if np.isnan(radius).any():
        return None
    reach = radius + np.linalg.norm(geometry.shoulder[:2])
    plain = local_points(task_frame(geometry), geometry.Ts_world_tool[0, :, :2, 3])
    low = (plain - reach[:, None]).max(0)
    high = (plain + reach[:, None]).min(0)
    return None if (low >= high).any() else np.stack([low, high])


def reachable_rectangle(geometry: PlacementGeometry) -> Float[np.ndarray, "2 2"] | None:
    """Return the world rectangle that contains all bases within reach of all waypoints [m]."""
    reach = (arm_radius(geometry) + np.linalg.norm(geometry.shoulder[:2]))[:, None]
    targets = geometry.Ts_world_tool[0, :, :2, 3]
    low, high = (targets - reach).max(0), (targets + reach).min(0)
    # If a waypoint is out of reach at any distance, its radius is NaN and the comparison False.
    return np.stack([low, high]) if (low < high).all() else None


@entry
def _within_reach(poses: F2, shoulder: F1, targets: F2, radius: F1) -> np.ndarray:
    """See `within_reach`."""
    out, last = np.empty(len(poses), np.bool_), len(targets) - 1
    for i in range(len(poses)):
        c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        x = poses[i, 0] + c * shoulder[0] - s * shoulder[1]
        y = poses[i, 1] + s * shoulder[0] + c * shoulder[1]
        out[i] = True
        for k in range(-1, last):
            # The last waypoint and the first exclude most poses.
            w = last if k < 0 else k
            if not (x - targets[w, 0]) ** 2 + (y - targets[w, 1]) ** 2 <= radius[w] ** 2:
                out[i] = False
                break
    return out


def within_reach(
    geometry: PlacementGeometry, poses: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """Check that all waypoints are within reach of the arm's axis (dist_xy <= Delta_r)."""
    targets = np.ascontiguousarray(geometry.Ts_world_tool[0, :, :2, 3])
    return _within_reach(
        np.ascontiguousarray(poses, float), geometry.shoulder, targets, arm_radius(geometry)
    )


def clears_sweep(
    geometry: PlacementGeometry, poses: Float[np.ndarray, "n 3"], clearance: float
) -> Bool[np.ndarray, " n"]:
    """Check that the moving part keeps a clearance [m] to the base at every opening value."""
    return base_hits(poses, geometry.robot.base, geometry.sweep, clearance=clearance) == FREE


def base_pose_status(
    geometry: PlacementGeometry,
    poses: Float[np.ndarray, "n 3"],
    stands: StandingCodes | None = None,
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Check whether the base can stand at each pose while the part moves.

    Args:
        geometry: The scene and the task.
        poses: Base poses (x [m], y [m], yaw [rad]).
        stands: Returns `standing_codes` of some of the poses, given their rows, if they are known
            from other tasks; None to compute them.

    Returns:
        A `BaseStatus`, and the index of the blocking box in `geometry.boxes`, or FREE.
    """
    outcome = np.where(within_reach(geometry, poses), BaseStatus.CLEAR, BaseStatus.BEYOND_ARM)
    code = np.full(len(poses), FREE, np.int64)
    near = np.flatnonzero(outcome == BaseStatus.CLEAR)
    known = standing_codes(geometry, poses[near]) if stands is None else stands(near)
    outcome[near[known == OFF_FLOOR]] = BaseStatus.OFF_FLOOR
    code[near] = np.where(known == OFF_FLOOR, FREE, known)
    near = near[known == FREE]
    hit = base_hits(poses[near], geometry.robot.base, geometry.sweep, clearance=geometry.clearance)
    code[near] = np.where(hit == FREE, FREE, hit + len(geometry.static))
    outcome[code != FREE] = BaseStatus.BLOCKED
    return outcome, code


def standing_codes(
    geometry: PlacementGeometry, poses: Float[np.ndarray, "n 3"]
) -> Int[np.ndarray, " n"]:
    """Return which box that does not move the base hits at each pose, FREE, or OFF_FLOOR."""
    code = np.full(len(poses), FREE, np.int64)
    if geometry.floor_polygon is not None:
        outlines = place_points(poses, geometry.robot.footprint)
        code[~all_inside(geometry.floor_polygon, outlines)] = OFF_FLOOR
    rows = np.flatnonzero(code == FREE)
    code[rows] = base_hits(
        poses[rows], geometry.robot.base, geometry.static, clearance=geometry.clearance
    )
    return code


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
    step = np.array([cell, cell, np.radians(turn)])

    def stands(rows: Int[np.ndarray, " k"]) -> Int[np.ndarray, " k"]:
        index = np.rint((local[rows] - [0.0, 0.0, -np.pi]) / step).astype(np.int64)
        at = tuple((index + _grow(table, index)).T)
        codes = table.codes[at]
        unknown = codes == _UNKNOWN
        codes[unknown] = standing_codes(geometry, poses[rows[unknown]])
        table.codes[at] = codes
        return codes.astype(np.int64)

    return stands


def _grow(table: _Table, index: Int[np.ndarray, "n 3"]) -> Int[np.ndarray, "3"]:
    """Make room for cells of a grid; return the cell of the frame's origin."""
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
