"""Answers and findings in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from momapos.apps.plots import task_text, value_text
from momapos.core import length_text
from momapos.model.records import PlacementPlan, Task
from momapos.model.scene import Scene
from momapos.planning import PlacementResult, Tour
from momapos.planning.grasps import slides
from momapos.simulation import RunRecord
from momapos.workflows.scene_check import (
    FindingKind,
    SceneReport,
    Severity,
    finding_lines,
)

from .card import Card, Tone
from .probe import Probe, ProbedPose

MAX_FINDINGS = 2
"""Findings on a scene that are listed, per kind [-]."""
MAX_ROWS = 6
"""Rejection reasons, or collisions of an attempt, that are listed [-]."""
MAX_TITLES = 3
"""Tasks of a tour that its title names [-]."""
STATUS = {
    "solved": "Solved", "assumed": "Assumed, not solved", "infeasible": "No feasible base pose",
    "timeout": "Out of time",
}  # fmt: skip
TONE: dict[str, Tone] = {
    "solved": "good", "assumed": "part", "infeasible": "bad", "timeout": "bad",
}  # fmt: skip

RUN_OUTCOMES = {"done": "Succeeded", "moved as assumed": "Moved as assumed", "failed": "Failed"}
RUN_TONES: dict[str, Tone] = {"done": "good", "moved as assumed": "part", "failed": "bad"}


def pose_text(pose: tuple[float, float, float]) -> str:
    """Format a base pose with its units."""
    return f"x {pose[0]:.3f} m, y {pose[1]:.3f} m, yaw {math.degrees(pose[2]):.1f}°"


def check_lines(report: SceneReport) -> list[str]:
    """List what is wrong in a scene, and what its reader assumed."""
    main = [
        one
        for one in report.findings
        if one.severity is not Severity.NOTE or one.kind is FindingKind.READER
    ]
    return [line.strip() for line in finding_lines(main, most=MAX_FINDINGS)]


def answer_card(answer: PlacementResult) -> Card:
    """Describe an answer: the base pose and the motion, or why there is none."""
    plan = answer.plan
    what, how = task_text(answer)
    status = STATUS[plan.status]
    if plan.status == "infeasible" and plan.base_pose is not None:
        status = "Not feasible from here"
    facts: list[tuple[str, str]] = []
    notes: list[str] = []
    if plan.motion is not None and plan.base_pose is not None:
        if plan.assumption is not None:
            notes.append(f"assumed joint type: {plan.assumption}")
            if not plan.assumption.is_first:
                notes.append(f"most probable: {plan.assumption.instead}")
        facts.append(("base pose", pose_text(plan.base_pose)))
        facts += [("base", plan.base_motion)] if plan.moves_base else []
        if plan.navigation_cost is not None:
            facts.append(("drive", f"{plan.navigation_cost:.2f} m"))
        facts += [("grasp", words) for words in answer.holds]
        facts += [("latch", answer.latch)] if answer.latch else []
        facts.append(("checked", "no collision along the whole motion"))
        facts += tolerance_facts(plan)
        notes += answer.notes
    elif plan.feasible_to is not None and plan.feasible_from is not None:
        to = value_text(answer, plan.feasible_to)
        facts.append(("feasible", f"to {to} from {pose_text(plan.feasible_from)}"))
        notes += plan.notes
    counts = plan.candidates
    details = [("candidates", f"{counts.sampled} sampled, {counts.checked} fully checked")]
    total = plan.timing.get("total", 0.0)
    stages = sorted(
        ((name, t) for name, t in plan.timing.items() if name not in ("total", "tolerance")),
        key=lambda stage: -stage[1],
    )
    slowest = ", ".join(f"{name} {1000 * t:.0f}" for name, t in stages[:3])
    details.append(("time", f"{1000 * total:.0f} ms ({slowest})"))
    ranked = [(count, reason) for reason, count in counts.rejections.items()]
    ranked.sort(key=lambda row: -row[0])
    if len(ranked) > MAX_ROWS:
        rest = sum(count for count, _ in ranked[MAX_ROWS:])
        ranked[MAX_ROWS:] = [(rest, f"for {len(ranked) - MAX_ROWS} other reasons")]
    return Card(
        status,
        TONE[plan.status],
        f"{what} {how}",
        tuple(facts),
        tuple(notes),
        tuple(details),
        tuple(ranked),
    )


def plan_card(plan: PlacementPlan, scene: Scene) -> Card:
    """Describe a solved plan."""
    task, to = plan.task, ""
    known = any(item.name == task.object for item in scene.objects)  # not in a run elsewhere
    if known and task.joint is not None and task.to is not None:
        value = length_text(task.to) if slides(scene, task) else f"{math.degrees(task.to):.0f}°"
        to = f" to {value}"
    facts = [] if plan.base_pose is None else [("base pose", pose_text(plan.base_pose))]
    facts += [("base", plan.base_motion)] if plan.moves_base else []
    if plan.navigation_cost is not None:
        facts.append(("drive", f"{plan.navigation_cost:.2f} m"))
    holds = () if plan.motion is None else plan.motion.holds
    facts += [("grasp", hold.words) for hold in holds if hold.words]
    facts += [
        ("checked", "no collision along the whole motion"),
        *tolerance_facts(plan),
    ]
    title = f"{task.verb} {task.target}{to} with {plan.robot_name}"
    return Card(STATUS[plan.status], TONE[plan.status], title, tuple(facts))


def tolerance_facts(plan: PlacementPlan) -> list[tuple[str, str]]:
    """Describe the tolerance of the base pose; nothing where it is not measured."""
    found = plan.tolerance
    if found is None:
        why = [("tolerance", "not measured: the base moves in the manipulation")]
        return why if plan.moves_base else []
    if found.radius == 0.0:
        return [("tolerance", "none, replanning failed from a pose nearby")]
    offset = f"±{100 * found.radius:g} cm, ±{math.degrees(found.turn):.1f}°"
    return [("tolerance", f"{offset} ({found.samples} sampled poses)")]


def target_text(task: Task) -> str:
    """Return the target of a task as "object" or "object/joint"; "" for tool poses."""
    return "" if task.poses else task.target


def run_card(record: RunRecord) -> Card:
    """Describe a run in simulation."""
    task = record.true_task or record.task
    facts: list[tuple[str, str]] = [("driven", f"{record.driven:.2f} m")]
    notes = [record.reason] if record.reason else []
    attempts = (*record.failed, *((record.execution,) if record.execution else ()))
    for k, one in enumerate(attempts, 1):
        number = f"attempt {k}" if len(attempts) > 1 else "attempt"
        facts += [
            (number, one.ending),
            ("moved", f"from {one.start:.3f} to {one.reached:.3f}, goal {one.asked:.3f}"),
            ("grip", f"{one.hold}, at most {one.load.force:.0f} N, slip "
             f"{1000 * one.slip.position:.1f} mm"),
        ]  # fmt: skip
        facts += [
            ("collision", f"{hit.one} and {hit.other}, {hit.force:.0f} N")
            for hit in one.collisions[:MAX_ROWS]
        ]
    return Card(
        f"{RUN_OUTCOMES[record.verdict]} in simulation", RUN_TONES[record.verdict],
        f"{task.verb} {task.target} with {record.robot}", tuple(facts), tuple(notes),
    )  # fmt: skip


def tour_card(tour: Tour) -> Card:
    """Describe an answer of one task; list the tasks of several, or say why one has no plan."""
    plans = [step.plan for step in tour.steps]
    if len(plans) == 1 or not plans[-1].feasible:
        return answer_card(tour.steps[-1])
    return tasks_card(plans)


def tasks_card(plans: Sequence[PlacementPlan]) -> Card:
    """List the tasks of a tour and their base poses."""
    driven = sum(plan.navigation_cost or 0.0 for plan in plans)
    facts = [("drive", f"{driven:.2f} m")]
    for number, plan in enumerate(plans, start=1):
        at = "" if plan.base_pose is None else f" from {pose_text(plan.base_pose)}"
        facts.append((f"{number}.", f"{plan.task.verb} {plan.task.target}{at}"))
    picks = any(
        plan.task.verb == "pick"
        and (then.task.verb, then.task.object) != ("place", plan.task.object)
        for plan, then in pairwise(plans)
    )
    notes = ("A picked object is drawn at its old place when the next task begins.",) * picks
    tasks = [f"{plan.task.verb} {plan.task.target}" for plan in plans]
    more = [f"{len(tasks) - MAX_TITLES} more"] if len(tasks) > MAX_TITLES else []
    title = f"{', then '.join([*tasks[:MAX_TITLES], *more])} with {plans[0].robot_name}"
    return Card("Solved", "good", title, tuple(facts), notes)


def finding_card(finding: ProbedPose, probe: Probe, seconds: float) -> Card:
    """Describe what the check of a dragged base found."""
    x, y, yaw = finding.base.tolist()
    facts = [("base pose", pose_text((x, y, yaw)))]
    if finding.in_the_way:
        facts.append(("in the way", ", ".join(finding.in_the_way)))
    facts.append(("time", f"answered in {1000 * seconds:.0f} ms"))
    notes = [] if finding.feasible else [str(finding.outcome)]
    notes += [] if finding.complete else ["not all grasps tried yet"]
    tones: dict[str, Tone] = {"feasible": "good", "partly": "part", "infeasible": "bad"}
    tone = tones[verdict_of(finding)]
    title = f"{probe.task.verb} {probe.task.target}"
    return Card(verdict_text(finding, probe), tone, title, tuple(facts), tuple(notes))


def verdict_text(finding: ProbedPose, probe: Probe) -> str:
    """Summarize a finding in a few words."""
    if finding.feasible:
        return "Feasible from here"
    if finding.value is None:
        return "Not feasible from here"
    value = length_text(finding.value) if probe.slides else f"{math.degrees(finding.value):.0f}°"
    return f"Feasible from here only to {value}"


def verdict_of(finding: ProbedPose) -> str:
    """Return the verdict that colors the footprint."""
    if finding.feasible:
        return "feasible"
    return "infeasible" if finding.value is None else "partly"
