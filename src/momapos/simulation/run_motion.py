"""Recorded motion of a run, for playback."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, pairwise

Triple = tuple[float, float, float]
DRIVE = "drive"
"""Stage in which the base drives."""
DIGITS = 4
"""Decimal digits of recorded lengths and angles [-]."""
MAX_SECONDS = 3600.0
"""Longest motion; at 10 samples a second, a longer one hardly fits into a file [s]."""
MAX_COORDINATE = 1e4
"""Largest joint value and coordinate [rad] or [m]."""
MAX_UNIT_ERROR = 0.01
"""Largest error of the length of a rounded unit quaternion [-]."""
MAX_FORCE = 1e6
"""Largest component of a force [N]."""


@dataclass(frozen=True)
class RunMotion:
    """Samples of a run; every list has the length of `times`, or is empty."""

    times: tuple[float, ...]
    """Time since the start of the run, non-decreasing [s]."""
    stages: tuple[str, ...]
    """drive, or one of `Stage`."""
    bases: tuple[Triple, ...]
    """Pose of the base: x [m], y [m], yaw [rad]."""
    joints: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Values of the robot's moving joints by name: arm and fingers [rad] or [m]."""
    part: tuple[float, ...] = ()
    """Value of the joint that the task moves [rad] or [m]; empty for movable objects."""
    poses: tuple[tuple[float, ...], ...] = ()
    """Pose of a movable object's root link in the world: x, y, z [m], then quaternion wxyz."""
    forces: tuple[Triple, ...] = ()
    """Force of the held object on the hand, in the world [N]; 0 without a grasp."""
    latch: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Values of the part's latch by the name of its joint [rad] or [m]; empty if none is turned."""

    def __post_init__(self) -> None:
        """Check the lengths and the times."""
        lists = (self.stages, self.bases, *self.joints.values(), self.part, self.poses, self.forces)
        if any(len(one) not in (0, len(self.times)) for one in lists):
            raise ValueError(f"each list of a motion must be empty or have {len(self.times)} items")
        if any(len(one) != len(self.times) for one in self.latch.values()):
            raise ValueError("the values of a latch must be as long as the times of its motion")
        if len(self.bases) != len(self.times) or len(self.stages) != len(self.times):
            raise ValueError("stages and bases of a motion must be as long as its times")
        if any(b < a for a, b in pairwise(self.times)):
            raise ValueError("the times of a motion must not decrease")
        if any(len(pose) != 7 for pose in self.poses):
            raise ValueError("each pose of a motion must have 7 numbers")

    def check_numbers(self) -> None:
        """Check that all numbers of a file are of a possible size.

        Raises:
            ValueError: One is not; the message names its kind.
        """
        values = (self.part, *self.joints.values(), *self.latch.values(), *self.bases, *self.poses)
        for name, most, numbers in (
            ("times [s]", MAX_SECONDS, iter(self.times)),
            ("values and poses [rad], [m]", MAX_COORDINATE, chain.from_iterable(values)),
            ("forces [N]", MAX_FORCE, chain.from_iterable(self.forces)),
        ):
            _check_range(name, most, numbers)
        if any(abs(math.hypot(*pose[3:]) - 1.0) > MAX_UNIT_ERROR for pose in self.poses):
            raise ValueError("each pose of a motion must end with a unit quaternion")


def _check_range(name: str, most: float, numbers: Iterable[float]) -> None:
    for number in numbers:
        if not abs(number) <= most:
            raise ValueError(
                f"the {name} of a motion must be finite and at most {most:g}, not {number:g}"
            )


def rounded(values: Sequence[float], digits: int = DIGITS) -> tuple[float, ...]:
    """Round numbers to the digits that a record keeps."""
    return tuple(round(float(value), digits) for value in values)
