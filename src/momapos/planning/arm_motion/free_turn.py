"""Plan for arms with fewer or more joints than a tool pose needs.

An arm of fewer joints reaches few tool poses exactly, so it can hardly move a rigid grasp along an
arc. If the hand may turn about the bar that it holds, the turn becomes an additional joint without
links, which inverse kinematics solves like the others. Along a straight line such an arm can also
move a rigid grasp, but only from base poses on a curve: samples are moved to that curve.

With more joints, the path search chooses a posture at each waypoint, so that joints turn back and
forth between them while the tool moves evenly; the arm would stop at each turn.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import wrap_angle
from momapos.model.collision import FREE, CollisionWorld
from momapos.model.kinematics import build_ik, fit_bases, meets_somewhere, with_tool_turn
from momapos.model.robots import Robot
from momapos.planning.grasps import FULL_DOF, TaskMotion, no_turning

from .arm_path import UNREACHABLE, ArmPath, find_paths, follow
from .ik_layers import ArmModel, TurningArm

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


MAX_OFFSET, MAX_TURN = 0.008, float(np.radians(0.8))
"""Maximum distance of a base pose to one from which the arm follows exactly [m], [rad]; a drive
ends that close."""
TRIES = 8
"""Arm states from which such a base pose is solved for [-]."""
LIMIT_SLACK = 0.002
"""Joint limits are widened for inverse kinematics, and the solution clipped [rad]: files round half
a turn to 3.14."""
MAX_FITTED_MODES = 4
"""Maximum number of grasp modes to which a base pose is fitted [-]."""
FEWEST_STARTS, MOST_STARTS, STARTS = 12, 96, 1000
"""Base poses for each tool pose from which a mode is examined, and in all modes together
[-]. Of modes that turn about a bar, 1 in 30 of them meets; the many modes of drawers are alike."""
LINE_LENGTHS = (0.05, 0.1, 0.2)
"""Lengths of a straight line on which a mode is examined before the whole line, the shortest first
[m]. Most modes fail on the first; its result serves all tasks with this direction."""
_GOLDEN_RATIO = 0.5 * (5.0**0.5 - 1.0)
"""Its multiples modulo 1 are spread evenly, for any count [-]."""
_MAX_ARMS, _MAX_FITS = 64, 1024
"""Number of arms with a turning hand that are cached for a robot, and of modes for an arm [-]; a
question about a drawer has some hundred modes."""
_DIGITS = 6
"""Decimals to which axes and angles are rounded [-]."""


def find_short_paths(
    robot: Robot,
    world: CollisionWorld,
    motion: TaskMotion,
    bases: Float[np.ndarray, "j 3"],
    modes: Int[np.ndarray, " j"],
) -> list[ArmPath]:
    """Search an arm path for each pair of base pose and grasp mode, see `find_paths`.

    Rigid grasps are moved along straight lines only. A base pose within millimeters of one from
    which the arm follows exactly gets the states of that one: the pads and the play of the grasp
    absorb the difference, and the exact check measures how far the hand then slips.
    """
    paths = [ArmPath(UNREACHABLE, 0, 0, FREE)] * len(modes)
    feasible = np.flatnonzero(np.isin(modes, _feasible_modes(robot, motion)))
    for mode in np.unique(modes[feasible]).tolist():
        rows = feasible[modes[feasible] == mode]
        near, met = _fit(robot, motion, mode, bases[rows], TRIES)
        off = near - bases[rows]
        met &= np.hypot(off[:, 0], off[:, 1]) <= MAX_OFFSET
        met &= abs(wrap_angle(off[:, 2])) <= MAX_TURN
        arm, grasp = _arm_of(robot, motion, mode)
        chosen = np.arange(len(motion.Ts_world_tool)) == grasp
        rigid = replace(motion.only(chosen), turning=no_turning(1))
        found = find_paths(arm, world, rigid, near[met], np.zeros(met.sum(), np.int64), {})
        for row, path in zip(rows[met].tolist(), found, strict=True):
            own = None if path.q is None else _own(robot, path.q)
            paths[row] = replace(path, q=own, hit=None)  # its states are those of another arm
    return paths


def fitted_bases(
    robot: Robot, motion: TaskMotion, poses: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Move base poses to nearby ones from which an arm of few joints follows the motion.

    Each pose is fitted to a few grasp modes until one fits; the modes are spread over the poses.

    Returns:
        The fitted poses, and the grasp mode of each; -1 for an unchanged pose without fit.
    """
    modes = _feasible_modes(robot, motion)
    poses, found = poses.copy(), np.full(len(poses), -1)
    if not len(modes):
        return poses, found
    first, tries = _GOLDEN_RATIO * np.arange(len(poses)), min(len(modes), MAX_FITTED_MODES)
    for turn in range(tries):
        left = np.flatnonzero(found < 0)
        share = (first[left] + turn / tries) % 1.0
        chosen = modes[(share * len(modes)).astype(np.int64)]
        for mode in np.unique(chosen).tolist():
            rows = left[chosen == mode]
            moved, met = _fit(robot, motion, mode, poses[rows])
            poses[rows[met]], found[rows[met]] = moved[met], mode
    return poses, found


@owner_cache(16)
def _feasible_modes(robot: Robot, motion: TaskMotion) -> Int[np.ndarray, " w"]:
    """Return the grasp modes by which an arm of few joints follows a motion from somewhere.

    Fits from samples near the task rarely succeed, those from the most promising base poses usually
    do, if any can. So a mode without one is left out at once.
    """
    turning = motion.turning
    modes = range(0 if _straight(motion) else len(turning.angles), turning.modes)
    starts = min(MOST_STARTS, max(FEWEST_STARTS, STARTS // max(len(modes), 1)))
    return np.array([mode for mode in modes if _is_feasible(robot, motion, mode, starts)], np.int64)


def _is_feasible(robot: Robot, motion: TaskMotion, mode: int, count: int) -> bool:
    """Return whether the arm follows a mode from some of the most promising base poses."""
    arm, Ts = _arm_and_poses(robot, motion, mode)
    # Where the task is does not matter: grasps of one bar are alike.
    Ts = Ts.copy()
    Ts[:, :2, 3] -= Ts[0, :2, 3]
    rigid = mode < len(motion.turning.angles)
    return all(
        _meets(arm, (np.round(some, _DIGITS) + 0.0).tobytes(), count)
        for some in (_shorter_lines(Ts) if rigid else (Ts,))
    )


def _shorter_lines(Ts: Float[np.ndarray, "4 4 4"]) -> Iterator[Float[np.ndarray, "4 4 4"]]:
    """Yield the tool poses of shorter straight motions, the shortest first, then the given ones."""
    line = Ts[3, :3, 3] - Ts[1, :3, 3]
    length = float(np.linalg.norm(line))
    for shorter in LINE_LENGTHS:
        if shorter < length:
            some = Ts.copy()
            some[2:, :3, 3] = Ts[1, :3, 3] + line * (shorter / length * np.array([[0.5], [1.0]]))
            yield some
    yield Ts


@owner_cache(_MAX_FITS)
def _meets(arm: ArmModel, poses: bytes, count: int) -> bool:
    """Return whether base poses reach tool poses (4, 4, 4), given as their bytes."""
    return meets_somewhere(arm.chain, arm.ik, np.frombuffer(poses).reshape(-1, 4, 4), count)


def _straight(motion: TaskMotion) -> bool:
    """Check that a rigid grasp moves without rotation."""
    R = motion.Ts_world_tool[0, :, :3, :3]
    return bool(np.allclose(R, R[:1], atol=1e-9))


def _fit(
    robot: Robot, motion: TaskMotion, mode: int, poses: Float[np.ndarray, "n 3"], tries: int = 1
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Fit base poses so that the arm reaches a mode's tool poses at the ends and in the middle."""
    arm, Ts = _arm_and_poses(robot, motion, mode)
    return fit_bases(arm.chain, arm.ik, poses, Ts, tries=tries)


def _arm_and_poses(
    robot: Robot, motion: TaskMotion, mode: int
) -> tuple[ArmModel, Float[np.ndarray, "4 4 4"]]:
    """Return the arm to solve a mode for, and its tool poses at the ends and in the middle."""
    arm, grasp = _arm_of(robot, motion, mode)
    steps = motion.waypoint_steps[[0, 1, len(motion.waypoint_steps) // 2, -1]]
    return arm, motion.Ts_world_tool[grasp, steps]


def _own(robot: Robot, q: Float[np.ndarray, "d m"]) -> Float[np.ndarray, "d n"]:
    """Remove the hand's turn from arm states, and clip them to the joint limits."""
    chain = robot.chain
    return np.clip(q[:, : chain.size], chain.lower, chain.upper)


def _arm_of(robot: Robot, motion: TaskMotion, mode: int) -> tuple[ArmModel, int]:
    """Return the arm to solve a grasp mode for, and the grasp that gives its tool poses."""
    if mode < len(motion.turning.angles):
        return robot, mode
    return _turning_arm(robot, motion, mode)


def _turning_arm(robot: Robot, motion: TaskMotion, mode: int) -> tuple[TurningArm, int]:
    """Return the arm with the turn of its hand, and the grasp from which it turns.

    The middle grasp stands for all of the mode: the hand turns from it to both ends.
    """
    turning = motion.turning
    members = turning.members(np.array([mode]))[0]
    members = members[members >= 0]
    angles = turning.angles[members]
    middle = int(members[np.argsort(angles)[len(members) // 2]])
    axis = turning.axis @ turning.R_part_tool[middle]
    ends = turning.angles[middle] - np.array([angles.max(), angles.min()])
    return _arm_about(robot, _rounded(axis), _rounded(ends)), middle


def _rounded(values: np.ndarray) -> tuple[float, ...]:
    return tuple((np.round(values, _DIGITS) + 0.0).tolist())


@owner_cache(_MAX_ARMS)
def _arm_about(robot: Robot, axis: tuple[float, ...], ends: tuple[float, ...]) -> TurningArm:
    slack = np.where(robot.chain.prismatic, 0.0, LIMIT_SLACK)
    wider = replace(robot.chain, lower=robot.chain.lower - slack, upper=robot.chain.upper + slack)
    chain = with_tool_turn(wider, np.array(axis), ends[0], ends[1])
    return TurningArm(robot, chain, build_ik(chain))


SPREADS = (6.0, 3.0)
"""Standard deviations of the filter that are tried, in steps. Waypoints are four steps apart."""


def smooth_posture(arm: ArmModel, q: Float[np.ndarray, "d n"]) -> Float[np.ndarray, "d n"] | None:
    """Return states with the same tool poses and ends whose joints move more evenly.

    Args:
        arm: The arm.
        q: States, close together.

    Returns:
        The states; None for an arm without spare joints, or if it does not get there.
    """
    if arm.chain.size <= FULL_DOF or len(q) < 4:
        return None
    targets = arm.chain.tool_poses(q)
    for spread in SPREADS:
        near = np.clip(_smoothed(q, spread), arm.chain.lower, arm.chain.upper)
        found = follow(arm, near, targets)
        if found is not None:
            found[[0, -1]] = q[[0, -1]]
            return found
    return None


def _smoothed(q: Float[np.ndarray, "d n"], spread: float) -> Float[np.ndarray, "d n"]:
    """Filter states by a Gaussian that ends at four standard deviations (`spread`, in steps)."""
    radius = int(4 * spread)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / spread) ** 2)
    more = min(len(q) - 1, radius)
    # Reflected at its ends, the path keeps them.
    padded = np.pad(q, ((more, more), (0, 0)), mode="reflect", reflect_type="odd")
    padded = np.pad(padded, ((radius - more,) * 2, (0, 0)), mode="symmetric")
    windows = np.lib.stride_tricks.sliding_window_view(padded, len(weights), axis=0)
    return np.asarray(windows @ (weights / weights.sum()))
