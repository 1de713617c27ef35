"""Print progress and plans on the terminal."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.model.records import NO_STAND, RULED_OUT, PoseStatus, is_text_of
from momapos.planning.placement import OURS

if TYPE_CHECKING:
    from momapos.model.records import Candidates, CostTerm, KeyObjects, PlacementPlan, Task
    from momapos.planning import PlacementResult

MAX_NAMES = 12
"""Number of poses that are listed [-]."""
MAX_REASONS = 8
"""Printed reasons of rejected base poses [-]."""
_DEFAULT_WEIGHTS = {
    "driving": 1.0, "room": None, "clearance": 0.0, "manipulability": 0.0, "effort": 0.0,
}  # fmt: skip
_NO_WAY = (PoseStatus.NO_PASSAGE, PoseStatus.AREA_IN_THE_WAY)
"""A passage or an area is in the way."""
_TERMS = {"room": "missing robustness"}
"""Printed names of cost terms, where they differ from those in the plan file."""


@contextmanager
def progress(title: str) -> Iterator[Callable[..., None]]:
    """Show the progress of work that takes over a second, on stderr if that is a terminal.

    Yields:
        A function of the share that is done, in [0, 1], and of the current step.
    """
    began = time.monotonic()
    shown = False

    def report(share: float, what: str = "") -> None:
        nonlocal shown
        if sys.stderr.isatty() and time.monotonic() - began > 1.0:
            shown = True
            line = f"\r{title}: {100 * share:3.0f} % {what:<24.24}"
            print(line, end="", file=sys.stderr, flush=True)

    yield report
    if shown:
        print(file=sys.stderr)


@contextmanager
def busy(title: str, limit: float | None = None) -> Iterator[None]:
    """Show the elapsed time of work, on stderr if that is a terminal.

    Args:
        title: What is done.
        limit: Time limit of the work [s].
    """
    if not sys.stderr.isatty():
        yield
        return
    done, began = threading.Event(), time.monotonic()
    most = "" if limit is None else f" of at most {limit:.0f}"
    width = 0

    def show() -> None:
        nonlocal width
        while not done.wait(1.0):
            line = f"{title}: {time.monotonic() - began:.0f}{most} s"
            width = len(line)
            print(f"\r{line}", end="", file=sys.stderr, flush=True)

    printer = threading.Thread(target=show, daemon=True)
    printer.start()
    try:
        yield
    finally:
        done.set()
        printer.join()
        if width:  # blanks, because some terminals know no command to erase a line
            print(f"\r{' ' * width}\r", end="", file=sys.stderr, flush=True)


def summary(
    answer: PlacementResult, out: Path | None, *, most: bool = False, tried: str = ""
) -> str:
    """Summarize a plan: task, base pose, motion, times, and why other base poses were rejected.

    Args:
        answer: The plan, and what the search saw.
        out: The plan file, if one was written.
        most: Whether the task was to open as far as possible.
        tried: The result of each arm, if several were tried.
    """
    plan = answer.plan
    lines = [_question(answer, most), *_follower(plan.task), ""]
    if plan.base_pose is not None and plan.motion is not None:
        span = "" if plan.task.joint is None else f", from {_span(answer)}"
        goal = "the first pose" if plan.task.poses else "the grasp"
        parts = "base and arm" if plan.task.poses else "base, arm and moving part"
        lines += [
            f"  base pose   {pose_text(plan.base_pose)}",
            f"  drive       {plan.navigation_cost:.2f} m from "
            f"({answer.start[0]:.2f}, {answer.start[1]:.2f})",
            *([f"  base        {plan.base_motion}"] if plan.moves_base else []),
            f"  arm motion  {len(plan.motion.approach)} states to {goal}, then "
            f"{len(plan.motion.q)}{span}",
            *([] if plan.task.poses else _grasps(answer)),
            *_poses(answer),
            *_joint_type(answer),
            f"  checked     {parts} along the whole motion, with exact geometry",
            *([f"  loads       {plan.loads}"] if plan.loads is not None else []),
            *_tolerance(plan),
            *_cost(plan.cost),
            *_afterward(answer),
            *(f"  note        {words}" for words in answer.notes),
        ]
    else:
        lines += [f"  {plan.status:<11} {_why_not(answer)}", *_poses(answer)]
        miss = plan.candidates.nearest
        if miss is not None and plan.base_pose is None:
            lines.append(f"  nearest     {_pose(miss.base_pose)}: {miss.reason}")
        if plan.advice:
            lines.append(f"  advice      {plan.advice}")
        lines += [f"  note        {words}" for words in plan.notes]
    if plan.method not in OURS:
        gave_up = "; it gave up, which proves nothing" if plan.motion is None else ""
        lines.append(f"  method      {plan.method}{gave_up}")
    if plan.robot_arm is not None:
        lines.append(f"  arm         {plan.robot_arm}" + (f" ({tried})" if tried else ""))
    if plan.key_objects is not None:
        lines.append(f"  modeled     {_modeled(plan.key_objects)}")
    lines += [f"  assumed     {text}" for text in answer.prepared.robot.assumed]
    lines.append(f"  time        {_times(plan.timing)}")
    lines += _rejections(answer)
    if out is not None:
        lines.append(f"  plan        {out}")
    return "\n".join(lines)


def _poses(answer: PlacementResult) -> list[str]:
    """The poses to reach in their order, or those that are not reached."""
    names = pose_names(answer.plan.task)
    return [f"  poses       {names}"] if names else []


def pose_names(task: Task) -> str:
    """Name the poses of a task: the ends of a path, or of a set each."""
    names = task.pose_names
    if task.verb == "follow":
        return f"{names[0]} to {names[-1]}"
    return shown_names(names)


def shown_names(names: Sequence[str]) -> str:
    """List names; of many the first ones and the last."""
    some = names if len(names) <= MAX_NAMES else (*names[: MAX_NAMES - 2], "...", names[-1])
    return ", ".join(some)


def _grasps(answer: PlacementResult) -> list[str]:
    """A line for each grasp; those after the first say where the part is then."""
    motion = answer.plan.motion
    lines = [f"  grasp       {words}" for words in answer.holds[:1]]
    if answer.latch:
        lines.append(f"  latch       {answer.latch}")
    if motion is not None:
        later = zip(motion.holds[1:], answer.holds[1:], strict=True)
        lines += [
            f"  regrasp     from {_value(answer, motion.object_q[hold.first])}: {words}"
            for hold, words in later
        ]
    return lines


def _joint_type(answer: PlacementResult) -> list[str]:
    """The assumed joint type, and the answer for the most probable one."""
    found = answer.plan.assumption
    if found is None:
        return [f"  assumed     {answer.plan.assumes}"] if answer.plan.assumes else []
    if found.is_first:
        return [f"  joint type  {found}, assumed: the most probable one, but improbable"]
    return [
        f"  joint type  {found}, assumed: the most probable one has no feasible base pose",
        f"  probable    {found.instead}",
    ]


def _tolerance(plan: PlacementPlan) -> list[str]:
    """The tolerance of the base pose, if it was measured."""
    found = plan.tolerance
    if found is None:
        why = "  tolerance   not measured: the base moves in the manipulation"
        return [why] if plan.moves_base else []
    if found.radius == 0.0:
        return ["  tolerance   none: replanning fails from some base poses nearby"]
    size = f"+-{100 * found.radius:g} cm, +-{math.degrees(found.turn):.1f} deg"
    poses = f"{found.samples}/{found.samples} sampled poses"
    return [f"  tolerance   {size}: replanning succeeded from {poses}"]


def _cost(terms: Mapping[str, CostTerm]) -> list[str]:
    """The cost of the base pose, if the weights are not the default ones."""
    if not terms or {name: term.weight for name, term in terms.items()} == _DEFAULT_WEIGHTS:
        return []
    words = [
        f"{_TERMS.get(name, name)} {term.value:.2f} x {term.weight:g}"
        for name, term in terms.items()
        if term.weight and term.value is not None
    ]
    first = ["robustness first"] if terms["room"].weight is None else []
    return [f"  cost        {', '.join([*first, *words]) or 'all weights are 0'}"]


def _afterward(answer: PlacementResult) -> list[str]:
    """Why the robot can't go on from there after the task, if so."""
    if touched := answer.touched_after:
        return [f"  afterward   the arm can't return home from there: it would hit {touched}"]
    if answer.search.blocked_in:
        name = answer.plan.task.object
        return [f"  afterward   the base can't drive on from there: {name} blocks it in"]
    return []


def _modeled(key: KeyObjects) -> str:
    if len(key.names) == len(key.scores):
        first = ", ".join(f"{name} {key.scores[name]:.2f}" for name in key.names[1:4])
        return f"all {len(key.names)} objects" + (f"; by {key.scorer}: {first}" if first else "")
    text = f"{len(key.names)} of {len(key.scores)} objects ({key.scorer}, alpha {key.alpha:.2f})"
    again = "once" if key.rounds == 1 else f"{key.rounds} times"
    return text + (f", rechecked {again} with more of them" if key.rounds else "")


def _why_not(answer: PlacementResult) -> str:
    """Why there is no plan, and how far the part opens instead."""
    plan = answer.plan
    if plan.status == "timeout":
        return "the time limit was reached; rejected base poses are listed below"
    task, smaller = plan.task, plan.feasible_to
    if plan.base_pose is not None:
        reason = next(iter(plan.candidates.rejections), "")
        instead = "" if smaller is None else f"; feasible to {_value(answer, smaller)} from there"
        return f"from {_pose(plan.base_pose)}: {reason}{instead}"
    if smaller is None or plan.feasible_from is None or task.to is None:
        if reason := _one_reason(plan.candidates):
            return reason
        if _only_kept_out(plan.candidates.rejections):
            return (
                "all feasible base poses violate a restriction (areas, facing, driving distance); "
                "the reasons are below"
            )
        return "no feasible base pose; the reasons are below"
    most = "to" if plan.feasible_sure else "at least to"
    return (
        f"not to {_value(answer, task.to)}, but {most} {_value(answer, smaller)} "
        f"from {_pose(plan.feasible_from)}"
    )


def _one_reason(candidates: Candidates) -> str:
    """Return the reason that holds for every base pose, if there is one."""
    if candidates.sampled == 1 and len(candidates.rejections) == 1:
        return next(iter(candidates.rejections))
    return _no_way(candidates.rejections)


def _no_way(rejections: Mapping[str, int]) -> str:
    """Return the passage or area in the way, if it leaves no base pose to check the arm at."""
    found = [word for word in rejections if is_text_of(word, _NO_WAY)]
    others = {status.value for status in NO_STAND}
    if not found or not set(rejections) <= others.union(found):
        return ""
    return max(found, key=lambda word: rejections[word])


def _only_kept_out(rejections: Mapping[str, int]) -> bool:
    """Whether restrictions leave no base pose to check the arm at."""
    words = set(rejections)
    ruled_out = {word for word in words if is_text_of(word, RULED_OUT)}
    return bool(ruled_out) and words <= ruled_out | {s.value for s in NO_STAND}


def pose_text(pose: tuple[float, float, float]) -> str:
    """Write a base pose with its units."""
    return f"x {pose[0]:.3f} m, y {pose[1]:.3f} m, yaw {math.degrees(pose[2]):.1f} deg"


def _pose(pose: tuple[float, float, float]) -> str:
    return f"({pose[0]:.3f}, {pose[1]:.3f}, {math.degrees(pose[2]):.1f} deg)"


def task_text(answer: PlacementResult) -> str:
    """Write the task, such as "open fridge/door_hinge to 90 deg"."""
    task = answer.plan.task
    words = f"{task.verb} {task.target}"
    return words if task.to is None else f"{words} to {_value(answer, task.to)}"


def _question(answer: PlacementResult, most: bool) -> str:
    plan, task, to = answer.plan, answer.plan.task, ""
    if most and plan.feasible:
        to = " (maximum)" if task.farthest else " (largest found)"
    return f"{plan.robot_name}: {task_text(answer)}{to}: {plan.status}"


def _follower(task: Task) -> list[str]:
    if not task.follower:
        return []
    return [f"  {task.follower} follows {task.joint}, whose value and limits count"]


def _value(answer: PlacementResult, value: float) -> str:
    return answer.value_words(value)


def _span(answer: PlacementResult) -> str:
    q = answer.prepared.motion.object_q
    return f"{_value(answer, q[0])} to {_value(answer, q[-1])}"


def _times(timing: Mapping[str, float]) -> str:
    """The time of all stages, which add up, and of measuring the tolerance."""
    stages = dict(timing)
    total, tolerance = stages.pop("total", 0.0), stages.pop("tolerance", 0.0)
    stages["other"] = total - sum(stages.values())
    parts = [f"{name} {1000 * value:.0f}" for name, value in stages.items() if value >= 0.0005]
    return f"{1000 * total:.0f} ms ({', '.join(parts)}){also_for_tolerance(tolerance)}"


def also_for_tolerance(seconds: float) -> str:
    """Say how long it took to measure tolerances [s]; "" for none."""
    return f", and {1000 * seconds:.0f} ms for the tolerance" if seconds else ""


def _rejections(answer: PlacementResult) -> list[str]:
    candidates = answer.plan.candidates
    ranked = sorted(candidates.rejections.items(), key=lambda item: -item[1])
    end = "; rejected:" if ranked else ""
    lines = [f"  candidates  {candidates.sampled} sampled, {candidates.checked} fully checked{end}"]
    lines += [f"    {count:>7}  {reason}" for reason, count in ranked[:MAX_REASONS]]
    if len(ranked) > MAX_REASONS:
        rest = sum(count for _, count in ranked[MAX_REASONS:])
        lines.append(f"    {rest:>7}  other reasons ({len(ranked) - MAX_REASONS})")
    return lines
