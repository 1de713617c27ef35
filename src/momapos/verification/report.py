"""The report of a plan verification, and the limits that it applies."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from momapos.core import finite_number, refuse_above, refuse_below
from momapos.model.records import MAX_EFFORT_SHARE, MIN_STABILITY

MAX_STATES, MAX_POSES = 1_000_000, 100_000_000
"""Bounds of what one check may hold in memory; the latter takes 13 GB [-]."""


@dataclass(frozen=True)
class Limits:
    """Largest allowed errors of a plan."""

    step: float = 0.02
    """Largest joint step between checked states [rad] or [m]."""
    penetration: float = 0.003
    """Allowed overlap depth of two bodies; below zero: the clearance they must keep [m]."""
    deeper: float = 0.003
    """How much deeper than in the given scene the moved part may overlap an obstacle [m]."""
    fk_position: float = 0.005
    """Distance between the plan's tool position and forward kinematics [m]."""
    fk_rotation: float = math.radians(1.0)
    """Angle between the plan's tool rotation and forward kinematics [rad]."""
    slip_position: float = 0.01
    """Translation of the tool relative to the held part [m]."""
    slip_rotation: float = math.radians(3.0)
    """Rotation of the tool relative to the held part [rad]."""
    reach: float = 0.06
    """Distance between the tool's origin and the held part [m]."""
    hand_gap: float = 0.01
    """How far the hand may be off the part that it holds: fingers that close touch it together up
    to this distance, other tools are this near [m]."""
    hand_depth: float = 0.005
    """How deep the hand may be in the part, as open as planned [m]."""
    friction: float = 0.6
    """Friction coefficient of pads on the part, as the planner assumes it: rubber on lacquer,
    plastic and steel has 0.6 and more [-]."""
    goal: float = 0.02
    """Error of the joint's start and end values, as a share of the requested motion [-]."""
    jump: float = 0.3
    """Largest step of a joint while the hand holds the object [rad] or [m]."""
    join: float = 1e-3
    """Gap between two consecutive phases, such as approach and manipulation [rad] or [m]."""
    joint: float = 1e-4
    """Excess over a joint limit [rad] or [m]."""
    speed: float = 1.01
    """Share of a joint's limits of speed and acceleration that the plan's times may need; 1 % for
    splines, which swing past their states between them [-]."""
    effort: float = MAX_EFFORT_SHARE
    """Share of a joint's effort limit that a state may need at rest [-]."""
    stability: float = MIN_STABILITY
    """Least distance of the zero moment point inside the area that the wheels stand on [m]."""
    floor_edge: float = 0.003
    """How far the base may extend beyond the floor [m]."""
    states: int = 20_000
    """Largest number of states to check [-]."""
    poses: int = 4_000_000
    """Largest number of shape poses to check; they are all in memory at once [-]."""

    def __post_init__(self) -> None:
        finite_number("Limits.penetration", self.penetration)
        refuse_below(self, 1e-4, "step")
        refuse_below(self, 0, "deeper", "fk_position", "fk_rotation", "slip_position")
        refuse_below(self, 0, "slip_rotation", "reach", "hand_gap", "hand_depth")
        refuse_below(self, 0.01, "friction")
        refuse_below(self, 0, "goal", "jump", "join", "joint")
        refuse_below(self, 0, "floor_edge", "effort", "speed")
        refuse_below(self, 1, "states", "poses")
        refuse_above(self, MAX_STATES, "states")
        refuse_above(self, MAX_POSES, "poses")


DEFAULT: Limits = Limits()


@dataclass(frozen=True)
class Check:
    """One number that must not exceed its limit."""

    name: str
    ok: bool
    value: float
    limit: float
    unit: str
    """Unit of value and limit: mm, deg, "rad|m"; "" for counts and for yes or no."""
    detail: str = ""
    culprit: str = ""
    """The worst pair of bodies or joint; independent of the base pose."""


@dataclass(frozen=True)
class Report:
    """All checks of one plan."""

    checks: tuple[Check, ...]
    notes: tuple[str, ...] = ()
    gripper_depth: float = 0.0
    """Deepest overlap of the open gripper with the held part [m]."""

    @property
    def violations(self) -> tuple[Check, ...]:
        """Return the failed checks."""
        return tuple(check for check in self.checks if not check.ok)

    @property
    def valid(self) -> bool:
        """Return whether every check passed."""
        return not self.violations


def at_most(
    name: str, value: float, limit: float, unit: str = "", detail: str = "", culprit: str = ""
) -> Check:
    """Build a check of a number; NaN fails."""
    value = float(value)
    return Check(name, bool(value <= limit), value, float(limit), unit, detail, culprit)


def verdict(name: str, ok: bool, detail: str = "") -> Check:
    """Build a check that holds or does not."""
    return Check(name, bool(ok), 0.0 if ok else 1.0, 0.0, "", detail)


def report_to_dict(report: Report) -> dict[str, Any]:
    """Convert a report for JSON; non-finite numbers become null."""
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
    """Format a report as text: one line per check, then the notes and the verdict."""
    lines = []
    for check in report.checks:
        number = f"{check.value:10.4g} {check.unit:<8} (limit {check.limit:g})"
        detail = f"  {check.detail}" if check.detail else ""
        lines.append(f"{'ok  ' if check.ok else 'FAIL'} {check.name:<50} {number}{detail}")
    lines += [f"note: {note}" for note in report.notes]
    if report.valid:
        return [*lines, "VALID"]
    names = ", ".join(check.name for check in report.violations)
    count = f"{len(report.violations)} of {len(report.checks)} checks failed"
    return [*lines, f"INVALID: {count}: {names}"]
