"""Check a given start of a robot, or choose one with clearance around it.

One rule for planning and driving: at the start, the robot with its arm at home touches nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError, contact_text
from momapos.core.geometry import all_inside, place_points
from momapos.model.collision import FREE, base_hits
from momapos.model.records import Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene, scene_after
from momapos.model.urdf import Boxes

from .convex_polygons import ConvexPolygons, obstacles_of, on_floor, pack, prisms_of
from .cost_map import CELL, FloorPlan, clearance
from .footprint_map import HEADINGS, NavigationMap
from .judge import FootprintCollisionChecker
from .outline_gaps import gaps

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

START_CLEARANCE = 0.8
"""Preferred clearance around the start [m]."""
_SIGN_CAP = 0.01
"""Upper bound of gaps of which only the sign counts [m]."""
_BLOCK = 64
"""Number of cells that are checked together [-]."""


def check_arm_at_home(nav_map: NavigationMap, pose: Float[np.ndarray, "3"]) -> None:
    """Check that a robot with its arm at home touches nothing at its start: x, y [m], yaw [rad].

    Raises:
        SceneError: It would touch something.
    """
    checker = FootprintCollisionChecker(nav_map.prisms, nav_map.obstacles, nav_map.floor_polygon)
    touched = checker.distance(pose[None])[1][0]
    if touched:
        x, y, yaw = pose
        gap = float(gaps(pose[None], nav_map.prisms, nav_map.obstacles, cap=_SIGN_CAP)[0])
        what = f"{nav_map.robot.name} with its arm at home"
        contact = contact_text(what, touched, -gap) if gap < 0.0 else f"{what} over {touched}"
        raise SceneError(
            f"start ({x:.2f}, {y:.2f}, {np.degrees(yaw):.0f} deg): {contact}; give another start"
        )


def outlines_after(scene: Scene, robot: Robot, task: Task) -> ConvexPolygons:
    """Return the outlines of a task's object after the task, with the moved part at its goal.

    Args:
        scene: The scene before the task.
        robot: The robot, whose prisms decide which outlines count.
        task: The task; without a joint there are no outlines.
    """
    if task.joint is None or task.to is None:
        return pack([], [], [])
    after = scene_after(scene, task)
    return obstacles_of(replace(after, objects=(after.object(task.object),)), prisms_of(robot))


def clear_at_home(
    poses: Float[np.ndarray, "n 3"], robot: Robot, outlines: ConvexPolygons
) -> Bool[np.ndarray, " n"]:
    """Check at which base poses a robot with its arm at home is clear of outlines."""
    return gaps(poses, prisms_of(robot), outlines, cap=_SIGN_CAP) > 0.0


def touched_at_home(pose: Float[np.ndarray, "3"], robot: Robot, outlines: ConvexPolygons) -> str:
    """Return the name of an outline that a robot with its arm at home touches; "" for none."""
    return FootprintCollisionChecker(prisms_of(robot), outlines, None).distance(pose[None])[1][0]


def find_start(
    plan: FloorPlan, wish: Float[np.ndarray, "2"], nav_map: NavigationMap
) -> Float[np.ndarray, "3"]:
    """Find the start pose nearest to a position that has clearance, also for the arm at home.

    Args:
        plan: The blocked cells.
        wish: The preferred position [m].
        nav_map: The robot and the scene.

    Raises:
        SceneError: The robot fits nowhere.
    """
    clear = clearance(plan.blocked) * CELL
    # If the clearance is too small for a protruding arm, accept any pose in which the robot fits.
    for needed in (min(START_CLEARANCE, 0.9 * float(clear.max())), 0.0):
        i, j = np.nonzero(clear > needed)
        centers = plan.origin + (np.stack([j, i], -1) + 0.5) * CELL
        nearest = centers[np.argsort(np.linalg.norm(centers - wish, axis=1), kind="stable")]
        for k in range(0, len(nearest), _BLOCK):
            # Nearer cells come first, and headings near x.
            poses = np.array([[*xy, yaw] for xy in nearest[k : k + _BLOCK] for yaw in _HEADINGS])
            fits = gaps(poses, nav_map.prisms, nav_map.planning_obstacles, cap=_SIGN_CAP) > 0.0
            fits &= on_floor(nav_map.prisms, nav_map.floor_polygon, poses)
            if fits.any():
                return poses[int(np.argmax(fits))]
    raise SceneError(
        f"{nav_map.robot.name} fits nowhere on the floor; give a start: x [m], y [m], yaw [rad]"
    )


_HEADINGS = HEADINGS[np.argsort(np.abs(HEADINGS), kind="stable")]


def check_base(
    pose: Float[np.ndarray, "3"],
    robot: Robot,
    obstacles: Boxes,
    labels: Sequence[str],
    floor: Float[np.ndarray, "k 2"] | None,
) -> None:
    """Check that the base can stand at a start.

    Args:
        pose: x [m], y [m], yaw [rad].
        robot: The robot.
        obstacles: All boxes of the scene, world frame.
        labels: Name of each box.
        floor: Outline of the floor [m]; None if unknown.

    Raises:
        SceneError: The pose is not finite, or the base hits something or leaves the floor.
    """
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise SceneError("the start must be three finite numbers: x [m], y [m], yaw [rad]")
    where = f"start ({pose[0]:.2f}, {pose[1]:.2f}, {np.degrees(pose[2]):.0f} deg)"
    hit = int(base_hits(pose[None], robot.base, obstacles, clearance=0.0)[0])
    if hit != FREE:
        raise SceneError(f"{where}: the base of {robot.name} would hit {labels[hit]}")
    if floor is not None and not all_inside(floor, place_points(pose[None], robot.footprint))[0]:
        raise SceneError(f"{where}: the base of {robot.name} would stand off the floor")
