"""Scenes of boxes for driving."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from momapos.core.geometry.transforms import pose, rotation_about
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import box_urdf
from momapos.planning.navigation.footprint_map import NavigationMap
from momapos.planning.navigation.outline_gaps import gaps

Box = tuple[float, float, float, float, float]
"""Center x, y, size x, y [m], yaw [rad]."""
UP = np.array([0.0, 0.0, 1.0])


def square(side: float) -> Float[np.ndarray, "4 2"]:
    """Return a square floor around the origin."""
    return side / 2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def room(
    boxes: Sequence[Box],
    *,
    floor: Float[np.ndarray, "k 2"] | None = None,
    low: float = 0.0,
    high: float = 1.0,
) -> Scene:
    """Make a scene of boxes from one height to another, by default on a floor of 6 m x 6 m."""
    objects = [
        SceneObject(
            f"box_{k}",
            "box",
            pose((x, y, (low + high) / 2), rotation_about(UP, yaw)),
            Articulated(box_urdf(f"box_{k}", (w, d, high - low))),
        )
        for k, (x, y, w, d, yaw) in enumerate(boxes)
    ]
    return Scene("boxes", tuple(objects), floor_polygon=square(6.0) if floor is None else floor)


def wall_with_door(width: float) -> list[Box]:
    """Return a thin wall along x = 0 with a door in its middle."""
    half = (3.0 - width / 2) / 2
    return [(0.0, s * (width / 2 + half), 0.1, 2 * half, 0.0) for s in (-1.0, 1.0)]


def free_pose(
    nav_map: NavigationMap, rng: np.random.Generator, *, gap: float
) -> Float[np.ndarray, "3"]:
    """Draw a random pose with a gap around the robot."""
    while True:
        poses = np.column_stack([rng.uniform(-2.9, 2.9, (64, 2)), rng.uniform(-3.14, 3.14, 64)])
        inside = (np.abs(poses[:, :2]) < 2.4).all(1)
        good = np.flatnonzero(
            inside & (gaps(poses, nav_map.prisms, nav_map.planning_obstacles) > gap)
        )
        if len(good):
            return poses[good[0]]
