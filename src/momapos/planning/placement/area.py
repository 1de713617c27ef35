"""The free area A: where the base stands clear and every waypoint is within the arm's length."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import all_inside, local_points, place_points
from momapos.model.collision import FREE, base_hits
from momapos.model.robots import Robot
from momapos.model.urdf import Boxes

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


class BaseStatus(IntEnum):
    """Whether the base can stand at a pose."""

    CLEAR = 0
    BLOCKED = 1
    OFF_FLOOR = 2
    BEYOND_ARM = 3


@dataclass(frozen=True)
class PlacementGeometry:
    """What placement knows of the room and the task: no objects, no joints, only geometry."""

    robot: Robot
    Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    """Tool poses of every grasp at every waypoint."""
    static: Boxes
    """Boxes that stand still."""
    sweep: Boxes
    """The moving part at every opening."""
    floor_polygon: Float[np.ndarray, "k 2"] | None
    clearance: float
    """Distance that the base keeps from everything [m]."""

    @cached_property
    def boxes(self) -> Boxes:
        """All boxes, those that stand still first."""
        static, sweep = self.static, self.sweep
        return Boxes(
            np.concatenate([static.center, sweep.center]),
            np.concatenate([static.rotation, sweep.rotation]),
            np.concatenate([static.half, sweep.half]),
        )

    @property
    def shoulder(self) -> Float[np.ndarray, "3"]:
        """Where the arm's first turning axis meets its height range's middle, base frame [m]."""
        chain = self.robot.chain
        first = chain.first_turn
        return chain.d[: first + 1].sum(0) + chain.middle[:first] @ chain.h[:first]

    @property
    def lift(self) -> float:
        """Half the travel of a torso before that axis [m]."""
        return self._travel(upright=True)

    @property
    def telescope(self) -> float:
        """Half the travel of what slides along the floor before that axis [m]."""
        return self._travel(upright=False)

    def _travel(self, *, upright: bool) -> float:
        """Half the travel of what slides upwards, or along the floor, before that axis [m]."""
        chain = self.robot.chain
        first = chain.first_turn
        along = (np.abs(chain.h[:first, 2]) > 0.5) == upright
        return float(chain.half_travel[:first][along].sum())


def arm_radius(geometry: PlacementGeometry) -> Float[np.ndarray, " w"]:
    """Horizontal reach Delta_r at the height of each waypoint, NaN where it is out of reach.

    Source: MoMa-Pos, section III-C, `sqrt(r_l^2 - dz^2)`; the family of grasps widens it.
    """
    plain = geometry.Ts_world_tool[0, :, :3, 3]
    spread = np.linalg.norm(geometry.Ts_world_tool[..., :3, 3] - plain, axis=-1).max(0)
    reach = geometry.robot.reach + geometry.telescope + spread
    dz = np.maximum(np.abs(plain[:, 2] - geometry.shoulder[2]) - geometry.lift, 0.0)
    with np.errstate(invalid="ignore"):
        return np.sqrt(reach**2 - dz**2)


def task_frame(geometry: PlacementGeometry) -> Float[np.ndarray, "3"]:
    """A frame on the floor at the first waypoint, x along the approach: x [m], y [m], yaw [rad].

    Samples and grids are laid out in it, so that an answer moves with the room.
    """
    T = geometry.Ts_world_tool[0, 1]
    along = T[:2, :3] @ geometry.robot.approach_axis
    if np.hypot(*along) < 0.1:  # from straight above: take how the fingers close
        along = T[:2, :3] @ geometry.robot.closing_axis
    return np.array([T[0, 3], T[1, 3], np.arctan2(along[1], along[0])])


def sampling_box(geometry: PlacementGeometry) -> Float[np.ndarray, "2 2"] | None:
    """Corners of the rectangle in the task's frame that holds A; None where A is empty [m]."""
    radius = arm_radius(geometry)
    if np.isnan(radius).any():
        return None
    reach = radius + np.linalg.norm(geometry.shoulder[:2])
    plain = local_points(task_frame(geometry), geometry.Ts_world_tool[0, :, :2, 3])
    low = (plain - reach[:, None]).max(0)
    high = (plain + reach[:, None]).min(0)
    return None if (low >= high).any() else np.stack([low, high])


def reachable_rectangle(geometry: PlacementGeometry) -> Float[np.ndarray, "2 2"] | None:
    """The floor rectangle that holds every base within the arm's length of all waypoints [m]."""
    reach = (arm_radius(geometry) + np.linalg.norm(geometry.shoulder[:2]))[:, None]
    targets = geometry.Ts_world_tool[0, :, :2, 3]
    low, high = (targets - reach).max(0), (targets + reach).min(0)
    # NaN where a waypoint is out of reach at any distance: the comparison is then False.
    return np.stack([low, high]) if (low < high).all() else None


def within_reach(
    geometry: PlacementGeometry, poses: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """Whether every waypoint is within the arm's length of its axis (dist_xy <= Delta_r)."""
    x, y = geometry.shoulder[:2]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    axis_x, axis_y = poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y
    targets, radius = geometry.Ts_world_tool[0, :, :2, 3], arm_radius(geometry)
    left = np.arange(len(poses))
    # The ends of the motion rule most poses out. Waypoints go along the rows: few, and long.
    for some in ([0], [-1], slice(1, -1)):
        away_x = axis_x[left] - targets[some, :1]
        away_y = axis_y[left] - targets[some, 1:]
        away_x *= away_x
        away_y *= away_y
        away_x += away_y
        left = left[(away_x <= radius[some, None] ** 2).all(0)]
    within = np.zeros(len(poses), bool)
    within[left] = True
    return within  # where a waypoint is out of reach at any distance, its radius is NaN


def clear_of_sweep(
    geometry: PlacementGeometry, poses: Float[np.ndarray, "n 3"], room: float
) -> Bool[np.ndarray, " n"]:
    """Whether the part passes by the base with so much room [m], at every opening."""
    robot = geometry.robot
    return base_hits(poses, robot.base, geometry.sweep, clearance=room) == FREE


def base_pose_status(
    geometry: PlacementGeometry, poses: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Say whether the base can stand at each pose while the part moves.

    Returns:
        A `BaseStatus`, and the box that blocks (static boxes first, then the sweep), FREE where
        none does.
    """
    outcome = np.where(within_reach(geometry, poses), BaseStatus.CLEAR, BaseStatus.BEYOND_ARM)
    if geometry.floor_polygon is not None:
        near = np.flatnonzero(outcome == BaseStatus.CLEAR)
        off = ~all_inside(
            geometry.floor_polygon, place_points(poses[near], geometry.robot.footprint)
        )
        outcome[near[off]] = BaseStatus.OFF_FLOOR
    code = np.full(len(poses), FREE, np.int64)
    near = np.flatnonzero(outcome == BaseStatus.CLEAR)
    code[near] = base_hits(
        poses[near], geometry.robot.base, geometry.boxes, clearance=geometry.clearance
    )
    outcome[code != FREE] = BaseStatus.BLOCKED
    return outcome, code
