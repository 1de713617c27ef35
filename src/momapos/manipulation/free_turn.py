"""Arms of fewer than six degrees of freedom: the turn of the hand about a bar is one more.

Such an arm takes few tool poses exactly, so that a hand that holds still can hardly be carried
along an arc. A hand that may turn about the bar that it holds can: the turn joins the arm's chain
as a joint without links, inverse kinematics finds it like all others, and what remains of a
solution without it is a state of the arm whose hand has turned that far.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.kinematics.chain import with_tool_turn
from momapos.kinematics.collision import FREE
from momapos.kinematics.ik import build_ik
from momapos.kinematics.world import CollisionWorld
from momapos.manipulation.arm_path import UNREACHABLE, ArmPath, find_paths
from momapos.manipulation.motion import TaskMotion
from momapos.manipulation.turning import no_turning
from momapos.manipulation.turning_arm import TurningArm
from momapos.robots.robot import Robot

if TYPE_CHECKING:
    from jaxtyping import Float, Int

FULL = 6
"""Degrees of freedom from which on an arm takes any tool pose within reach [-]."""
_DIGITS = 6
"""Axes and angles that agree so far are the same [-]."""


def find_turning_paths(
    robot: Robot,
    world: CollisionWorld,
    motion: TaskMotion,
    bases: Float[np.ndarray, "j 3"],
    ways: Int[np.ndarray, " j"],
) -> list[ArmPath]:
    """Look for an arm path for each pair of base pose and way of holding, see `find_paths`.

    Only ways in which the hand turns are looked at: for the others such an arm is too short of
    joints wherever it stands, but for places of no size.
    """
    paths = [ArmPath(UNREACHABLE, 0, 0, FREE)] * len(ways)
    for way in np.unique(ways[ways >= len(motion.turning.angles)]).tolist():
        members = motion.turning.members(np.array([way]))[0]
        members = members[members >= 0]
        angles = motion.turning.angles[members]
        # The middle grasp stands for all of them, and the hand turns from it to both ends.
        middle = int(members[np.argsort(angles)[len(members) // 2]])
        axis = motion.turning.axis @ motion.turning.R_part_tool[middle]
        ends = motion.turning.angles[middle] - np.array([angles.max(), angles.min()])
        arm = _turning_arm(robot, *(_rounded(v) for v in (axis, ends)))
        chosen = np.arange(len(motion.Ts_world_tool)) == middle
        still = replace(motion.only(chosen), turning=no_turning(1))
        rows = np.flatnonzero(ways == way)
        found = find_paths(arm, world, still, bases[rows], np.zeros(len(rows), np.int64))
        for row, path in zip(rows.tolist(), found, strict=True):
            paths[row] = path if path.q is None else replace(path, q=path.q[:, :-1].copy())
    return paths


def _rounded(values: np.ndarray) -> tuple[float, ...]:
    return tuple((np.round(values, _DIGITS) + 0.0).tolist())


@lru_cache(maxsize=64)
def _turning_arm(robot: Robot, axis: tuple[float, ...], ends: tuple[float, ...]) -> TurningArm:
    chain = with_tool_turn(robot.chain, np.array(axis), ends[0], ends[1])
    return TurningArm(robot, chain, build_ik(chain))
