"""Records of a scene check."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum

from momapos.model.urdf import JointKind


class Severity(StrEnum):
    """How much a finding matters; the order is from worst to least."""

    ERROR = "error"
    """The scene cannot be used: planning refuses it."""
    WARNING = "warning"
    """Answers may be wrong, since the scene is probably not meant like this."""
    NOTE = "note"
    """Worth knowing; often intended."""


class FindingKind(StrEnum):
    """What a finding is about; `--json` contains these strings."""

    UNKNOWN_KEY = "unknown key"
    READER = "reader"
    NO_OBJECTS = "no objects"
    NO_SHAPE = "no shape"
    SIZE = "size"
    ROOM_SIZE = "room size"
    OVERLAP = "overlap"
    BELOW_FLOOR = "below the floor"
    IN_THE_AIR = "in the air"
    HULL = "hull"
    JOINT = "joint"
    NO_HANDLE = "no handle"
    LATCH = "latch"
    START = "start"
    DRIVING = "driving"


@dataclass(frozen=True)
class Finding:
    """What is wrong or worth knowing about a scene, one item."""

    kind: FindingKind
    severity: Severity
    text: str
    """What is wrong, and where."""
    advice: str = ""
    """What would be right."""
    object: str = ""
    """Name of the object; "" for the whole scene."""
    joint: str = ""
    """Name of its joint, if it is about one."""

    def __str__(self) -> str:
        return f"{self.text}; {self.advice}" if self.advice else self.text


@dataclass(frozen=True)
class JointReport:
    """What is known about a joint of an object."""

    object: str
    joint: str
    kind: JointKind
    closed: float
    """Value at which the part is closed [rad] or [m]."""
    wide: float
    """Value toward which it opens [rad] or [m]; infinite without a limit."""
    value: float
    """Value in the scene [rad] or [m]."""
    both_ways: bool
    """Whether it opens to both sides of the closed part."""
    follows: str = ""
    """The joint that a mimic joint follows."""
    is_handle: bool = False
    """Whether it moves nothing but the handle of another part."""
    handle: str = ""
    """The handle in words; "" if the joint moves no geometry, and for a mimic joint."""
    has_handle: bool = False
    """Whether that is a handle, and not a free edge."""
    handle_xyz: tuple[float, float, float] | None = None
    """Middle of the handle or edge in the world [m]."""
    pull: float | None = None
    """Largest pull at the handle that opens the part, up to 90 degrees [N]."""
    problem: str = ""
    """Why no handle could be looked for."""
    latch: str = ""
    """The latch that must be turned before it moves; "" without one."""
    latch_to: str = ""
    """Value to which that latch is turned, in words."""
    holds: str = ""
    """The joint that it holds, if it is a latch itself."""
    latch_guess: str = ""
    """The joint on it that may be a latch which the scene does not declare; "" for none."""
    base_distance: float | None = None
    """Horizontal distance from the handle to the nearest place that the base can drive to [m];
    infinite if there is none, None if no robot was given."""
    base_reaches: bool | None = None
    """Whether that is within the reach of the arm."""


@dataclass(frozen=True)
class FloorReport:
    """Where a robot can drive."""

    robot: str
    start: tuple[float, float, float] | None
    """Start of the scene, else a chosen one: x [m], y [m], yaw [rad]."""
    given: bool
    """Whether the scene has a start."""
    is_free: bool
    free_area: float
    """Area in which the base's inscribed circle fits [m^2]."""
    reachable_share: float
    """Share of it that this circle reaches from the start [-]."""


@dataclass(frozen=True)
class SceneReport:
    """The result of a scene check."""

    scene: str
    path: str
    objects: int
    findings: tuple[Finding, ...]
    """The worst first."""
    joints: tuple[JointReport, ...]
    floor: FloorReport | None = None
    """None if no robot was given."""

    @property
    def usable(self) -> bool:
        """Whether planning accepts the scene."""
        return not any(one.severity is Severity.ERROR for one in self.findings)

    @property
    def counts(self) -> dict[Severity, int]:
        """Return the number of findings by severity."""
        found = Counter(one.severity for one in self.findings)
        return {severity: found[severity] for severity in Severity}
