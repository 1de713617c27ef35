"""Where a robot starts: as it is told, or in front of things, with room around it.

One rule for all who plan and drive: at the start the robot, its arm at home, touches nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError
from momapos.core.geometry import all_inside, place_points
from momapos.model.collision import FREE, base_hits
from momapos.model.records import Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.model.urdf import Boxes

from .convex_polygons import ConvexPolygons, obstacles_of, on_floor, pack, prisms_of
from .cost_map import CELL, FloorPlan
from .footprint_map import HEADINGS, NavigationMap
from .grid_distance import clearance
from .judge import FootprintCollisionChecker
from .outline_gaps import gaps

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

ROOM = 0.8
"""Clearance around the start [m]."""
_TELLING = 0.01
"""Gaps are looked for up to this where only their sign counts [m]."""
_AT_ONCE = 64
"""Cells that are looked at together [-]."""


def check_arm_at_home(nav_map: NavigationMap, pose: Float[np.ndarray, "3"]) -> None:
    """Make sure that a robot with its arm at home touches nothing where it starts.

    Args:
        nav_map: The robot and the room.
        pose: x [m], y [m], yaw [rad].

    Raises:
        SceneError: It would touch something.
    """
    checker = FootprintCollisionChecker(nav_map.prisms, nav_map.obstacles, nav_map.floor_polygon)
    touched = checker.distance(pose[None])[1][0]
    if touched:
        x, y, yaw = pose
        raise SceneError(
            f"start ({x:.2f}, {y:.2f}, {np.degrees(yaw):.0f} deg): {nav_map.robot.name} with its "
            f"arm at home would touch {touched}; give another --start"
        )


def outlines_after(scene: Scene, robot: Robot, task: Task) -> ConvexPolygons:
    """Outlines of the object whose part a task moves, with the part where the task leaves it.

    The rest of the room stays as it is when the robot comes, with its arm at home.

    Args:
        scene: The room.
        robot: Who does the task; its prisms tell which outlines count.
        task: One without a joint leaves no outline.
    """
    if task.joint is None or task.to is None:
        return pack([], [], [])
    after = scene.with_joint(task.object, task.joint, task.to)
    return obstacles_of(replace(after, objects=(after.object(task.object),)), prisms_of(robot))


def clear_at_home(
    poses: Float[np.ndarray, "n 3"], robot: Robot, outlines: ConvexPolygons
) -> Bool[np.ndarray, " n"]:
    """Whether a robot with its arm at home is clear of some outlines at base poses."""
    return gaps(poses, prisms_of(robot), outlines, cap=_TELLING) > 0.0


def touched_at_home(pose: Float[np.ndarray, "3"], robot: Robot, outlines: ConvexPolygons) -> str:
    """Which of some outlines a robot with its arm at home touches; "" for none."""
    return FootprintCollisionChecker(prisms_of(robot), outlines, None).distance(pose[None])[1][0]


def find_start(
    plan: FloorPlan, wish: Float[np.ndarray, "2"], nav_map: NavigationMap
) -> Float[np.ndarray, "3"]:
    """The floor position nearest to a wish that has room around it, for the arm at home as well.

    Args:
        plan: Where something stands.
        wish: Where the start would best be [m].
        nav_map: The robot and the room.

    Raises:
        SceneError: Nowhere is there room.
    """
    clear = clearance(plan.blocked) * CELL
    # Where no place is roomy enough for an arm that sticks out, any that the robot fits in will do.
    for room in (min(ROOM, 0.9 * float(clear.max())), 0.0):
        i, j = np.nonzero(clear > room)
        centers = plan.origin + (np.stack([j, i], -1) + 0.5) * CELL
        nearest = centers[np.argsort(np.linalg.norm(centers - wish, axis=1), kind="stable")]
        for k in range(0, len(nearest), _AT_ONCE):
            # The heading along x comes first, as does the nearer of two cells.
            poses = np.array([[*xy, yaw] for xy in nearest[k : k + _AT_ONCE] for yaw in _HEADINGS])
            fits = gaps(poses, nav_map.prisms, nav_map.planning_obstacles, cap=_TELLING) > 0.0
            fits &= on_floor(nav_map.prisms, nav_map.floor_polygon, poses)
            if fits.any():
                return poses[int(np.argmax(fits))]
    raise SceneError("the room is full: nowhere can a robot start; give --start X,Y,YAW")


_HEADINGS = HEADINGS[np.argsort(np.abs(HEADINGS), kind="stable")]


def check_base(
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
