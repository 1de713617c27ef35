"""Docking: follow the last part of a path exactly, to stop at the goal pose."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import local_points, rotation, wrap_angle
from momapos.model.robots import Robot

from .global_path import BasePath

if TYPE_CHECKING:
    from jaxtyping import Float


DOCKING_DISTANCE = 0.5
"""Remaining path length at which docking begins [m]."""
_MAX_SPEED = 0.3
"""Largest speed while docking [m/s]."""
_ACCELERATION_SHARE = 0.5
"""Share of the base's acceleration limits that docking uses [-]."""
_LOOKAHEAD = 0.15
"""Lookahead distance of a differential base on its line [m]."""
STOP_DISTANCE, _STOP_ANGLE = 0.004, float(np.radians(0.4))
"""Remaining distance [m] and angle [rad] at which a base stops driving or turning."""
_MAX_HEADING_ERROR = 0.15
"""Largest heading error at the start of a leg that a moving base corrects while driving [rad]."""
_OMNI_LOOKAHEAD = 0.06
"""Lookahead distance of an omni base on its path [m]."""


def approach(left: float, acceleration: float, fastest: float, dt: float) -> float:
    """Return the signed velocity that stops after a remaining distance without overshoot."""
    braking = np.sqrt(2 * _ACCELERATION_SHARE * acceleration * abs(left))
    speed = min(fastest, braking, 0.5 * abs(left) / dt)
    return float(np.copysign(speed, left))


def docking_speed(robot: Robot, left: float) -> float:
    """Return the largest speed at a remaining distance [m/s]: slow where docking begins."""
    return robot.max_speed if left > DOCKING_DISTANCE else min(_MAX_SPEED, robot.max_speed)


class Docking:
    """Follows a path exactly, leg by leg, and stops at its last pose.

    A differential base turns to the line of a leg, follows it to its end, and turns on the spot; an
    omni base goes from pose to pose of the path.
    """

    def __init__(self, robot: Robot, path: BasePath, dt: float) -> None:
        """Prepare to follow a path with a command every `dt` seconds."""
        self.robot, self.path, self.dt = robot, path, dt
        self.leg, self.phase, self.index = 0, "aim", 0
        self.line = 0.0

    def command(
        self, pose: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "3"]:
        """Return the velocity at an estimated pose: vx, vy [m/s], yaw rate [rad/s], base frame."""
        if self.robot.drive == "omni":
            return self._along_poses(pose)
        nodes = self.path.nodes
        if self.phase == "turn":
            turn = float(wrap_angle(nodes[self.leg + 1, 2] - pose[2]))
            if (
                abs(turn) > 1.5 * _STOP_ANGLE
                or not is_stopped(velocity)
                or self.leg == len(nodes) - 2
            ):
                return np.array([0.0, 0.0, self._turn(turn)])
            self.leg, self.phase = self.leg + 1, "aim"
        left = nodes[self.leg + 1, :2] - pose[:2]
        if self.phase == "aim":
            step = nodes[self.leg + 1, :2] - nodes[self.leg, :2]
            if np.hypot(*step) < STOP_DISTANCE:
                self.phase = "turn"
                return np.zeros(3)
            # Aim from the present pose, not from the start of the leg.
            toward = left if np.hypot(*left) > 0.1 else step
            self.line = np.arctan2(toward[1], toward[0]) + np.pi * self.path.backwards[self.leg]
            turn = float(wrap_angle(self.line - pose[2]))
            if abs(turn) > (_STOP_ANGLE * 3 if is_stopped(velocity) else _MAX_HEADING_ERROR):
                return np.array([0.0, 0.0, self._turn(turn)])
            self.phase = "along"
        return self._along(pose, left)

    def finished(self, pose: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]) -> bool:
        """Check whether the base has stopped at the end of the path."""
        goal = self.path.poses[-1]
        turned = abs(float(wrap_angle(goal[2] - pose[2]))) < 2 * _STOP_ANGLE
        if self.robot.drive == "omni":
            return (
                is_stopped(velocity)
                and turned
                and float(np.hypot(*(goal - pose)[:2])) < 2 * STOP_DISTANCE
            )
        last = self.phase == "turn" and self.leg == len(self.path.nodes) - 2
        return is_stopped(velocity) and turned and last

    @property
    def _fastest(self) -> float:
        return min(_MAX_SPEED, self.robot.max_speed)

    def _turn(self, left: float) -> float:
        if abs(left) < _STOP_ANGLE:
            return 0.0
        robot = self.robot
        return approach(left, robot.max_yaw_acceleration, robot.max_yaw_rate, self.dt)

    def _along_poses(self, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Head for the path's pose at the lookahead distance, turning at the path's rate."""
        path = self.path
        self.index = path.follow(pose, self.index, _OMNI_LOOKAHEAD)
        near = int(np.searchsorted(path.s, path.s[self.index] + _OMNI_LOOKAHEAD))
        goal = path.poses[min(near, len(path.poses) - 1)]
        (step,) = local_points(pose, goal[None, :2])
        distance, turn = float(np.hypot(*step)), float(wrap_angle(goal[2] - pose[2]))
        rest = path.s[-1] - path.s[min(near, len(path.s) - 1)]
        robot = self.robot
        v = approach(distance + rest, robot.max_acceleration, self._fastest, self.dt)
        w = self._turn(turn)
        if distance < STOP_DISTANCE:
            return np.array([0.0, 0.0, w])
        if rest > 0 and abs(turn) > _STOP_ANGLE:
            pace = min(v / distance, abs(w) / abs(turn))
            v, w = pace * distance, pace * turn
        return np.array([*(step / distance * v), w])

    def _along(
        self, pose: Float[np.ndarray, "3"], left_world: Float[np.ndarray, "2"]
    ) -> Float[np.ndarray, "3"]:
        """Follow the line to the end of the leg, forwards or backwards."""
        left, offset = left_world @ rotation(self.line)
        if abs(left) < STOP_DISTANCE:
            self.phase = "turn"
            return np.zeros(3)
        v = approach(left, self.robot.max_acceleration, self._fastest, self.dt)
        bend = np.copysign(1.0, v) * np.arctan2(offset, _LOOKAHEAD)
        # Steer less near the end of the leg, where it no longer helps.
        wish = self.line + bend * min(1.0, abs(left) / 0.05)
        return np.array([v, 0.0, self._turn(float(wrap_angle(wish - pose[2])))])


def is_stopped(velocity: Float[np.ndarray, "3"]) -> bool:
    """Check whether a base has almost stopped."""
    return bool(np.hypot(velocity[0], velocity[1]) < 0.01 and abs(velocity[2]) < 0.02)


def is_aligned(robot: Robot, path: BasePath) -> bool:
    """Check whether an omni or differential base can follow a path without turning first."""
    if robot.drive == "omni":
        return True
    step = path.nodes[1, :2] - path.nodes[0, :2]
    line = np.arctan2(step[1], step[0]) + np.pi * path.backwards[0]
    return abs(float(wrap_angle(line - path.nodes[0, 2]))) < _MAX_HEADING_ERROR


def can_stop(robot: Robot, velocity: Float[np.ndarray, "3"], left: float) -> bool:
    """Check whether a base can stop within a distance [m] at the deceleration of docking."""
    deceleration = _ACCELERATION_SHARE * robot.max_acceleration
    return float(velocity[0] ** 2 + velocity[1] ** 2) / (2 * deceleration) < left


_CORRECTION_LENGTH = 0.2
"""Distance over which deviations are corrected, with critical damping [m]. Twelve drives with a
radius of 1 m in `kitchen_small` take 19 paths with 0.1 and 0.2, and 21 with 0.4."""
_PREVIEW = 0.15
"""Time by which the path's curvature is looked up ahead [s], because the yaw rate changes slowly:
about half the time that it takes to turn in at 0.3 m/s and 1 rad/s^2."""


class CarDocking:
    """Follows a path, and stops at each of its cusps and at its last pose.

    The curvature command is that of the path with a linear feedback of the offset and the heading
    error, as in a kinematic car's chained form (Samson 1995), within the least turning radius.
    """

    def __init__(self, robot: Robot, path: BasePath, dt: float) -> None:
        """Prepare to follow a path with a command every `dt` seconds."""
        self.robot, self.path, self.dt = robot, path, dt
        step, turn = np.diff(path.poses[:, :2], axis=0), wrap_angle(np.diff(path.poses[:, 2]))
        middle = path.poses[:-1, 2] + turn / 2
        move = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)
        self._way = np.where(move < 0, -1.0, 1.0)
        self._curvature = turn / np.where(np.abs(move) > 1e-9, move, np.inf)
        self._driven = np.concatenate([[0.0], np.cumsum(np.abs(move))])
        cusps = np.flatnonzero(np.diff(self._way) != 0) + 1
        self._stretches = list(pairwise([0, *cusps.tolist(), len(move)])) if len(move) else []
        self._stretch, self.index = 0, 0

    def command(
        self, pose: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "3"]:
        """Return the velocity at an estimated pose: vx, vy [m/s], yaw rate [rad/s], base frame."""
        if self._stretch == len(self._stretches):
            return np.zeros(3)
        first, last = self._stretches[self._stretch]
        way = self._way[first]
        left = self._follow(pose, last, way)
        if left < STOP_DISTANCE:
            if is_stopped(velocity):
                self._stretch, self.index = self._stretch + 1, last
            return np.zeros(3)
        v = way * approach(
            left, self.robot.max_acceleration, docking_speed(self.robot, left), self.dt
        )
        sharpest = 1 / self.robot.min_turning_radius
        bend = np.clip(self._bend(pose, velocity, last, way), -sharpest, sharpest)
        # The slower turns of the limit apply to the speed: the curvature stays.
        pace = min(1.0, self.robot.max_yaw_rate / max(abs(bend * v), 1e-9))
        return np.array([v * pace, 0.0, bend * v * pace])

    def finished(self, _pose: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]) -> bool:
        """Check whether the base has stopped at the end of the path."""
        return self._stretch == len(self._stretches) and is_stopped(velocity)

    def _follow(self, pose: Float[np.ndarray, "3"], last: int, way: float) -> float:
        """Advance the index to the pose nearest to the base; return what is left to the cusp."""
        poses = self.path.poses
        end = min(int(np.searchsorted(self._driven, self._driven[self.index] + 0.3)) + 1, last + 1)
        away = np.hypot(*(poses[self.index : end, :2] - pose[:2]).T)
        self.index += int(np.argmin(away))
        (ahead,) = local_points(poses[self.index], pose[None, :2])
        return float(self._driven[last] - self._driven[self.index] - way * ahead[0])

    def _bend(
        self, pose: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"], last: int, way: float
    ) -> float:
        """Return the curvature that leads back to the path [1/m]."""
        reference = self.path.poses[self.index]
        (away,) = local_points(reference, pose[None, :2])
        soon = self._driven[self.index] + _PREVIEW * abs(float(velocity[0]))
        at = min(int(np.searchsorted(self._driven, soon, side="right")) - 1, last - 1)
        near = self._curvature[min(self.index, last - 1)]
        # The heading of the path where the base is, not at the pose before or after.
        turn = float(wrap_angle(pose[2] - reference[2] - near * away[0]))
        offset = away[1] - near * away[0] ** 2 / 2
        k = 1 / _CORRECTION_LENGTH
        return float(self._curvature[at] - way * 2 * k * turn - k * k * offset)
