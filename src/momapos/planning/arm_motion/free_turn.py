"""Arms of fewer than six degrees of freedom: the turn of the hand about what it holds is one more.

Such an arm takes few tool poses exactly, so that a hand that holds still can hardly be carried
along an arc. A hand that may turn about the bar that it holds can: the turn joins the arm's chain
as a joint without links, inverse kinematics finds it like all others, and what remains of a
solution without it is a state of the arm whose hand has turned that far. Along a straight line a
hand that holds still can be carried as well, but from base poses on a curve only: samples are
moved to some beside them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import wrap_angle
from momapos.model.collision import FREE, CollisionWorld
from momapos.model.kinematics import build_ik, fit_bases, with_tool_turn
from momapos.model.robots import Robot
from momapos.planning.grasps import TaskMotion, no_turning

from .arm_path import UNREACHABLE, ArmPath, find_paths
from .turning_arm import Arm, TurningArm

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

GIVE, LEAN = 0.008, float(np.radians(0.8))
"""So far a base may be from one where the arm follows exactly [m], [rad]: a drive ends so near."""
TRIES = 8
"""States of the arm from which a base pose is looked for that is so near [-]."""
ROUNDED = 0.002
"""So far beyond their limits the joints of a hand that turns are solved for [rad], to be brought
back afterwards: files that say 3.14 mean half a turn."""
MOST_WAYS = 4
"""Ways of holding that a base pose is fitted to, until one fits [-]."""
_SPREAD = 0.5 * (5.0**0.5 - 1.0)
"""Multiples of the golden ratio are spread evenly, however many are taken [-]."""
_DIGITS = 6
"""Axes and angles that agree so far are the same [-]."""


def find_short_paths(
    robot: Robot,
    world: CollisionWorld,
    motion: TaskMotion,
    bases: Float[np.ndarray, "j 3"],
    ways: Int[np.ndarray, " j"],
) -> list[ArmPath]:
    """Look for an arm path for each pair of base pose and way of holding, see `find_paths`.

    A hand that holds still is carried along straight lines alone: else such an arm is too short of
    joints wherever it stands, but for places of no size. Base poses that are some millimeters from
    one where the arm follows exactly get its states: the pads and the grip's play take up the rest,
    and the exact check tells how far the hand then slips.
    """
    paths = [ArmPath(UNREACHABLE, 0, 0, FREE)] * len(ways)
    asked = np.flatnonzero(np.isin(ways, _short_ways(motion)))
    for way in np.unique(ways[asked]).tolist():
        rows = asked[ways[asked] == way]
        near, met = _beside(robot, motion, way, bases[rows], TRIES)
        away = near - bases[rows]
        met &= (np.hypot(away[:, 0], away[:, 1]) <= GIVE) & (abs(wrap_angle(away[:, 2])) <= LEAN)
        arm, grasp = _held(robot, motion, way)
        chosen = np.arange(len(motion.Ts_world_tool)) == grasp
        still = replace(motion.only(chosen), turning=no_turning(1))
        found = find_paths(arm, world, still, near[met], np.zeros(met.sum(), np.int64), {})
        for row, path in zip(rows[met].tolist(), found, strict=True):
            paths[row] = path if path.q is None else replace(path, q=_own(robot, path.q))
    return paths


def fitted_bases(
    robot: Robot, motion: TaskMotion, poses: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Base poses beside given ones from which an arm of few joints follows the motion.

    Each is fitted to a few ways of holding, one after the other, until one fits; all ways get
    their share of the poses.

    Returns:
        Where each has come to, and the way by which the arm follows the motion there; -1 where none
        was found, and the pose stays as it is.
    """
    ways = _short_ways(motion)
    poses, found = poses.copy(), np.full(len(poses), -1)
    if not len(ways):
        return poses, found
    first, tries = _SPREAD * np.arange(len(poses)), min(len(ways), MOST_WAYS)
    for turn in range(tries):
        left = np.flatnonzero(found < 0)
        share = (first[left] + turn / tries) % 1.0
        chosen = ways[(share * len(ways)).astype(np.int64)]
        for way in np.unique(chosen).tolist():
            rows = left[chosen == way]
            moved, met = _beside(robot, motion, way, poses[rows])
            poses[rows[met]], found[rows[met]] = moved[met], way
    return poses, found


def _short_ways(motion: TaskMotion) -> Int[np.ndarray, " w"]:
    """The ways of holding by which an arm of few joints may follow a motion."""
    turning = motion.turning
    return np.arange(0 if _straight(motion) else len(turning.angles), turning.ways)


def _straight(motion: TaskMotion) -> bool:
    """Whether a hand that holds still is carried along straight lines, without a turn."""
    R = motion.Ts_world_tool[0, :, :3, :3]
    return bool(np.allclose(R, R[:1], atol=1e-9))


def _beside(
    robot: Robot, motion: TaskMotion, way: int, poses: Float[np.ndarray, "n 3"], tries: int = 1
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Base poses beside given ones from which an arm takes the tool poses of a way of holding at
    the ends and in the middle, and whether there are any."""
    arm, grasp = _held(robot, motion, way)
    steps = motion.waypoint_steps[[0, 1, len(motion.waypoint_steps) // 2, -1]]
    return fit_bases(arm.chain, arm.ik, poses, motion.Ts_world_tool[grasp, steps], tries=tries)


def _own(robot: Robot, q: Float[np.ndarray, "d m"]) -> Float[np.ndarray, "d n"]:
    """States of the arm itself, within its limits."""
    chain = robot.chain
    return np.clip(q[:, : chain.size], chain.lower, chain.upper)


def _held(robot: Robot, motion: TaskMotion, way: int) -> tuple[Arm, int]:
    """The arm that a way of holding is solved for, and the grasp whose tool poses it takes."""
    if way < len(motion.turning.angles):
        return robot, way
    return _turning_arm(robot, motion, way)


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
    beyond = np.where(robot.chain.prismatic, 0.0, ROUNDED)
    wider = replace(robot.chain, lower=robot.chain.lower - beyond, upper=robot.chain.upper + beyond)
    chain = with_tool_turn(wider, np.array(axis), ends[0], ends[1])
    return TurningArm(robot, chain, build_ik(chain))
