"""Motion of a base: velocity limits, and integration of velocities."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import wrap_angle
from momapos.model.robots import Robot

if TYPE_CHECKING:
    from jaxtyping import Float


def clip_velocity(
    robot: Robot, now: Float[np.ndarray, "3"], wish: Float[np.ndarray, "3"], dt: float
) -> Float[np.ndarray, "3"]:
    """Return the velocity that a base reaches after some time on its way to another velocity.

    Args:
        robot: The robot, with its speed and acceleration limits. Only an omni base has vy, and the
            yaw rate of a car-like base is at most that of its least turning radius.
        now: vx [m/s], vy [m/s], yaw rate [rad/s], base frame.
        wish: The commanded velocity, likewise.
        dt: Time [s].
    """
    wish = np.array(wish, float)
    if robot.drive != "omni":
        wish[1] = 0.0
    wish[:2] *= min(1.0, robot.max_speed / max(float(np.hypot(wish[0], wish[1])), 1e-12))
    wish[2] = np.clip(wish[2], -robot.max_yaw_rate, robot.max_yaw_rate)
    change = wish - now
    step = robot.max_acceleration * dt
    change[:2] *= min(1.0, step / max(float(np.hypot(change[0], change[1])), 1e-12))
    turn = robot.max_yaw_acceleration * dt
    change[2] = np.clip(change[2], -turn, turn)
    reached = now + change
    if robot.drive == "car":
        fastest = abs(reached[0]) / robot.min_turning_radius
        reached[2] = np.clip(reached[2], -fastest, fastest)
    return reached


def integrate(
    pose: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"], dt: float
) -> Float[np.ndarray, "3"]:
    """Integrate a constant velocity in the base frame exactly."""
    turn = velocity[2] * dt
    # sin(t) / t and (1 - cos(t)) / t, also for t = 0
    along = np.sinc(turn / np.pi) * dt
    across = np.sinc(turn / (2 * np.pi)) * np.sin(turn / 2) * dt
    x = along * velocity[0] - across * velocity[1]
    y = across * velocity[0] + along * velocity[1]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array(
        [pose[0] + c * x - s * y, pose[1] + s * x + c * y, float(wrap_angle(pose[2] + turn))]
    )
