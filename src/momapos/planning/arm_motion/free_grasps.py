"""Find the grasps whose hand is free along the whole motion, wherever the base stands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.model.collision import FLOOR, FREE, CollisionWorld
from momapos.model.robots import Robot
from momapos.planning.grasps import TaskMotion

from .hand_clearance import hand_hits_along

if TYPE_CHECKING:
    from jaxtyping import Bool


def collision_free_grasps(
    robot: Robot, world: CollisionWorld, motion: TaskMotion
) -> tuple[Bool[np.ndarray, " g"], str]:
    """Find the grasps whose hand is free at every waypoint, for any base pose.

    Returns:
        A mask over the grasps, and the name of the most frequent obstacle of the others.
    """
    alive, hits = np.arange(len(motion.Ts_world_tool)), []
    # Most failures occur at the grasp itself: check it first.
    for steps in (motion.waypoint_steps[1:2], np.delete(motion.waypoint_steps, 1)):
        Ts = motion.Ts_world_tool[alive[:, None], steps].reshape(-1, 4, 4)
        width = np.repeat(motion.grasps.width[alive], len(steps))
        codes = hand_hits_along(robot, world, motion, Ts, np.tile(steps, len(alive)), width)
        hits.append(codes[codes != FREE])
        alive = alive[(codes.reshape(len(alive), len(steps)) == FREE).all(1)]
    free = np.isin(np.arange(len(motion.Ts_world_tool)), alive)
    counts = np.bincount(np.concatenate(hits) - FLOOR)
    obstacle = world.reason(int(counts.argmax()) + FLOOR) if len(counts) else ""
    return free, obstacle
