"""Find the boxes near a motion: near the base, the arm with its payload, and the moving part."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.collision import base_hits, build_world, check
from momapos.model.records import Motion
from momapos.model.robots import Robot
from momapos.model.urdf import Boxes, MovingBoxes
from momapos.planning.grasps import TaskMotion

from .payload import with_payload

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_ORIGIN = np.zeros((1, 3))


def boxes_near_swept_volume(
    motion: TaskMotion, boxes: Boxes, *, margin: float
) -> Bool[np.ndarray, " b"]:
    """Find the boxes (world frame) within a margin [m] of the moving part, for any robot."""
    sweep = motion.sweep()
    return _every(boxes, lambda left: base_hits(_ORIGIN, sweep, left, clearance=margin))


def boxes_near_base(
    robot: Robot, base: Float[np.ndarray, "3"], boxes: Boxes, *, margin: float
) -> Bool[np.ndarray, " b"]:
    """Find the boxes within a margin [m] of the base at x [m], y [m], yaw [rad]."""
    return _every(boxes, lambda left: base_hits(base[None], robot.base, left, clearance=margin))


def near_boxes(
    robot: Robot,
    motion: TaskMotion,
    base: Float[np.ndarray, "3"],
    found: Motion,
    boxes: Boxes,
    *,
    margin: float,
) -> Bool[np.ndarray, " b"]:
    """Find the boxes near a planned motion; collision spheres stand for the arm.

    Args:
        robot: The robot.
        motion: The task motion.
        base: Base pose x [m], y [m], yaw [rad].
        found: The planned motion.
        boxes: In the world frame.
        margin: Distance up to which a box is near [m].
    """
    home = found.q[:0] if found.home is None else found.home
    q = np.concatenate([found.approach, found.q, home])
    bases, none = np.tile(base, (len(q), 1)), np.zeros(len(q), np.int64)
    spheres = robot.spheres
    if motion.task.verb == "place":
        spheres = with_payload(robot, motion, found.Ts_world_tool[0], motion.grasp_step)
    nothing = MovingBoxes(np.zeros((1, 0, 3)), np.zeros((1, 0, 3, 3)), np.zeros((1, 0, 3)))

    def arm_hits(left: Boxes) -> Int[np.ndarray, " m"]:
        labels, free = [""] * len(left), np.zeros(0, bool)
        world = build_world(left, nothing, free, labels, spheres, clearance=margin)
        return check(world, robot.chain, spheres, q, bases, none, none > 0)

    return (
        boxes_near_base(robot, base, boxes, margin=margin)
        | boxes_near_swept_volume(motion, boxes, margin=margin)
        | _every(boxes, arm_hits)
    )


def _every(
    boxes: Boxes, first_hits: Callable[[Boxes], Int[np.ndarray, " m"]]
) -> Bool[np.ndarray, " b"]:
    """Find all boxes that are hit, using a check that reports only the first hit."""
    left = np.arange(len(boxes))
    while len(left):
        codes = first_hits(boxes.take(left))
        hit = np.unique(codes[codes >= 0])
        if not len(hit):
            break
        left = np.delete(left, hit)
    return ~np.isin(np.arange(len(boxes)), left)
