"""Which boxes a motion comes near: base, arm with what it carries, and the moving part."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.collision import base_hits, build_world, check
from momapos.model.records import Motion
from momapos.model.robots import Robot
from momapos.model.urdf import Boxes, MovingBoxes
from momapos.planning.grasps import TaskMotion

from .feasibility import with_payload

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_ORIGIN = np.zeros((1, 3))


def boxes_near_swept_volume(
    motion: TaskMotion, boxes: Boxes, *, margin: float
) -> Bool[np.ndarray, " b"]:
    """Which boxes the moving part comes near, whoever moves it.

    Args:
        motion: What moves.
        boxes: In the world frame.
        margin: What counts as near [m].
    """
    sweep = motion.sweep()
    return _every(boxes, lambda left: base_hits(_ORIGIN, sweep, left, clearance=margin))


def boxes_near_base(
    robot: Robot, base: Float[np.ndarray, "3"], boxes: Boxes, *, margin: float
) -> Bool[np.ndarray, " b"]:
    """Which boxes the base comes near where it stands (x, y [m], yaw [rad])."""
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
    """Which boxes a motion that was found comes near.

    The arm is told at every state by its collision spheres, which lie outside its shape.

    Args:
        robot: The robot.
        motion: The task.
        base: Base pose x [m], y [m], yaw [rad].
        found: What the arm does there.
        boxes: In the world frame.
        margin: What counts as near [m].
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
    """All boxes that are hit, from checks that stop at the first."""
    left = np.arange(len(boxes))
    while len(left):
        codes = first_hits(Boxes(boxes.center[left], boxes.rotation[left], boxes.half[left]))
        hit = np.unique(codes[codes >= 0])
        if not len(hit):
            break
        left = np.delete(left, hit)
    return ~np.isin(np.arange(len(boxes)), left)
