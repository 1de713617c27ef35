"""What moved in a run, as its record holds it, so that it can be shown again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

Triple = tuple[float, float, float]
DRIVE = "drive"
"""The stage in which the base drives."""
DIGITS = 4
"""Lengths and angles are kept to so many digits after the point [-]."""


@dataclass(frozen=True)
class RunMotion:
    """Several moments a second; all lists are as long as `times`, or empty."""

    times: tuple[float, ...]
    """From the beginning of the run, never falling [s]."""
    stages: tuple[str, ...]
    """drive, or one of `Stage`."""
    bases: tuple[Triple, ...]
    """Of the base: x [m], y [m], yaw [rad]."""
    joints: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Values of the robot's joints that move, by name: arm and fingers [rad] or [m]."""
    part: tuple[float, ...] = ()
    """Value of the joint that the task moves [rad] or [m]; empty for loose objects."""
    poses: tuple[tuple[float, ...], ...] = ()
    """Of a loose object's root link in the world: x, y, z [m], then the quaternion wxyz."""
    forces: tuple[Triple, ...] = ()
    """Of what is held on the hand, in the world [N]; 0 where it holds nothing."""

    def __post_init__(self) -> None:
        """Hold the lengths together; what reads records makes its own error of it."""
        lists = (self.stages, self.bases, *self.joints.values(), self.part, self.poses, self.forces)
        if any(len(one) not in (0, len(self.times)) for one in lists):
            raise ValueError(f"the lists of a motion do not all have {len(self.times)} moments")
        if len(self.bases) != len(self.times) or len(self.stages) != len(self.times):
            raise ValueError("a motion lacks stages or poses of the base")
        if any(b < a for a, b in pairwise(self.times)):
            raise ValueError("the times of a motion fall")
        if any(len(pose) != 7 for pose in self.poses):
            raise ValueError("a pose of a motion does not have 7 numbers")


def rounded(values: Sequence[float], digits: int = DIGITS) -> tuple[float, ...]:
    """Numbers without the digits that nobody sees."""
    return tuple(round(float(value), digits) for value in values)
