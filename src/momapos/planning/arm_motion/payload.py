"""Collision checks of an object in the hand, and the boxes near a motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, halton, invert
from momapos.model.collision import (
    FREE,
    CollisionWorld,
    Spheres,
    base_hits,
    box_spheres,
    build_world,
    carry,
    check,
    place_segments,
)
from momapos.model.kinematics import chain_arrays
from momapos.model.records import Motion
from momapos.model.robots import Robot
from momapos.model.urdf import Boxes, MovingBoxes
from momapos.planning.grasps import TaskMotion

from .ik_layers import TaskLoads

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


SAMPLES = 2048
"""Number of arm states among which those that can carry an object are sought [-]."""
WRIST = 3
"""Number of the last joints; in half of the samples only these differ from home [-]."""


def with_payload(
    robot: Robot, motion: TaskMotion, T_world_tool: Float[np.ndarray, "4 4"], step: int
) -> Spheres:
    """Return the robot's spheres with the object in its hand.

    Args:
        robot: The robot.
        motion: The task motion.
        T_world_tool: Tool pose at a step at which the hand holds the object.
        step: That step of the motion.
    """
    chain = robot.chain
    center, radius = _object_spheres(motion, step)
    in_tool = apply(invert(T_world_tool), center)
    return carry(
        robot.spheres.by_hulls,
        chain.last,
        chain.tool_offset + in_tool @ chain.tool_rotation.T,
        radius,
    )


def _object_spheres(
    motion: TaskMotion, step: int
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
    """Return the moved object's spheres in the world at a step of the motion [m]."""
    return box_spheres(motion.moving.at(int(motion.value[step])))


def payload_hits_at_home(robot: Robot, motion: TaskMotion) -> Int[np.ndarray, " g"]:
    """Find what an object in the hand touches on the robot with its arm at home, for each grasp.

    A placed object starts there, so such a grasp works at no base pose.

    Returns:
        An index of a group of the robot's spheres, the number of groups for the base, or -1.
    """
    chain, spheres = robot.chain, robot.spheres
    center, radius = _object_spheres(motion, 0)
    in_tool = np.linalg.inv(motion.Ts_world_tool[:, 0])
    Ts = chain.tool_poses(robot.home[None])[0] @ in_tool
    points = np.einsum("gij,kj->gki", Ts[:, :3, :3], center) + Ts[:, None, :3, 3]
    touched = np.full(len(points), -1)
    R, p = np.empty((chain.last + 1, 3, 3)), np.empty((chain.last + 1, 3))
    place_segments(robot.home, np.zeros(3), chain_arrays(chain), R, p)
    for k, segment in enumerate(spheres.segment):
        if segment == chain.last:
            continue
        rows = slice(spheres.start[k], spheres.start[k + 1])
        links = spheres.center[rows] @ R[segment].T + p[segment]
        gap = np.linalg.norm(points[:, :, None] - links, axis=-1) - radius[:, None]
        touched[(gap < spheres.radius[rows]).any((1, 2))] = k
    base = robot.base
    local = np.abs(np.einsum("bij,gkbi->gkbj", base.rotation, points[:, :, None] - base.center))
    apart = np.linalg.norm(np.maximum(local - base.half, 0.0), axis=-1)
    touched[(apart < radius[:, None]).any((1, 2))] = len(spheres.segment)
    return touched


def carrying_states(
    robot: Robot,
    world: CollisionWorld,
    motion: TaskMotion,
    grasp: int,
    base: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "k n"]:
    """Return sampled arm states in which a robot can carry an object, and begin to drive.

    Robot and object are free of collision with each other and with the scene, and the motors and
    the base bear the object.

    Args:
        robot: The robot.
        world: The scene.
        motion: The task motion, which places the object.
        grasp: The grasp.
        base: Where the robot begins to drive: x [m], y [m], yaw [rad].
    """
    chain = robot.chain
    low = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    high = np.where(np.isfinite(chain.upper), chain.upper, np.pi)
    q = low + halton(SAMPLES, chain.size) * (high - low)
    q[1::2, :-WRIST] = robot.home[:-WRIST]
    spheres = with_payload(robot, motion, motion.Ts_world_tool[grasp, 0], 0)
    codes = check(
        world, chain, spheres, q, np.tile(base, (len(q), 1)), np.full(len(q), motion.value[0]),
        np.ones(len(q), bool),
    )  # fmt: skip
    q = q[codes == FREE]
    return q[~TaskLoads(robot, motion).free(q, (grasp, 0)).refused] if len(q) else q


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
