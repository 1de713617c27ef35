"""Motions whose base moves, made from motions at one base pose: the hand moves as before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from momapos.core.geometry.transforms import invert, pose_planar
from momapos.model.kinematics.chain import Chain
from momapos.model.kinematics.tool_tracking import track_tools
from momapos.model.records.plans import Motion, PlacementPlan
from momapos.model.robots.robot import Robot


def arc(
    start: tuple[float, float, float], length: float, turn: float, count: int
) -> Float[np.ndarray, "count 3"]:
    """Return base poses along an arc, or a turn on the spot; yaw without jumps.

    Args:
        start: x [m], y [m], yaw [rad].
        length: Signed length, negative backwards [m].
        turn: Angle by which the base turns [rad].
        count: Number of poses.
    """
    share = np.linspace(0.0, 1.0, count)
    x, y, yaw = start
    chord = length * share * np.sinc(turn * share / 2 / np.pi)
    middle = yaw + turn * share / 2
    return np.stack(
        [x + chord * np.cos(middle), y + chord * np.sin(middle), yaw + turn * share], axis=-1
    )


def follow(
    chain: Chain, q: Float[np.ndarray, "m n"], Ts_base_tool: Float[np.ndarray, "m 4 4"]
) -> Float[np.ndarray, "m n"]:
    """Return arm states near given ones that reach tool poses; they must exist."""
    found = track_tools(chain, q, Ts_base_tool)
    assert found is not None, "the arm does not reach from the moving base"
    return found


def on_moving_base(
    plan: PlacementPlan, robot: Robot, base: Float[np.ndarray, "m 3"]
) -> PlacementPlan:
    """Return a plan whose base moves and whose hand moves as in a plan at one base pose.

    Args:
        plan: The plan.
        robot: Its robot.
        base: Base pose at each state of the manipulation; the first is the plan's.
    """
    motion = plan.motion
    return replace(plan, motion=moved(motion, robot.chain, base))


def moved(motion: Motion, chain: Chain, base: Float[np.ndarray, "m 3"]) -> Motion:
    """Return a motion whose base moves and whose hand moves as before; see `on_moving_base`."""
    q = follow(
        chain, chain.freedom_values(motion.q), invert(pose_planar(base)) @ motion.Ts_world_tool
    )
    return replace(motion, q=chain.joint_values(q), base=base, home=None)
