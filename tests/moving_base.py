"""Motions whose base moves, made from motions at one base pose: the hand moves as before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from momapos.core.geometry.transforms import invert, pose_planar
from momapos.model.kinematics.chain import Chain
from momapos.model.records.plans import Motion, PlacementPlan
from momapos.model.robots.robot import Robot

_STEPS, _DAMPING, _DIFFERENCE = 30, 1e-3, 1e-6


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
    """Return arm states near given ones that reach tool poses, by damped least squares.

    Args:
        chain: The arm.
        q: The values of its freedoms from which the search starts at each state.
        Ts_base_tool: The tool poses.
    """
    n = q.shape[1]

    def errors(q: Float[np.ndarray, "k n"], at: Float[np.ndarray, " k"]) -> np.ndarray:
        T = invert(chain.tool_poses(q)) @ Ts_base_tool[at]
        R = T[:, :3, :3]
        turn = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]])
        return np.concatenate([T[:, :3, 3], turn.T / 2], axis=1)

    at = np.arange(len(q))
    for _ in range(_STEPS):
        here = errors(q, at)
        near = q[:, None] + _DIFFERENCE * np.eye(n)
        J = errors(near.reshape(-1, n), np.repeat(at, n)).reshape(len(q), n, 6)
        J = (J - here[:, None]).transpose(0, 2, 1) / _DIFFERENCE
        square = J.transpose(0, 2, 1) @ J + _DAMPING**2 * np.eye(n)
        q = q - np.linalg.solve(square, J.transpose(0, 2, 1) @ here[..., None])[..., 0]
    worst = np.abs(errors(q, at)).max()
    assert worst < 1e-4, f"the arm does not reach from the moving base: off by {worst:.3g}"
    return q


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
    assert motion is not None
    return replace(plan, motion=moved(motion, robot.chain, base))


def moved(motion: Motion, chain: Chain, base: Float[np.ndarray, "m 3"]) -> Motion:
    """Return a motion whose base moves and whose hand moves as before; see `on_moving_base`."""
    q = follow(
        chain, chain.freedom_values(motion.q), invert(pose_planar(base)) @ motion.Ts_world_tool
    )
    return replace(motion, q=chain.joint_values(q), base=base, home=None)
