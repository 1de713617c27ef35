"""Outcomes of base poses, with their texts in reports; cost terms; robustness."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum


class PoseStatus(Enum):
    """Outcome of a base pose; the value is its text, a template for `PoseOutcome`."""

    FEASIBLE = "feasible"
    PATH_FOUND = "path found, approach not checked"
    NOT_TRIED = "not checked"
    FILTERED = "ruled out before the check"
    NOT_KEPT_IN = "outside the keep-in areas"
    NOT_KEPT_OUT = "in a keep-out area"
    NOT_FACING = "not facing the grasp"
    TOO_LONG_A_DRIVE = "longer drive than allowed"
    BASE_BLOCKED = "base in collision"
    BASE_PATH_BLOCKED = "base in collision as it moves with the part"
    OFF_FLOOR = "base off the floor"
    BEYOND_ARM = "beyond the arm's reach"
    AREA_IN_THE_WAY = "no way to drive there outside {detail}"
    NO_ROUTE = "no base path"
    NO_PASSAGE = "no way to drive there: {detail}"
    NO_ROUTE_AT_HOME = "no base path with the arm at home"
    OUT_OF_REACH = "out of reach"
    TOO_FEW_JOINTS = "too few arm joints to follow the motion"
    OUT_OF_REACH_ANYWHERE = "out of reach{detail} at any distance"
    TASK_INFEASIBLE = "{detail}"
    NO_GRASP_IN_REACH = "no grasp within reach"
    HOME_COLLISION = "arm at home hits {detail}"
    WAYPOINT_OUT_OF_REACH = "out of reach at {where}"
    BASE_COLLISION = "base hits {detail} at {where}"
    ARM_COLLISION = "arm hits {detail} at {where}"
    NO_CONTINUOUS_PATH = "no continuous arm path"
    OVERLOAD = "{detail} needs {where}"
    TIPS_OVER = "{detail} would tip over at {where}"
    NO_APPROACH = "no approach from home within the arm planner's limit"
    NO_ROUTE_CARRYING = "no base path with {detail} in the hand"
    NO_WAY_HOME = "no arm path back home within the arm planner's limit"
    EXACT_CHECK = "exact check: {detail}"
    NOT_FOR_ALL = "not for all tasks: {detail}"
    LITTLE_ROOM = "not robust within {detail}"


RULED_OUT = (
    PoseStatus.NOT_KEPT_IN, PoseStatus.NOT_KEPT_OUT, PoseStatus.NOT_FACING,
    PoseStatus.TOO_LONG_A_DRIVE, PoseStatus.AREA_IN_THE_WAY,
)  # fmt: skip
"""The base fits there, but the query's region excludes it."""
NO_STAND = (
    PoseStatus.BASE_BLOCKED, PoseStatus.BASE_PATH_BLOCKED, PoseStatus.OFF_FLOOR,
    PoseStatus.BEYOND_ARM, PoseStatus.NO_ROUTE, PoseStatus.NO_PASSAGE,
)  # fmt: skip
"""The base does not fit or cannot get there, or the task is too far away."""
NO_PATH = (
    PoseStatus.WAYPOINT_OUT_OF_REACH, PoseStatus.BASE_COLLISION, PoseStatus.ARM_COLLISION,
    PoseStatus.NO_CONTINUOUS_PATH,
)  # fmt: skip
"""The arm cannot follow the motion, according to its inverse kinematics."""
MAX_WAYPOINTS = 10_000
"""More than the number of waypoints of any motion [-]."""
_STAGES = tuple(PoseStatus)
"""The statuses in the order of the checks."""
_SUMMARY = {
    PoseStatus.WAYPOINT_OUT_OF_REACH: "out of reach at a waypoint",
    PoseStatus.BASE_COLLISION: "base hits {detail}",
    PoseStatus.ARM_COLLISION: "arm hits {detail}",
    PoseStatus.OVERLOAD: "{detail} needs more than its effort limit",
    PoseStatus.TIPS_OVER: "{detail} would tip over",
    PoseStatus.EXACT_CHECK: "exact check",
}


def is_text_of(text: str, statuses: Iterable[PoseStatus]) -> bool:
    """Return whether a text in a report is that of an outcome with one of some statuses."""
    return text.startswith(tuple(status.value.partition("{")[0] for status in statuses))


@dataclass(frozen=True)
class PoseOutcome:
    """The outcome of one base pose."""

    status: PoseStatus
    detail: str = ""
    """The obstacle, or the reason of the exact check or the task."""
    where: str = ""
    """The waypoint concerned."""
    contact: Callable[[], str] | None = field(default=None, compare=False, repr=False)
    """Returns which shapes are how deep in each other; None if that is not known."""

    def __str__(self) -> str:
        return self.status.value.format(detail=self.detail, where=self.where)

    @property
    def in_full(self) -> str:
        """Return the text, with the shapes in contact and how deep they are."""
        contact = "" if self.contact is None else self.contact()
        if contact and self.status is PoseStatus.EXACT_CHECK:
            return self.status.value.format(detail=contact)
        return f"{self}: {contact}" if contact else str(self)

    @property
    def progress(self) -> tuple[int, int]:
        """Return how far the checks came: the stage, then the waypoint; larger is nearer."""
        number = "".join(filter(str.isdigit, self.where.rpartition("waypoint")[2]))
        stage = PoseStatus.NO_CONTINUOUS_PATH if self.status in NO_PATH else self.status
        whole = self.status is PoseStatus.NO_CONTINUOUS_PATH
        return _STAGES.index(stage), MAX_WAYPOINTS if whole else int(number or 0)

    @property
    def counted(self) -> str:
        """Return the text by which outcomes are counted: without how much a motor needs."""
        bears = self.status in (PoseStatus.OVERLOAD, PoseStatus.TIPS_OVER)
        return self.summary if bears else str(self)

    @property
    def summary(self) -> str:
        """Return the text without the waypoint, to count similar outcomes together."""
        words = _SUMMARY.get(self.status, self.status.value)
        return words.format(detail=self.detail)


@dataclass(frozen=True)
class NearestMiss:
    """The rejected base pose that came nearest to a solution, and what stopped it."""

    base_pose: tuple[float, float, float]
    """x [m], y [m], yaw [rad]."""
    reason: str


@dataclass(frozen=True)
class CostTerm:
    """One term of a base pose's cost."""

    value: float | None
    """None if not computed, since the term has no weight."""
    weight: float | None
    """None if the term takes precedence over all weighted terms."""


@dataclass(frozen=True)
class Tolerance:
    """Base-pose robustness: the offsets from a base pose at which replanning succeeds."""

    radius: float
    """Radius of a disc around the base pose [m]; 0 if even the smallest disc fails."""
    turn: float
    """Largest turn to either side [rad]."""
    samples: int
    """Number of sampled poses in the disc; replanning succeeded from all of them [-]."""

    def __str__(self) -> str:
        return f"+-{100 * self.radius:g} cm, +-{math.degrees(self.turn):.3g} deg"

    @property
    def at_least(self) -> float:
        """Return a lower bound of the success rate in the disc, at a confidence of 95 % [-]."""
        return float(0.05 ** (1.0 / self.samples))
