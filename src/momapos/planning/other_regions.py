"""Find base poses from which the robot can drive to other regions after a task.

An open door can split a room: the robot reaches other regions from one side than from the other.
If the next task is infeasible, only base poses that lead to regions not reached before can help.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import inscribed_radius
from momapos.model.scene import Scene
from momapos.planning.grasps import scene_boxes
from momapos.planning.navigation import (
    CELL,
    CostMap,
    NavigationMap,
    base_height,
    build_cost_map,
    build_navigation_map,
    floor_plan,
    gaps,
)
from momapos.planning.placement import BaseStatus, PlacementGeometry, PoseMask, base_pose_status

from .config import PipelineConfig

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MAX_OTHER_REGIONS = 2
"""Number of alternative base poses tried for one task, one after the other [-]."""
_YAWS = np.radians(np.arange(-180.0, 180.0, 22.5))
"""Yaws at which a cell is tested for a free base pose [rad]."""


@dataclass(frozen=True)
class _Unreached:
    """The scene after a task, and the regions that the robot reaches from the tried base poses."""

    nav_map: NavigationMap
    tried: tuple[CostMap, ...]
    """One per tried base pose at which the arm can return home."""

    def __call__(self, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return which base poses lie in other regions and let the arm return home."""
        kept = np.ones(len(poses), bool)
        for costs in self.tried:
            kept &= ~np.isfinite(costs.lengths(poses[:, :2]))
        rest = np.flatnonzero(kept)
        kept[rest] = ~_collides_at_home(self.nav_map, poses[rest])
        return kept

    def cells(self) -> Float[np.ndarray, "n 2"]:
        """Return the centers of free cells that no tried base pose leads to [m]."""
        reached = np.isfinite([costs.distance for costs in self.tried]).any(axis=0)
        i, j = np.nonzero(self.tried[0].free & ~reached)
        return self.tried[0].origin + (np.stack([j, i], -1) + 0.5) * CELL


def _collides_at_home(
    nav_map: NavigationMap, poses: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """Return at which base poses the robot collides with its arm at home."""
    return gaps(poses, nav_map.prisms, nav_map.obstacles) <= 0.0


def poses_in_other_regions(
    geometry: PlacementGeometry, after: Scene, tried: Sequence[Float[np.ndarray, "3"]]
) -> PoseMask | None:
    """Find base poses of a task that lead to other regions than those tried.

    Args:
        geometry: Geometry of the task.
        after: The scene after the task.
        tried: Base poses x [m], y [m], yaw [rad] from which the next task is infeasible.

    Returns:
        A mask of base poses that lead to other regions after the task and let the arm return
        home; None if there are none.
    """
    robot = geometry.robot
    floor, height = after.floor_polygon, base_height(robot)
    plan = floor_plan(scene_boxes(after), height=height, floor_polygon=floor)
    radius = inscribed_radius(robot.footprint)
    nav_map = build_navigation_map(after, robot)
    # If the arm cannot return home, the next task fails for that reason, not for its region.
    begun = np.array(tried)[~_collides_at_home(nav_map, np.array(tried))]
    costs = tuple(build_cost_map(plan, pose[:2], radius=radius) for pose in begun)
    unreached = _Unreached(nav_map, costs)
    if not costs:
        return unreached
    cells = unreached.cells()
    poses = np.column_stack([np.repeat(cells, len(_YAWS), 0), np.tile(_YAWS, len(cells))])
    stands = base_pose_status(geometry, poses)[0] == BaseStatus.CLEAR
    return unreached if unreached(poses[stands]).any() else None


def without_departure_check(config: PipelineConfig) -> PipelineConfig:
    """Return the configuration for base poses that are known to lead to other regions."""
    return replace(config, place=replace(config.place, departure=False))
