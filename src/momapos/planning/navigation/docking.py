"""The last stretch: to stand in the goal pose, not near it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import local_points, rotation, wrap_angle
from momapos.model.robots import Robot

from .global_path import BasePath

if TYPE_CHECKING:
    from jaxtyping import Float

BEGIN = 0.5
"""Length of path that is left when docking begins [m]."""
_SPEED = 0.3
"""Fastest [m/s]."""
_SHARE = 0.5
"""Share of the base's accelerations that is planned with [-]."""
_LOOK = 0.15
"""A differential base heads for the point of its line this far ahead [m]."""
_CLOSE, _TURNED = 0.004, float(np.radians(0.4))
"""What is left when a base stops driving [m] and turning [rad]."""
_ON_LINE = 0.15
"""Difference from the line that a moving base steers away on its way [rad]."""
_AHEAD = 0.06
"""An omni base heads for the pose of its path this far ahead [m]."""


def approach(left: float, acceleration: float, fastest: float, dt: float) -> float:
    """Velocity with which something left to go ends in a stop, without passing it."""
    speed = min(fastest, np.sqrt(2 * _SHARE * acceleration * abs(left)), 0.5 * abs(left) / dt)
    return float(np.copysign(speed, left))


class Docking:
    """Follows a path exactly, leg by leg, and stops in its last pose.

    A differential base turns to the line of a leg, follows it to its end, and turns on the spot; an
    omni base goes from pose to pose of the path.
    """

    def __init__(self, robot: Robot, path: BasePath, dt: float) -> None:
        """Prepare to follow a path.

        Args:
            robot: What is steered.
            path: The path.
            dt: Time between commands [s].
        """
        self.robot, self.path, self.dt = robot, path, dt
        self.leg, self.phase, self.index = 0, "aim", 0
        self.line = 0.0

    def command(
        self, pose: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "3"]:
        """Velocity for a believed pose: vx [m/s], vy [m/s], yaw rate [rad/s], base frame."""
        if self.robot.drive == "omni":
            return self._along_poses(pose)
        nodes = self.path.nodes
        if self.phase == "turn":
            turn = float(wrap_angle(nodes[self.leg + 1, 2] - pose[2]))
            if abs(turn) > 1.5 * _TURNED or not stands(velocity) or self.leg == len(nodes) - 2:
                return np.array([0.0, 0.0, self._turn(turn)])
            self.leg, self.phase = self.leg + 1, "aim"
        left = nodes[self.leg + 1, :2] - pose[:2]
        if self.phase == "aim":
            step = nodes[self.leg + 1, :2] - nodes[self.leg, :2]
            if np.hypot(*step) < _CLOSE:
                self.phase = "turn"
                return np.zeros(3)
            # From where it stands, not from where the leg begins.
            toward = left if np.hypot(*left) > 0.1 else step
            self.line = np.arctan2(toward[1], toward[0]) + np.pi * self.path.backwards[self.leg]
            turn = float(wrap_angle(self.line - pose[2]))
            if abs(turn) > (_TURNED * 3 if stands(velocity) else _ON_LINE):
                return np.array([0.0, 0.0, self._turn(turn)])
            self.phase = "along"
        return self._along(pose, left)

    def finished(self, pose: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]) -> bool:
        """Whether the base stands where the path ends."""
        goal = self.path.poses[-1]
        turned = abs(float(wrap_angle(goal[2] - pose[2]))) < 2 * _TURNED
        if self.robot.drive == "omni":
            return stands(velocity) and turned and float(np.hypot(*(goal - pose)[:2])) < 2 * _CLOSE
        last = self.phase == "turn" and self.leg == len(self.path.nodes) - 2
        return stands(velocity) and turned and last

    @property
    def _fastest(self) -> float:
        return min(_SPEED, self.robot.max_speed)

    def _turn(self, left: float) -> float:
        if abs(left) < _TURNED:
            return 0.0
        robot = self.robot
        return approach(left, robot.max_yaw_acceleration, robot.max_yaw_rate, self.dt)

    def _along_poses(self, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Toward the pose of the path a little ahead, turning as evenly as the path does."""
        path = self.path
        self.index = path.follow(pose, self.index, _AHEAD)
        near = int(np.searchsorted(path.s, path.s[self.index] + _AHEAD))
        goal = path.poses[min(near, len(path.poses) - 1)]
        (step,) = local_points(pose, goal[None, :2])
        distance, turn = float(np.hypot(*step)), float(wrap_angle(goal[2] - pose[2]))
        rest = path.s[-1] - path.s[min(near, len(path.s) - 1)]
        robot = self.robot
        v = approach(distance + rest, robot.max_acceleration, self._fastest, self.dt)
        w = self._turn(turn)
        if distance < _CLOSE:
            return np.array([0.0, 0.0, w])
        if rest > 0 and abs(turn) > _TURNED:
            pace = min(v / distance, abs(w) / abs(turn))
            v, w = pace * distance, pace * turn
        return np.array([*(step / distance * v), w])

    def _along(
        self, pose: Float[np.ndarray, "3"], left_world: Float[np.ndarray, "2"]
    ) -> Float[np.ndarray, "3"]:
        """Follow the line to the end of the leg, which may be ahead or behind."""
        left, beside = left_world @ rotation(self.line)
        if abs(left) < _CLOSE:
            self.phase = "turn"
            return np.zeros(3)
        v = approach(left, self.robot.max_acceleration, self._fastest, self.dt)
        bend = np.copysign(1.0, v) * np.arctan2(beside, _LOOK)
        # Steering is worth its turn only as far as there is path left to gain from it.
        wish = self.line + bend * min(1.0, abs(left) / 0.05)
        return np.array([v, 0.0, self._turn(float(wrap_angle(wish - pose[2])))])


def stands(velocity: Float[np.ndarray, "3"]) -> bool:
    """Whether a base has all but stopped."""
    return bool(np.hypot(velocity[0], velocity[1]) < 0.01 and abs(velocity[2]) < 0.02)


def aimed(robot: Robot, path: BasePath) -> bool:
    """Whether a base can begin to follow a path without a turn on the spot."""
    if robot.drive == "omni":
        return True
    step = path.nodes[1, :2] - path.nodes[0, :2]
    line = np.arctan2(step[1], step[0]) + np.pi * path.backwards[0]
    return abs(float(wrap_angle(line - path.nodes[0, 2]))) < _ON_LINE


def can_stop(robot: Robot, velocity: Float[np.ndarray, "3"], left: float) -> bool:
    """Whether a base comes to stand within some length [m] at the deceleration planned with."""
    distance = float(velocity[0] ** 2 + velocity[1] ** 2) / (2 * _SHARE * robot.max_acceleration)
    return distance < left
