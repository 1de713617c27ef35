"""Other base poses for a task, where the robot cannot do the next one from where it stands then.

An open door parts a room: from one side of it the robot gets to other places than from the other.
So where the next task is a "no", only base poses from which the robot gets to places that it was
not at yet are worth being asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import inscribed_radius
from momapos.model.scene import Scene
from momapos.planning.grasps import room_boxes
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
from momapos.planning.placement import BaseStatus, PlacementGeometry, PoseFilter, base_pose_status

from .config import PipelineConfig

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

OTHERS = 2
"""Other base poses that are asked for, one after the other [-]."""
_YAWS = np.radians(np.arange(-180.0, 180.0, 22.5))
"""With these a base is stood on a cell to see whether it may stand there at all."""


@dataclass(frozen=True)
class _Left:
    """The room as a task leaves it, and where the robot gets from base poses that were tried."""

    room: NavigationMap
    tried: tuple[CostMap, ...]
    """Of those where it can bring its arm home."""

    def no_other(self, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Base poses where the robot gets anyway, or where it cannot bring its arm home."""
        out = np.zeros(len(poses), bool)
        for one in self.tried:
            out |= np.isfinite(one.lengths(poses[:, :2]))
        rest = np.flatnonzero(~out)
        out[rest] = _touches(self.room, poses[rest])
        return out

    def beyond(self) -> Float[np.ndarray, "n 2"]:
        """Centers of the cells where the base has room, and does not get from those poses [m]."""
        cells = self.tried[0].free & ~np.isfinite([one.distance for one in self.tried]).any(axis=0)
        i, j = np.nonzero(cells)
        return self.tried[0].origin + (np.stack([j, i], -1) + 0.5) * CELL


def _touches(room: NavigationMap, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Base poses where a robot with its arm at home touches something."""
    return gaps(poses, room.prisms, room.obstacles) <= 0.0


def base_poses_elsewhere(
    geometry: PlacementGeometry, after: Scene, tried: Sequence[Float[np.ndarray, "3"]]
) -> PoseFilter | None:
    """Rule base poses of a task out that are no other than those that were tried.

    Args:
        geometry: Of the task.
        after: The room as the task leaves it.
        tried: Base poses x [m], y [m], yaw [rad] from which the next task could not be done.

    Returns:
        What rules out base poses from which the robot, the task done, would only get where it gets
        from the others, or could not bring its arm home; None where that rules out all.
    """
    robot = geometry.robot
    floor, height = after.floor_polygon, base_height(robot)
    plan = floor_plan(room_boxes(after), height=height, floor_polygon=floor)
    radius = inscribed_radius(robot.footprint)
    room = build_navigation_map(after, robot)
    # Where the arm cannot come home the next task does not begin: that says nothing of the place.
    begun = np.array(tried)[~_touches(room, np.array(tried))]
    left = _Left(room, tuple(build_cost_map(plan, pose[:2], radius=radius) for pose in begun))
    if not left.tried:
        return left.no_other
    cells = left.beyond()
    poses = np.column_stack([np.repeat(cells, len(_YAWS), 0), np.tile(_YAWS, len(cells))])
    stands = base_pose_status(geometry, poses)[0] == BaseStatus.CLEAR
    return None if left.no_other(poses[stands]).all() else left.no_other


def without_way_on(config: PipelineConfig) -> PipelineConfig:
    """How base poses elsewhere are asked for: what they lead to has been told already."""
    return replace(config, place=replace(config.place, way_on=False))
