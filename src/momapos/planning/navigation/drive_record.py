"""Records of drives."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float


class DriveEnding(Enum):
    """Why a drive, or a part of one, ended before the goal."""

    START_BLOCKED = "the start is in collision with"
    GOAL_BLOCKED = "the goal is in collision with"
    NO_PATH = "there is no path for the footprint"
    NO_PATH_FROM_ESTIMATE = "there is no path from the estimated pose"
    PATH_OCCUPIED = "a moving obstacle blocks the path"
    STUCK = "stuck"
    OFF_GOAL = "the estimated pose is off the goal"
    MISSED = "it stopped"
    HIT = "it hit"
    IMPOSSIBLE = "the wheels cannot do that:"
    TIMEOUT = "timeout"


@dataclass(frozen=True, eq=False)
class DriveRecord:
    """Result and trace of a drive."""

    arrived: bool
    reason: str
    """Why it did not arrive; "" if it did."""
    goal: Float[np.ndarray, "3"]
    pose: Float[np.ndarray, "3"]
    """True final pose of the base: x [m], y [m], yaw [rad]."""
    estimated_pose: Float[np.ndarray, "3"]
    """Final pose as the controller estimates it."""
    hit: str
    """What the base touched, which ended the drive; "" for nothing."""
    planned: float
    """Length of the first planned path [m], infinite without one."""
    length: float
    """Distance driven [m]."""
    time: float
    """Duration [s]."""
    clearance: float
    """Smallest distance between the true footprint and the scene [m], at most 0.5."""
    clearance_moving: float
    """Smallest distance to moving obstacles [m], infinite without any."""
    paths: int
    """Number of planned paths [-]."""
    times: Float[np.ndarray, " t"]
    """Times of the trace [s]."""
    poses: Float[np.ndarray, "t 3"]
    """True poses."""
    velocities: Float[np.ndarray, "t 3"]
    """True velocities in the base frame: vx [m/s], vy [m/s], yaw rate [rad/s]."""
    step_times: Float[np.ndarray, " k"]
    """Computing time of each control step [s]."""
    ending: DriveEnding | None = None
    """Category of `reason`; None if it arrived."""
