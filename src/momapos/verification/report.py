"""What a check of a plan says, and the limits it holds plans to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Limits:
    """How much a plan may be off."""

    step: float = 0.02
    """Largest step between the states that are checked [rad] or [m]."""
    penetration: float = 0.003
    """Depth that two bodies may overlap; below zero: the clearance they must keep [m]."""
    deeper: float = 0.003
    """How much deeper than in the scene the moved part may come into what it is in there [m]."""
    fk_position: float = 0.005
    """Tool pose of the plan against the one of its joints [m]."""
    fk_rotation: float = math.radians(1.0)
    """The same for the rotation [rad]."""
    slip_position: float = 0.01
    """How far the tool may slip in the part it holds [m]."""
    slip_rotation: float = math.radians(3.0)
    """How far it may turn in it [rad]."""
    reach: float = 0.06
    """Distance of the tool's origin from the part it holds [m]."""
    goal: float = 0.02
    """Share of the motion asked for by which start and end may differ [-]."""
    jump: float = 0.3
    """Largest step of a joint while the object is held [rad] or [m]."""
    join: float = 1e-3
    """Gap between the end of the approach and the start of the manipulation [rad] or [m]."""
    joint: float = 1e-4
    """Excess over a joint limit [rad] or [m]."""
    floor_edge: float = 0.003
    """How far the base may stand outside the floor [m]."""
    states: int = 20_000
    """Most states that are checked [-]."""
    poses: int = 4_000_000
    """Most poses of shapes in these, which are held at once [-]."""


DEFAULT = Limits()


@dataclass(frozen=True)
class Check:
    """One number that must not exceed its limit."""

    name: str
    ok: bool
    value: float
    limit: float
    unit: str
    """Of value and limit, for people: mm, deg, "rad|m"; "" for counts and yes or no."""
    detail: str = ""
    culprit: str = ""
    """The pair of bodies, or the joint, that is worst; the same words for every pose."""


@dataclass(frozen=True)
class Report:
    """All checks of one plan."""

    checks: tuple[Check, ...]
    notes: tuple[str, ...] = ()
    gripper_depth: float = 0.0
    """Deepest overlap of the gripper with the part it holds [m]; allowed, since it holds it."""

    @property
    def violations(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if not check.ok)

    @property
    def valid(self) -> bool:
        """Whether every check passed."""
        return not self.violations


def at_most(
    name: str, value: float, limit: float, unit: str = "", detail: str = "", culprit: str = ""
) -> Check:
    """Make a check; NaN fails."""
    value = float(value)
    return Check(name, bool(value <= limit), value, float(limit), unit, detail, culprit)


def verdict(name: str, ok: bool, detail: str = "") -> Check:
    """Make a check that is met or not."""
    return Check(name, bool(ok), 0.0 if ok else 1.0, 0.0, "", detail)


def report_to_dict(report: Report) -> dict[str, Any]:
    """Turn a report into what JSON can hold; numbers that are not finite become null."""
    return {
        "valid": report.valid,
        "checks": [
            {
                "name": check.name,
                "ok": check.ok,
                "value": check.value if math.isfinite(check.value) else None,
                "limit": check.limit,
                "unit": check.unit,
                "detail": check.detail,
            }
            for check in report.checks
        ],
        "notes": list(report.notes),
        "gripper_depth": report.gripper_depth,
    }


def report_lines(report: Report) -> list[str]:
    """Write a report for people, one line a check and the verdict last."""
    lines = []
    for check in report.checks:
        number = f"{check.value:10.4g} {check.unit:<8} (limit {check.limit:g})"
        detail = f"  {check.detail}" if check.detail else ""
        lines.append(f"{'ok  ' if check.ok else 'FAIL'} {check.name:<50} {number}{detail}")
    lines += [f"note: {note}" for note in report.notes]
    return [*lines, _last_line(report.violations)]


def _last_line(violations: Sequence[Check]) -> str:
    if not violations:
        return "VALID"
    names = ", ".join(check.name for check in violations)
    return f"INVALID: {len(violations)} of the checks failed: {names}"
