"""What becomes of a base pose, and how reports say it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum


class PoseStatus(Enum):
    """What can become of a base pose; the value is its wording, with what `PoseOutcome` adds."""

    FEASIBLE = "feasible"
    PATH_FOUND = "path found, approach not checked"
    NOT_TRIED = "not tried"
    FILTERED = "ruled out beforehand"
    NOT_KEPT_IN = "outside the areas to keep in"
    NOT_KEPT_OUT = "in an area to keep out of"
    NOT_FACING = "facing away"
    TOO_LONG_A_DRIVE = "farther to drive than allowed"
    BASE_BLOCKED = "base blocked"
    OFF_FLOOR = "base off the floor"
    BEYOND_ARM = "farther than the arm"
    NO_ROUTE = "no way to drive there"
    NO_ROUTE_AT_HOME = "no way to drive there with the arm at home"
    OUT_OF_REACH = "out of reach"
    TOO_FEW_JOINTS = "the arm has too few joints to follow the motion from there"
    OUT_OF_REACH_ANYWHERE = "out of reach{detail} at any distance"
    TASK_INFEASIBLE = "{detail}"
    NO_GRASP_IN_REACH = "no grasp within reach"
    HOME_COLLISION = "arm at home hits {detail}"
    WAYPOINT_OUT_OF_REACH = "out of reach at {where}"
    ARM_COLLISION = "arm hits {detail} at {where}"
    NO_CONTINUOUS_PATH = "no continuous branch"
    NO_APPROACH = "no approach from home found within the arm planner's time"
    NO_WAY_HOME = "no way of the arm home again found within the arm planner's time"
    EXACT_CHECK = "exact check: {detail}"
    NOT_FOR_ALL = "not for all tasks: {detail}"
    LITTLE_ROOM = "not everywhere within {detail} of it"


RULED_OUT = (
    PoseStatus.NOT_KEPT_IN, PoseStatus.NOT_KEPT_OUT, PoseStatus.NOT_FACING,
    PoseStatus.TOO_LONG_A_DRIVE,
)  # fmt: skip
"""Where the base could stand, and may not."""
NO_STAND = (
    PoseStatus.BASE_BLOCKED, PoseStatus.OFF_FLOOR, PoseStatus.BEYOND_ARM, PoseStatus.NO_ROUTE,
)  # fmt: skip
"""Where it cannot stand, or not for this task."""
NO_PATH = (
    PoseStatus.WAYPOINT_OUT_OF_REACH, PoseStatus.ARM_COLLISION, PoseStatus.NO_CONTINUOUS_PATH,
)  # fmt: skip
"""From where the arm cannot follow the motion, as far as its inverse kinematics tells."""
_SUMMARY = {
    PoseStatus.WAYPOINT_OUT_OF_REACH: "out of reach at a waypoint",
    PoseStatus.ARM_COLLISION: "arm hits {detail}",
    PoseStatus.EXACT_CHECK: "exact check",
}


@dataclass(frozen=True)
class PoseOutcome:
    """What became of one base pose."""

    status: PoseStatus
    detail: str = ""
    """What is hit, or what the exact check or the task says."""
    where: str = ""
    """The waypoint at which it is so."""

    def __str__(self) -> str:
        return self.status.value.format(detail=self.detail, where=self.where)

    @property
    def summary(self) -> str:
        """The same without the waypoint, so that similar outcomes can be counted together."""
        words = _SUMMARY.get(self.status, self.status.value)
        return words.format(detail=self.detail)


@dataclass(frozen=True)
class CostTerm:
    """One term of what a base pose costs."""

    value: float | None
    """None where nobody has looked: it had no weight."""
    weight: float | None
    """None where it counts before all terms that have one."""


@dataclass(frozen=True)
class Tolerance:
    """How far beside a base pose the robot may stand, and still do it."""

    radius: float
    """Of a disc around it [m]; 0 where not even the smallest disc holds."""
    turn: float
    """To either side [rad]."""
    samples: int
    """Poses in it from which the motion was planned anew; it was found from all of them [-]."""

    def __str__(self) -> str:
        return f"{100 * self.radius:g} cm and {math.degrees(self.turn):.3g} deg"

    @property
    def at_least(self) -> float:
        """Share of the disc from which it is found, at a confidence of 95 % [-]."""
        return float(0.05 ** (1.0 / self.samples))
