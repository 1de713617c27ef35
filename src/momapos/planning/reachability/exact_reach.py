"""Check reachability by inverse kinematics, and draw tool poses for such checks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.model.collision import FREE, check_states
from momapos.model.kinematics import IkModel, bounded, chain_arrays, solve_ik
from momapos.model.robots import Robot

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

NEAR_OFFSET, NEAR_TURN = 0.17, 0.3
"""Largest offset of poses near the reach from reached ones, along each axis [m], [rad]."""


def reachable(
    robot: Robot, Ts_base_tool: Float[np.ndarray, "m 4 4"], ik: IkModel | None = None
) -> Bool[np.ndarray, " m"]:
    """Check which tool poses have an IK solution without collision with the robot or the floor."""
    ik = ik or robot.ik
    out = np.zeros(len(Ts_base_tool), bool)
    boxes = (np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0, bool))
    block = max(1, 40_000 // ik.max_solutions)
    for lo in range(0, len(out), block):
        q, count = solve_ik(robot.chain, ik, Ts_base_tool[lo : lo + block])
        valid = np.arange(q.shape[1]) < count[:, None]
        codes = check_states(
            np.ascontiguousarray(q[valid]),
            np.zeros(3),
            chain_arrays(robot.chain),
            robot.spheres.arrays,
            boxes,
            False,
            0.0,
        )
        free = np.zeros(valid.shape, bool)
        free[valid] = codes == FREE
        out[lo : lo + block] = free.any(1)
    return out


def random_poses(
    robot: Robot, rng: np.random.Generator, count: int
) -> Float[np.ndarray, "count 4 4"]:
    """Draw tool poses of any direction uniformly from the ball around the shoulder."""
    from scipy.spatial.transform import Rotation

    chain = robot.chain
    lower, upper = bounded(chain)
    q = rng.uniform(lower, upper, (100_000, chain.size))
    first = chain.first_turn
    shoulder = chain.d[: first + 1].sum(0) + chain.middle[:first] @ chain.h[:first]
    radius = np.linalg.norm(chain.tool_poses(q)[:, :3, 3] - shoulder, axis=1).max()
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    Ts = np.zeros((count, 4, 4))
    Ts[:, :3, 3] = shoulder + direction * radius * np.cbrt(rng.random((count, 1)))
    Ts[:, :3, :3] = Rotation.random(count, random_state=rng).as_matrix()
    Ts[:, 3, 3] = 1.0
    return Ts


def poses_near_reach(
    robot: Robot, rng: np.random.Generator, count: int
) -> Float[np.ndarray, "count 4 4"]:
    """Draw tool poses near reached ones: up to 30 cm and half a radian off.

    About half of them are reachable, so errors at the boundary of a map show.
    """
    from scipy.spatial.transform import Rotation

    lower, upper = bounded(robot.chain)
    Ts = robot.chain.tool_poses(rng.uniform(lower, upper, (count, robot.chain.size)))
    Ts[:, :3, 3] += rng.uniform(-NEAR_OFFSET, NEAR_OFFSET, (count, 3))
    turn = Rotation.from_rotvec(rng.uniform(-NEAR_TURN, NEAR_TURN, (count, 3)))
    Ts[:, :3, :3] = turn.as_matrix() @ Ts[:, :3, :3]
    return Ts
