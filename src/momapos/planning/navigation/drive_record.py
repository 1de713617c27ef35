"""What came of a drive."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float


class DriveEnding(Enum):
    """Why a drive, or a part of one, ended before it arrived."""

    START_BLOCKED = "the start is in collision with"
    GOAL_BLOCKED = "the goal is in collision with"
    NO_PATH = "there is no way for the footprint"
    NO_PATH_AS_BELIEVED = "there is no way from where it believes to be"
    PATH_OCCUPIED = "a moving obstacle stands in the way"
    STUCK = "stuck"
    BESIDE_GOAL = "it believes to stand beside the goal"
    MISSED = "it stands"
    HIT = "it hit"
    TIMEOUT = "timeout"


@dataclass(frozen=True, eq=False)
class DriveRecord:
    """What came of a drive."""

    arrived: bool
    reason: str
    """Why it did not arrive; "" where it did."""
    goal: Float[np.ndarray, "3"]
    pose: Float[np.ndarray, "3"]
    """Where the base really stands: x [m], y [m], yaw [rad]."""
    believed: Float[np.ndarray, "3"]
    """Where the controller believes it to stand."""
    hit: str
    """What the base touched, which ended the drive; "" where it touched nothing."""
    planned: float
    """Length of the path as first planned [m]; infinite where there was none."""
    length: float
    """Meters driven."""
    time: float
    """Seconds it took."""
    clearance: float
    """Smallest distance of the true footprint to anything that stands [m], at most 0.5."""
    clearance_moving: float
    """Smallest distance to what moves [m]; infinite where nothing does."""
    ways: int
    """Paths that were planned [-]."""
    times: Float[np.ndarray, " t"]
    """Of the trace [s]."""
    poses: Float[np.ndarray, "t 3"]
    """True poses."""
    velocities: Float[np.ndarray, "t 3"]
    """True velocities in the base frame: vx [m/s], vy [m/s], yaw rate [rad/s]."""
    step_times: Float[np.ndarray, " k"]
    """Computing time of each control step [s]."""
    ending: DriveEnding | None = None
    """Why it did not arrive, as one of a few kinds; None where it did."""
