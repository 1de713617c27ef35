"""Which tool poses an arm reaches, by inverse kinematics, and poses to ask that of."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.model.collision import FREE, check_states
from momapos.model.kinematics import IkModel, bounded, chain_arrays, solve_ik
from momapos.model.robots import Robot

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

NEAR, NEAR_TURN = 0.17, 0.3
"""How far poses near reach are off those that the arm takes, along each axis [m], [rad]."""


def reachable(
    robot: Robot, Ts_base_tool: Float[np.ndarray, "m 4 4"], ik: IkModel | None = None
) -> Bool[np.ndarray, " m"]:
    """Whether any IK solution is free of the robot itself and of the floor."""
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
    """Tool poses uniform in the ball around the shoulder that the tool can reach, any direction."""
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
    """Tool poses beside those that the arm takes: up to 30 cm and half a radian off.

    About half of them can be reached, so that a map that is wrong at the boundary cannot hide
    behind poses that are far from it.
    """
    from scipy.spatial.transform import Rotation

    lower, upper = bounded(robot.chain)
    Ts = robot.chain.tool_poses(rng.uniform(lower, upper, (count, robot.chain.size)))
    Ts[:, :3, 3] += rng.uniform(-NEAR, NEAR, (count, 3))
    turn = Rotation.from_rotvec(rng.uniform(-NEAR_TURN, NEAR_TURN, (count, 3)))
    Ts[:, :3, :3] = turn.as_matrix() @ Ts[:, :3, :3]
    return Ts
