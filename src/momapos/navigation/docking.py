"""The last stretch: to stand in the goal pose, not near it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from momapos.geometry.transforms import wrap_angle
from momapos.navigation.global_path import Path
from momapos.robots.robot import Robot

BEGIN = 0.25
"""Way that is left when docking begins [m]."""
_SPEED = 0.25
"""Fastest [m/s]."""
_SHARE = 0.5
"""Share of the base's accelerations that is planned with [-]."""
_LOOK = 0.15
"""A differential base heads for the point of its line this far ahead [m]."""
_CLOSE, _TURNED = 0.004, float(np.radians(0.4))
"""What is left when a base stops driving [m] and turning [rad]."""


def approach(left: float, acceleration: float, fastest: float, dt: float) -> float:
    """Velocity with which something left to go ends in a stop, without passing it."""
    speed = min(fastest, np.sqrt(2 * _SHARE * acceleration * abs(left)), 0.5 * abs(left) / dt)
    return float(np.copysign(speed, left))


@dataclass
class Docking:
    """Steers a base from the last straight leg of a way into its last pose.

    A differential base follows the line of that leg to its end, then turns on the spot: what is
    left beside the line stays, and is for a new way to mend. An omni base goes straight there.
    """

    robot: Robot
    path: Path
    dt: float
    turning: bool = False
    """Whether a differential base has come to the end of the line."""

    def begins(self, index: int) -> bool:
        """Whether an index of the way is on the last leg, and near its end."""
        path = self.path
        left = path.poses[-1, :2] - path.poses[index, :2]
        return index >= path.last and float(np.hypot(*left)) <= BEGIN

    def command(self, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Velocity for a believed pose: vx [m/s], vy [m/s], yaw rate [rad/s], base frame."""
        goal, robot = self.path.poses[-1], self.robot
        turn = float(wrap_angle(goal[2] - pose[2]))
        if robot.drive == "differential" and not self.turning:
            return self._along(pose)
        w = self._turn(turn)
        if robot.drive == "differential":
            return np.array([0.0, 0.0, w])
        c, s = np.cos(pose[2]), np.sin(pose[2])
        left = np.array([[c, s], [-s, c]]) @ (goal[:2] - pose[:2])
        distance = float(np.hypot(*left))
        if distance < _CLOSE:
            return np.array([0.0, 0.0, w])
        speed = approach(distance, robot.max_acceleration, self._fastest, self.dt)
        return np.array([*(left / distance * speed), w])

    def finished(self, pose: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]) -> bool:
        """Whether the base stands, and docking can do no more."""
        still = bool(np.hypot(velocity[0], velocity[1]) < 0.01 and abs(velocity[2]) < 0.02)
        goal = self.path.poses[-1]
        turned = abs(float(wrap_angle(goal[2] - pose[2]))) < 1.5 * _TURNED
        if self.robot.drive == "omni":
            return still and turned and float(np.hypot(*(goal - pose)[:2])) < 1.5 * _CLOSE
        return still and turned and self.turning

    @property
    def _fastest(self) -> float:
        return min(_SPEED, self.robot.max_speed)

    def _turn(self, left: float) -> float:
        if abs(left) < _TURNED:
            return 0.0
        robot = self.robot
        return approach(left, robot.max_yaw_acceleration, robot.max_yaw_rate, self.dt)

    def _along(self, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Follow the line to the goal's position, which may be ahead or behind."""
        goal, line = self.path.poses[-1], float(self.path.poses[self.path.last, 2])
        c, s = np.cos(line), np.sin(line)
        left, beside = np.array([[c, s], [-s, c]]) @ (goal[:2] - pose[:2])
        if abs(left) < _CLOSE:
            self.turning = True
            return np.zeros(3)
        v = approach(left, self.robot.max_acceleration, self._fastest, self.dt)
        wish = line + np.copysign(1.0, v) * np.arctan2(beside, _LOOK)
        # Steering is worth its turn only as far as there is way left to gain from it.
        wish = line + float(wrap_angle(wish - line)) * min(1.0, abs(left) / 0.05)
        w = self._turn(float(wrap_angle(wish - pose[2])))
        return np.array([v, 0.0, w])
