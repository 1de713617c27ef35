"""The report of a scene check, as records, as text and as plain values."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

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
    RESTS = "rests on a part"
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


MAX_PER_KIND = 5
"""Findings of a kind that are listed as text; the others are counted [-]."""
_HEAD = ("joint", "closed to open", "now", "pull", "base to", "handle")


def report_lines(report: SceneReport) -> list[str]:
    """Return a report as lines: joints, floor, findings."""
    at = f" ({report.path})" if report.path else ""
    return [
        f"{report.scene}{at}: {report.objects} object{_s(report.objects)}, "
        f"{len(report.joints)} joint{_s(len(report.joints))}",
        *joint_lines(report.joints),
        *_floor_lines(report),
        *finding_lines(report.findings),
    ]


def summary(report: SceneReport) -> str:
    """Return the number of findings in words."""
    counts = [f"{n} {severity}{_s(n)}" for severity, n in report.counts.items() if n]
    return ", ".join(counts) or "no findings"


def finding_lines(
    findings: Sequence[Finding],
    severities: Collection[Severity] = tuple(Severity),
    most: int = MAX_PER_KIND,
) -> list[str]:
    """Return findings as lines, the worst first, at most some per kind.

    Args:
        findings: The findings in the order of their severity.
        severities: Which of them.
        most: Largest number per kind and severity; a further line counts the others.
    """
    groups: dict[tuple[Severity, str], list[Finding]] = {}
    for one in findings:
        if one.severity in severities:
            groups.setdefault((one.severity, one.kind), []).append(one)
    lines = []
    for (severity, kind), group in groups.items():
        lines += [f"  {severity}: {one}" for one in group[:most]]
        if len(group) > most:
            lines.append(f"  {severity}: {len(group) - most} more of this kind ({kind})")
    return lines


def joint_lines(joints: Sequence[JointReport]) -> list[str]:
    """Return the joints as a table."""
    if not joints:
        return []
    rows = [_HEAD, *map(_joint_row, joints)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  " + "  ".join(f"{cell:{w}}" for cell, w in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _joint_row(one: JointReport) -> tuple[str, ...]:
    pull = "" if one.pull is None else f"{one.pull:.0f} N"
    base = ""
    if one.base_distance is not None:
        base = f"{one.base_distance:.2f} m" if math.isfinite(one.base_distance) else "no path"
    text = f"{one.object}/{one.joint}"
    return text, _range(one), _value(one, one.value), pull, base, _handle(one)


def _range(one: JointReport) -> str:
    if not math.isfinite(one.wide):
        side = "up" if one.wide > 0 else "down"
        return f"{_value(one, one.closed)}, no limit {side}"
    both = ", both ways" if one.both_ways else ""
    return f"{_value(one, one.closed)} to {_value(one, one.wide)}{both}"


def _value(one: JointReport, value: float) -> str:
    shown = 100 * value if one.kind == "prismatic" else math.degrees(value)
    return f"{round(shown, 1) + 0.0:g} {'cm' if one.kind == 'prismatic' else 'deg'}"


def _handle(one: JointReport) -> str:
    if one.follows:
        return f"follows {one.follows}"
    if not one.handle or one.handle_xyz is None:
        return "none"
    at = ", ".join(f"{v:.2f}" for v in one.handle_xyz)
    own = "a handle of its own part: " if one.is_handle else ""
    own = f"the latch of {one.holds}: " if one.holds else own
    after = f", once {one.latch} is turned to {one.latch_to}" if one.latch else ""
    return f"{own}{one.handle}, at ({at}){after}"


def _floor_lines(report: SceneReport) -> list[str]:
    floor = report.floor
    if floor is None:
        return []
    if floor.start is None:
        return [f"  {floor.robot} has no start"]
    x, y, yaw = floor.start
    start = f"({x:.2f}, {y:.2f}, {math.degrees(yaw):.0f} deg)"
    given = "the scene's start" if floor.given else "a chosen start"
    free = "free" if floor.is_free else "blocked"
    return [
        f"  {floor.robot}: {given} {start} is {free}; from there the base reaches "
        f"{100 * floor.reachable_share:.0f} % of {floor.free_area:.1f} m^2 free floor"
    ]


def report_to_dict(report: SceneReport) -> dict[str, Any]:
    """Return a report as plain values [m], [rad], [N]; None stands for infinity.

    `opens_up` says whether a joint opens toward larger values, also where it has no limit.
    """

    def plain(record: Any) -> dict[str, Any]:
        values = asdict(record)
        endless = [k for k, v in values.items() if isinstance(v, float) and math.isinf(v)]
        return values | dict.fromkeys(endless)

    return {
        "scene": report.scene,
        "path": report.path or None,
        "usable": report.usable,
        "objects": report.objects,
        "counts": {str(severity): n for severity, n in report.counts.items()},
        "findings": [plain(one) for one in report.findings],
        "joints": [{**plain(one), "opens_up": one.wide >= one.closed} for one in report.joints],
        "floor": None if report.floor is None else plain(report.floor),
    }


def _s(count: int) -> str:
    return "" if count == 1 else "s"
