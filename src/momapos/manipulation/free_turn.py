"""Arms of fewer than six degrees of freedom: the turn of the hand about what it holds is one more.

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

from momapos.kinematics.base_fit import fit_bases
from momapos.kinematics.chain import with_tool_turn
from momapos.kinematics.collision import FREE
from momapos.kinematics.ik import build_ik
from momapos.kinematics.world import CollisionWorld
from momapos.manipulation.arm_path import UNREACHABLE, ArmPath, find_paths
from momapos.manipulation.motion import TaskMotion
from momapos.manipulation.turning import FULL as FULL
from momapos.manipulation.turning import no_turning
from momapos.manipulation.turning_arm import TurningArm
from momapos.robots.robot import Robot

if TYPE_CHECKING:
    from jaxtyping import Float, Int

MOST_WAYS = 4
"""Ways of holding that a base pose is fitted to, until one fits [-]."""
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
        arm, grasp = _turning_arm(robot, motion, way)
        chosen = np.arange(len(motion.Ts_world_tool)) == grasp
        still = replace(motion.only(chosen), turning=no_turning(1))
        rows = np.flatnonzero(ways == way)
        found = find_paths(arm, world, still, bases[rows], np.zeros(len(rows), np.int64))
        for row, path in zip(rows.tolist(), found, strict=True):
            paths[row] = path if path.q is None else replace(path, q=path.q[:, :-1].copy())
    return paths


def fitted_bases(
    robot: Robot, motion: TaskMotion, poses: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Base poses beside given ones from which a turning hand follows the motion, where there are.

    The ways in which the hand turns are tried one after the other; poses for which nothing is found
    stay as they are. An arm of six degrees of freedom or more needs none of this.
    """
    groups = len(motion.turning.groups)
    if robot.chain.size >= FULL or not groups:
        return poses
    poses, left = poses.copy(), np.arange(len(poses))
    steps = motion.waypoint_steps[[1, len(motion.waypoint_steps) // 2, -1]]
    # Every pose begins with another way, so that all of them get their share.
    for turn in range(min(groups, MOST_WAYS)):
        ways = (left + turn) % groups
        done = np.zeros(len(left), bool)
        for group in np.unique(ways).tolist():
            arm, grasp = _turning_arm(robot, motion, len(motion.turning.angles) + group)
            rows = np.flatnonzero(ways == group)
            Ts = motion.Ts_world_tool[grasp, steps]
            moved, met = fit_bases(arm.chain, arm.ik, poses[left[rows]], Ts)
            poses[left[rows[met]]] = moved[met]
            done[rows[met]] = True
        left = left[~done]
    return poses


def _turning_arm(robot: Robot, motion: TaskMotion, way: int) -> tuple[TurningArm, int]:
    """The arm with the turn of its hand in a way of holding, and the grasp from which it turns.

    The middle grasp of the way stands for all of them, and the hand turns from it to both ends.
    """
    turning = motion.turning
    members = turning.members(np.array([way]))[0]
    members = members[members >= 0]
    angles = turning.angles[members]
    middle = int(members[np.argsort(angles)[len(members) // 2]])
    axis = turning.axis @ turning.R_part_tool[middle]
    ends = turning.angles[middle] - np.array([angles.max(), angles.min()])
    return _arm_about(robot, _rounded(axis), _rounded(ends)), middle


def _rounded(values: np.ndarray) -> tuple[float, ...]:
    return tuple((np.round(values, _DIGITS) + 0.0).tolist())


@lru_cache(maxsize=64)
def _arm_about(robot: Robot, axis: tuple[float, ...], ends: tuple[float, ...]) -> TurningArm:
    chain = with_tool_turn(robot.chain, np.array(axis), ends[0], ends[1])
    return TurningArm(robot, chain, build_ik(chain))
