"""Collision checks of an object in the hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert
from momapos.model.collision import Spheres, box_spheres, carry, place_segments
from momapos.model.kinematics import chain_arrays
from momapos.model.robots import Robot
from momapos.planning.grasps import TaskMotion

if TYPE_CHECKING:
    from jaxtyping import Float, Int


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
