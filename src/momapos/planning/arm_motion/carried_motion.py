"""Adapt a motion to a nearby base pose: same tool path in the world, same approach."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert, pose_planar
from momapos.model.records import Motion
from momapos.model.robots import Robot

from .arm_path import follow

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_OFFSET, MAX_TURN = 0.05, 0.05
"""Maximum change of the base pose per step of the adaptation [m], [rad]."""


def adapt_motion(
    robot: Robot,
    motion: Motion,
    base: Float[np.ndarray, "3"],
    to: Float[np.ndarray, "3"],
    straight: int,
) -> Motion | None:
    """Move the hand the same way from another base pose, with arm states near the old ones.

    Only joint limits and joint steps are checked, neither collisions nor the grasp.

    Args:
        robot: The robot.
        motion: A motion at `base`.
        base, to: x [m], y [m], yaw [rad].
        straight: Number of the last states of the approach, in which the hand moves straight to the
            grasp; the free motion before them is only bent.

    Returns:
        The motion, or None if the arm cannot follow the tool path from there in small steps.
    """
    chain = robot.chain
    approach, q = chain.freedom_values(motion.approach), chain.freedom_values(motion.q)
    first = len(approach) - straight
    if first < 1:
        return None
    # The last state of the free motion is the first of the straight one.
    states = np.concatenate([approach[first - 1 :], q])
    Ts = pose_planar(base) @ chain.tool_poses(states)
    Ts[-len(q) :] = motion.Ts_world_tool
    steps = int(np.ceil(np.abs((to - base) / [MAX_OFFSET, MAX_OFFSET, MAX_TURN]).max()))
    for share in np.arange(1, steps + 1) / max(steps, 1):
        between = base + share * (to - base)
        found = follow(robot, states, invert(pose_planar(between)) @ Ts)
        if found is None:
            return None
        states = found
    free = _bent(approach[:first], states[0])
    reach = np.concatenate([free, states[1 : straight + 1]])
    home = motion.home
    if home is not None:
        ended = np.concatenate([q[-1:], chain.freedom_values(home)])
        home = chain.joint_values(_bent(ended[::-1], states[-1])[::-1][1:])
    return replace(
        motion,
        approach=chain.joint_values(reach),
        q=chain.joint_values(states[straight + 1 :]),
        home=home,
        approach_times=None,
        times=None,
    )


def _bent(path: Float[np.ndarray, "k n"], end: Float[np.ndarray, " n"]) -> Float[np.ndarray, "k n"]:
    """Move the end of a path and all states before it in proportion to their path length."""
    lengths = np.abs(np.diff(path, axis=0)).max(1, initial=0.0)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    share = along / along[-1] if along[-1] > 0.0 else np.linspace(0.0, 1.0, len(path))
    return path + share[:, None] * (end - path[-1])
