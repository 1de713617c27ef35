"""A motion carried over to a base pose beside its own: the same hold, and the same way there."""

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

STRIDE, STRIDE_TURN = 0.05, 0.05
"""So far beside the one before each state of the arm is found from that one [m], [rad]."""


def carried(
    robot: Robot,
    motion: Motion,
    base: Float[np.ndarray, "3"],
    to: Float[np.ndarray, "3"],
    straight: int,
) -> Motion | None:
    """The same motion of the hand from another base pose, the arm in the states nearest to its own.

    Nothing is checked but the arm's joints: neither what is hit nor whether the hand holds.

    Args:
        robot: The robot.
        motion: A motion at `base`.
        base, to: x [m], y [m], yaw [rad].
        straight: How many states of the approach are on the straight line to the grasp; before them
            the hand goes where the arm takes it.

    Returns:
        None where the arm does not follow the hand from there in small steps.
    """
    chain = robot.chain
    approach, q = chain.freedom_values(motion.approach), chain.freedom_values(motion.q)
    first = len(approach) - straight
    if first < 1:
        return None
    # The last state of the way there is the first on the straight line.
    led = np.concatenate([approach[first - 1 :], q])
    Ts = pose_planar(base) @ chain.tool_poses(led)
    Ts[-len(q) :] = motion.Ts_world_tool
    strides = int(np.ceil(np.abs((to - base) / [STRIDE, STRIDE, STRIDE_TURN]).max()))
    states = led
    for share in np.arange(1, strides + 1) / max(strides, 1):
        there = base + share * (to - base)
        found = follow(robot, states, invert(pose_planar(there)) @ Ts)
        if found is None:
            return None
        states = found
    way = _bent(approach[:first], states[0])
    reach = np.concatenate([way, states[1 : straight + 1]])
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


def _bent(way: Float[np.ndarray, "k n"], end: Float[np.ndarray, " n"]) -> Float[np.ndarray, "k n"]:
    """A way with the same beginning and another end: all between gives way in proportion."""
    lengths = np.abs(np.diff(way, axis=0)).max(1, initial=0.0)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    share = along / along[-1] if along[-1] > 0.0 else np.linspace(0.0, 1.0, len(way))
    return way + share[:, None] * (end - way[-1])
