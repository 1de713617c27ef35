"""Show the report of a scene check as text and as plain values."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import asdict
from typing import Any

from .report import Finding, JointReport, SceneReport, Severity

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
