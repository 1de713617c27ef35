"""The path of a base that moves with the arm, and its limits of speed and acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.robots import Robot

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class BasePath:
    """Base poses at the states of an arm path, and the limits of the base."""

    poses: Float[np.ndarray, "m 3"]
    """x [m], y [m], yaw [rad], without jumps of a turn."""
    speed: Float[np.ndarray, "3"]
    """Speed limits of x, y and yaw; that of x holds for the norm of x and y, too."""
    acceleration: Float[np.ndarray, "3"]
    """Acceleration limits of x, y and yaw."""


def limited_base_path(robot: Robot, poses: Float[np.ndarray, "m 3"], share: float) -> BasePath:
    """Return a base path with the limits of a robot.

    Args:
        robot: The robot.
        poses: x [m], y [m], yaw [rad], without jumps of a turn.
        share: Share of the base's speed limits used [-].
    """
    apart = robot.max_acceleration / np.sqrt(2.0)  # in x and in y, so that both together keep it
    return BasePath(
        poses,
        share * np.array([robot.max_speed, robot.max_speed, robot.max_yaw_rate]),
        np.array([apart, apart, robot.max_yaw_acceleration]),
    )
