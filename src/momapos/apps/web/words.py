"""Answers and findings in words, as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence

from momapos.apps.plots import question, value_text
from momapos.model.records import PlacementPlan
from momapos.planning import PlacementResult
from momapos.simulation import RunRecord

from .probe import Finding, Probe

MOST_REASONS = 6
STATUS = {"solved": "Solved", "infeasible": "No feasible base pose", "timeout": "Out of time"}


def escaped(text: str) -> str:
    """Words from a file, so that Markdown shows them as they are."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>()#+-.!|" else c for c in text)


def pose_text(pose: tuple[float, float, float]) -> str:
    """A base pose with its units."""
    return f"x {pose[0]:.3f} m, y {pose[1]:.3f} m, yaw {math.degrees(pose[2]):.1f}°"


def answer_words(answer: PlacementResult) -> str:
    """An answer: where to stand and how it moves, or why there is no way."""
    plan = answer.plan
    what, how = question(answer)
    status = STATUS[plan.status]
    if plan.status == "infeasible" and plan.base_pose is not None:
        status = "Not feasible from here"
    lines = [f"**{status}**", f"{escaped(what)} {escaped(how)}", ""]
    if plan.motion is not None and plan.base_pose is not None:
        lines.append(f"- stand at {pose_text(plan.base_pose)}")
        if plan.navigation_cost is not None:
            lines.append(f"- drive {plan.navigation_cost:.2f} m")
        lines += [f"- hold: {escaped(words)}" for words in answer.holds]
        lines.append("- checked: base, arm and moving part over the whole motion")
        lines += tolerance_words(plan)
    elif plan.feasible_to is not None and plan.feasible_from is not None:
        to = value_text(answer, plan.feasible_to)
        lines.append(f"- to {to} from {pose_text(plan.feasible_from)}")
    total = plan.timing.get("total", 0.0)
    beside = ("total", "tolerance")
    stages = sorted(
        ((t, name) for name, t in plan.timing.items() if name not in beside), reverse=True
    )
    slowest = ", ".join(f"{name} {1000 * t:.0f}" for t, name in stages[:3])
    lines.append(f"- time {1000 * total:.0f} ms ({slowest})")
    counts = plan.candidates
    lines.append(f"- {counts.sampled} candidates, {counts.checked} checked in full")
    ranked = sorted(counts.rejections.items(), key=lambda item: -item[1])
    lines += [f"  - {count} {escaped(reason)}" for reason, count in ranked[:MOST_REASONS]]
    if len(ranked) > MOST_REASONS:
        rest = sum(count for _, count in ranked[MOST_REASONS:])
        lines.append(f"  - {rest} for {len(ranked) - MOST_REASONS} other reasons")
    return "\n".join(lines)


def tolerance_words(plan: PlacementPlan) -> list[str]:
    """How far beside its base pose the robot may stand; nothing where that is not known."""
    found, spent = plan.tolerance, plan.timing.get("tolerance")
    if found is None:
        return []
    took = "" if spent is None else f", {1000 * spent:.0f} ms"
    if found.radius == 0.0:
        return [f"- tolerance: none, the motion is not found anew from all around{took}"]
    room = f"{100 * found.radius:g} cm beside, {math.degrees(found.turn):.1f}° turned"
    return [f"- tolerance: {room} ({found.samples} poses tried{took})"]


def run_words(record: RunRecord) -> str:
    """What came of a run."""
    task = record.true_task or record.task
    what = task.object if task.joint is None else f"{task.object}/{task.joint}"
    lines = [f"**{'Done' if record.success else 'Failed'}**, in physics",
             f"{task.verb} {escaped(what)} with {escaped(record.robot)}", ""]  # fmt: skip
    if record.reason:
        lines.append(f"- because {escaped(record.reason)}")
    lines.append(f"- driven {record.driven:.2f} m")
    tries = (*record.failed, *((record.execution,) if record.execution else ()))
    for k, one in enumerate(tries, 1):
        lines += [
            f"- try {k}: {escaped(one.ending)}" if len(tries) > 1 else f"- {escaped(one.ending)}",
            f"  - reached {one.reached:.3f} of {one.asked:.3f}, from {one.start:.3f}",
            f"  - hold by {escaped(one.hold)}, {one.load.force:.0f} N at most, slipped "
            f"{1000 * one.slip.position:.1f} mm",
        ]
        lines += [
            f"  - touched: {escaped(hit.one)} and {escaped(hit.other)}, {hit.force:.0f} N"
            for hit in one.collisions[:MOST_REASONS]
        ]
    return "\n".join(lines)


def tour_words(plans: Sequence[PlacementPlan]) -> str:
    """The tasks of a tour, and where each is done."""
    driven = sum(plan.navigation_cost or 0.0 for plan in plans)
    lines = [f"**Solved**: {len(plans)} tasks, {driven:.2f} m driven", ""]
    for number, plan in enumerate(plans, start=1):
        task = plan.task
        what = task.object if task.joint is None else f"{task.object}/{task.joint}"
        at = "" if plan.base_pose is None else f" from {pose_text(plan.base_pose)}"
        lines.append(f"{number}. {task.verb} {escaped(what)}{at}")
    if any(plan.task.verb == "pick" for plan in plans[:-1]):
        lines += ["", "When the next task begins, what was picked is drawn where it was."]
    return "\n".join(lines)


def finding_words(finding: Finding, probe: Probe, seconds: float) -> str:
    """What came of a base pose that was dragged to."""
    x, y, yaw = finding.base.tolist()
    lines = [f"**{verdict_words(finding, probe)}**", "", f"- at {pose_text((x, y, yaw))}"]
    if not finding.feasible:
        lines.append(f"- {escaped(str(finding.outcome))}")
    if finding.in_the_way:
        lines.append(f"- in the way: {escaped(', '.join(finding.in_the_way))}")
    if not finding.sure:
        lines.append("- not all ways of holding were tried yet")
    lines.append(f"- answered in {1000 * seconds:.0f} ms")
    return "\n".join(lines)


def verdict_words(finding: Finding, probe: Probe) -> str:
    """The same in a few words."""
    if finding.feasible:
        return "Feasible from here"
    if finding.value is None:
        return "Not feasible from here"
    value = f"{finding.value:.2f} m" if probe.slides else f"{math.degrees(finding.value):.0f}°"
    return f"From here only to {value}"


def verdict_of(finding: Finding) -> str:
    """The word that colors the footprint."""
    if finding.feasible:
        return "feasible"
    return "infeasible" if finding.value is None else "partly"
