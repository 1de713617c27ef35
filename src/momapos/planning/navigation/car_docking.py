"""Docking of a car-like base: follow the curves of its path exactly, to stop at the goal pose."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import local_points, wrap_angle
from momapos.model.robots import Robot

from .docking import STOP_DISTANCE, approach, docking_speed, is_stopped
from .global_path import BasePath

if TYPE_CHECKING:
    from jaxtyping import Float

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
