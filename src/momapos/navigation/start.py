"""Where a robot starts: as given, or in front of things with room around it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt

from momapos.errors import SceneError
from momapos.geometry.planar import place_points
from momapos.geometry.polygons import all_inside
from momapos.kinematics.base_collision import base_hits
from momapos.kinematics.collision import FREE
from momapos.kinematics.hulls import Boxes
from momapos.navigation.cost_map import CELL, FloorPlan
from momapos.robots.robot import Robot

ROOM = 0.8
"""Clearance around the start [m]."""


def find_start(plan: FloorPlan, wish: Float[np.ndarray, "2"]) -> Float[np.ndarray, "3"]:
    """The floor position nearest to a wish that has room around it.

    Args:
        plan: Where something stands.
        wish: Where the start would best be [m].

    Raises:
        SceneError: Nowhere is there room.
    """
    clear = (
        distance_transform_edt(np.pad(~plan.blocked, 1, constant_values=True))[1:-1, 1:-1] * CELL
    )
    i, j = np.nonzero(clear > min(ROOM, 0.9 * float(clear.max())))
    if not len(i):
        raise SceneError("the room is full: nowhere can a robot start; give --start X,Y,YAW")
    centers = plan.origin + (np.stack([j, i], -1) + 0.5) * CELL
    best = int(np.argmin(np.linalg.norm(centers - wish, axis=1)))
    return np.array([centers[best, 0], centers[best, 1], 0.0])


def check_start(
    pose: Float[np.ndarray, "3"],
    robot: Robot,
    obstacles: Boxes,
    labels: Sequence[str],
    floor: Float[np.ndarray, "k 2"] | None,
) -> None:
    """Refuse a start at which the base cannot stand.

    Args:
        pose: x [m], y [m], yaw [rad].
        robot: The robot.
        obstacles: All boxes of the room, world frame.
        labels: Name of each.
        floor: Outline of the floor [m]; None where it has no known end.

    Raises:
        SceneError: The pose is not finite, or the base hits something or leaves the floor.
    """
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise SceneError("the start must be three numbers: x [m], y [m], yaw")
    where = f"start ({pose[0]:.2f}, {pose[1]:.2f}, {np.degrees(pose[2]):.0f} deg)"
    hit = int(base_hits(pose[None], robot.base, obstacles, clearance=0.0)[0])
    if hit != FREE:
        raise SceneError(f"{where}: the base of {robot.name} would hit {labels[hit]}")
    if floor is not None and not all_inside(floor, place_points(pose[None], robot.footprint))[0]:
        raise SceneError(f"{where}: the base of {robot.name} would stand off the floor")
