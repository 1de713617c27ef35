"""Answers and findings as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence

from momapos.apps.plots import task_text, value_text
from momapos.model.records import PlacementPlan, Task
from momapos.planning import PlacementResult
from momapos.simulation import RunRecord
from momapos.workflows.scene_check import (
    FindingKind,
    SceneReport,
    Severity,
    finding_lines,
    summary,
)

from .probe import Finding, Probe

MAX_FINDINGS = 2
"""Findings on a scene that are listed, per kind [-]."""
MAX_ROWS = 6
"""Rejection reasons, or collisions of an attempt, that are listed [-]."""
STATUS = {
    "solved": "Solved", "assumed": "Assumed, not solved", "infeasible": "No feasible base pose",
    "timeout": "Out of time",
}  # fmt: skip

RUN_OUTCOMES = {"done": "Succeeded", "moved as assumed": "Moved as assumed", "failed": "Failed"}


def escaped(text: str) -> str:
    """Escape text, such as names from a file, for Markdown."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>()#+-.!|" else c for c in text)


def pose_text(pose: tuple[float, float, float]) -> str:
    """Format a base pose with its units."""
    return f"x {pose[0]:.3f} m, y {pose[1]:.3f} m, yaw {math.degrees(pose[2]):.1f}°"


def check_text(report: SceneReport) -> str:
    """List what is wrong in a scene, and what its reader assumed; "" if there is nothing."""
    if not report.findings:
        return ""
    main = [
        one
        for one in report.findings
        if one.severity is not Severity.NOTE or one.kind is FindingKind.READER
    ]
    lines = finding_lines(main, most=MAX_FINDINGS)
    return f"\n\nScene: {summary(report)}" + "".join(f"\n- {escaped(x.strip())}" for x in lines)


def answer_text(answer: PlacementResult) -> str:
    """Describe an answer: the base pose and the motion, or why there is none."""
    plan = answer.plan
    what, how = task_text(answer)
    status = STATUS[plan.status]
    if plan.status == "infeasible" and plan.base_pose is not None:
        status = "Not feasible from here"
    lines = [f"**{status}**", f"{escaped(what)} {escaped(how)}", ""]
    if plan.motion is not None and plan.base_pose is not None:
        if plan.assumption is not None:
            lines.append(f"- assumed joint type: {escaped(str(plan.assumption))}")
            if not plan.assumption.is_first:
                lines.append(f"- most probable: {escaped(plan.assumption.instead)}")
        lines.append(f"- base pose: {pose_text(plan.base_pose)}")
        if plan.navigation_cost is not None:
            lines.append(f"- driving length: {plan.navigation_cost:.2f} m")
        lines += [f"- grasp: {escaped(words)}" for words in answer.holds]
        lines += [f"- latch: {escaped(answer.latch)}"] if answer.latch else []
        lines.append("- collision-free: base, arm and moving part along the whole motion")
        lines += tolerance_lines(plan)
        lines += [f"- note: {escaped(words)}" for words in answer.notes]
    elif plan.feasible_to is not None and plan.feasible_from is not None:
        to = value_text(answer, plan.feasible_to)
        lines.append(f"- feasible to {to} from {pose_text(plan.feasible_from)}")
    total = plan.timing.get("total", 0.0)
    stages = sorted(
        ((t, name) for name, t in plan.timing.items() if name not in ("total", "tolerance")),
        reverse=True,
    )
    slowest = ", ".join(f"{name} {1000 * t:.0f}" for t, name in stages[:3])
    lines.append(f"- time: {1000 * total:.0f} ms ({slowest})")
    counts = plan.candidates
    lines.append(f"- candidates: {counts.sampled} sampled, {counts.checked} fully checked")
    ranked = sorted(counts.rejections.items(), key=lambda item: -item[1])
    lines += [f"  - {count} {escaped(reason)}" for reason, count in ranked[:MAX_ROWS]]
    if len(ranked) > MAX_ROWS:
        rest = sum(count for _, count in ranked[MAX_ROWS:])
        lines.append(f"  - {rest} for {len(ranked) - MAX_ROWS} other reasons")
    return "\n".join(lines)


def tolerance_lines(plan: PlacementPlan) -> list[str]:
    """Describe the tolerance of the base pose; nothing where it is not measured."""
    found, spent = plan.tolerance, plan.timing.get("tolerance")
    if found is None:
        return []
    took = "" if spent is None else f", {1000 * spent:.0f} ms"
    if found.radius == 0.0:
        return [f"- tolerance: none, replanning failed from a pose nearby{took}"]
    offset = f"±{100 * found.radius:g} cm, ±{math.degrees(found.turn):.1f}°"
    return [f"- tolerance: {offset} (replanned from {found.samples} sampled poses{took})"]


def target_text(task: Task) -> str:
    """Return the target of a task as "object" or "object/joint"."""
    return task.object if task.joint is None else f"{task.object}/{task.joint}"


def run_text(record: RunRecord) -> str:
    """Describe a run in simulation."""
    task = record.true_task or record.task
    outcome = RUN_OUTCOMES[record.verdict]
    what = f"{task.verb} {target_text(task)} with {record.robot}"
    lines = [f"**{outcome}** in simulation", escaped(what), ""]
    if record.reason:
        lines.append(f"- reason: {escaped(record.reason)}")
    lines.append(f"- driven: {record.driven:.2f} m")
    attempts = (*record.failed, *((record.execution,) if record.execution else ()))
    for k, one in enumerate(attempts, 1):
        number = f"attempt {k}: " if len(attempts) > 1 else ""
        lines += [
            f"- {number}{escaped(one.ending)}",
            f"  - moved from {one.start:.3f} to {one.reached:.3f}, goal {one.asked:.3f}",
            f"  - grip: {escaped(one.hold)}, at most {one.load.force:.0f} N, slip "
            f"{1000 * one.slip.position:.1f} mm",
        ]
        lines += [
            f"  - collision: {escaped(hit.one)} and {escaped(hit.other)}, {hit.force:.0f} N"
            for hit in one.collisions[:MAX_ROWS]
        ]
    return "\n".join(lines)


def tour_text(plans: Sequence[PlacementPlan]) -> str:
    """List the tasks of a tour and their base poses."""
    driven = sum(plan.navigation_cost or 0.0 for plan in plans)
    lines = [f"**Solved**: {len(plans)} tasks, {driven:.2f} m driven", ""]
    for number, plan in enumerate(plans, start=1):
        at = "" if plan.base_pose is None else f" from {pose_text(plan.base_pose)}"
        lines.append(f"{number}. {plan.task.verb} {escaped(target_text(plan.task))}{at}")
    if any(plan.task.verb == "pick" for plan in plans[:-1]):
        lines += ["", "A picked object is drawn at its old place when the next task begins."]
    return "\n".join(lines)


def finding_text(finding: Finding, probe: Probe, seconds: float) -> str:
    """Describe what the check of a dragged base found."""
    x, y, yaw = finding.base.tolist()
    lines = [f"**{verdict_text(finding, probe)}**", "", f"- at {pose_text((x, y, yaw))}"]
    if not finding.feasible:
        lines.append(f"- {escaped(str(finding.outcome))}")
    if finding.in_the_way:
        lines.append(f"- obstacles: {escaped(', '.join(finding.in_the_way))}")
    if not finding.complete:
        lines.append("- not all grasps tried yet")
    lines.append(f"- answered in {1000 * seconds:.0f} ms")
    return "\n".join(lines)


def verdict_text(finding: Finding, probe: Probe) -> str:
    """Summarize a finding in a few words."""
    if finding.feasible:
        return "Feasible from here"
    if finding.value is None:
        return "Not feasible from here"
    value = f"{finding.value:.2f} m" if probe.slides else f"{math.degrees(finding.value):.0f}°"
    return f"Feasible from here only to {value}"


def verdict_of(finding: Finding) -> str:
    """Return the verdict that colors the footprint."""
    if finding.feasible:
        return "feasible"
    return "infeasible" if finding.value is None else "partly"
