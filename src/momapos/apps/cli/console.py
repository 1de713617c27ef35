"""What a person reads on the terminal."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.model.records import NO_STAND, RULED_OUT
from momapos.planning.placement import OURS

if TYPE_CHECKING:
    from momapos.model.records import CostTerm, KeyObjects, PlacementPlan
    from momapos.planning import PlacementResult

MOST_REASONS = 8
_USUAL_WEIGHTS = {
    "driving": 1.0, "room": None, "clearance": 0.0, "manipulability": 0.0, "effort": 0.0,
}  # fmt: skip


@contextmanager
def progress(title: str) -> Iterator[Callable[..., None]]:
    """Show the share of long work on stderr when that is a terminal, once it takes a second.

    Yields:
        A function of the share in [0, 1], and of what is at work if that is worth telling.
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
    """Show on stderr, when that is a terminal, that work goes on and for how long it has.

    Args:
        title: What is done.
        limit: When it ends at the latest [s].
    """
    if not sys.stderr.isatty():
        yield
        return
    done, began = threading.Event(), time.monotonic()
    most = "" if limit is None else f" of at most {limit:.0f}"

    def tell() -> None:
        while not done.wait(1.0):
            line = f"\r{title}: {time.monotonic() - began:.0f}{most} s"
            print(line, end="", file=sys.stderr, flush=True)

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()
        if time.monotonic() - began > 1.0:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def summary(
    answer: PlacementResult, out: Path | None, *, most: bool = False, tried: str = ""
) -> str:
    """The answer in a few lines: question, pose, motion, time, and why others were refused.

    Args:
        answer: What the pipeline said.
        out: Where the plan was written.
        most: Whether the farthest value was asked for.
        tried: What became of each arm, where several were tried.
    """
    plan = answer.plan
    lines = [_question(answer, most), ""]
    if plan.base_pose is not None and plan.motion is not None:
        x, y, yaw = plan.base_pose
        turn = "" if plan.task.joint is None else f", holding {_span(answer)}"
        lines += [
            f"  stand at    x {x:.3f} m, y {y:.3f} m, yaw {math.degrees(yaw):.1f} deg",
            f"  drive       {plan.navigation_cost:.2f} m from "
            f"({answer.start[0]:.2f}, {answer.start[1]:.2f})",
            f"  move        {len(plan.motion.approach)} states to the grasp, then "
            f"{len(plan.motion.q)}{turn}",
            *_holds(answer),
            *_taken(answer),
            "  checked     base, arm and moving part over the whole motion, exact geometry",
            *_tolerance(plan),
            *_cost(plan.cost),
            *_afterward(answer),
        ]
    else:
        lines.append(f"  {plan.status:<11} {_why_not(answer)}")
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


def _holds(answer: PlacementResult) -> list[str]:
    """A line for each hold; those after the first say where the part is then."""
    motion = answer.plan.motion
    lines = [f"  hold        {words}" for words in answer.holds[:1]]
    if motion is not None:
        later = zip(motion.holds[1:], answer.holds[1:], strict=True)
        lines += [
            f"  then        from {_value(answer, motion.object_q[hold.first])}, {words}"
            for hold, words in later
        ]
    return lines


def _taken(answer: PlacementResult) -> list[str]:
    """As what the part is taken, where that is not the likeliest."""
    task = answer.plan.task
    if task.joint is None or not answer.plan.scene_hypotheses.get(task.object, {}).get(task.joint):
        return []
    kind = answer.prepared.scene.object(task.object).hypotheses[task.joint][0].kind
    return [f"  taken       for a {kind}: as what it is likelier there is no base pose"]


def _tolerance(plan: PlacementPlan) -> list[str]:
    """How far beside its base pose the robot may stand, where that is known."""
    found = plan.tolerance
    if found is None:
        return []
    spent = plan.timing.get("tolerance")
    took = "" if spent is None else f" ({1000 * spent:.0f} ms)"
    if found.radius == 0.0:
        return [f"  tolerance   none: the motion is not found anew from all around it{took}"]
    room = f"{100 * found.radius:g} cm and {math.degrees(found.turn):.1f} deg"
    poses = f"{found.samples} of {found.samples} poses"
    return [f"  tolerance   {room} beside it: found anew from {poses}{took}"]


def _cost(terms: Mapping[str, CostTerm]) -> list[str]:
    """What the base pose costs, where other weights than the usual were asked for."""
    if not terms or {name: term.weight for name, term in terms.items()} == _USUAL_WEIGHTS:
        return []
    said = [
        f"{name} {term.value:.2f} x {term.weight:g}"
        for name, term in terms.items()
        if term.weight and term.value is not None
    ]
    first = ["room first"] if terms["room"].weight is None else []
    return [f"  cost        {', '.join([*first, *said]) or 'nothing counts'}"]


def _afterward(answer: PlacementResult) -> list[str]:
    """That the robot cannot go on from there when the task is done, where that is so."""
    if touched := answer.touched_after:
        return [f"  afterward   the arm cannot be brought home there: it would touch {touched}"]
    if answer.search.shut_in:
        name = answer.plan.task.object
        return [f"  afterward   the base cannot drive on from there: {name} leaves it no way"]
    return []


def _modeled(key: KeyObjects) -> str:
    text = f"{len(key.names)} of {len(key.scores)} objects ({key.scorer}, alpha {key.alpha:.2f})"
    again = "once" if key.rounds == 1 else f"{key.rounds} times"
    return text + (f", checked again {again}" if key.rounds else "")


def _why_not(answer: PlacementResult) -> str:
    """Why there is no motion, and how far there is one instead."""
    plan = answer.plan
    if plan.status == "timeout":
        return "out of time; the reasons are below"
    task, smaller = plan.task, plan.feasible_to
    if plan.base_pose is not None:
        reason = next(iter(plan.candidates.rejections), "")
        instead = "" if smaller is None else f"; to {_value(answer, smaller)} from there"
        return f"from {_pose(plan.base_pose)}: {reason}{instead}"
    if smaller is None or plan.feasible_from is None or task.to is None:
        if _only_kept_out(plan.candidates.rejections):
            return (
                "every base pose that the robot could take breaks a rule about where it may stand; "
                "the reasons are below"
            )
        return "there is no base pose; the reasons are below"
    asked = f"to {_value(answer, task.to)}"
    found = f"{asked}; to {_value(answer, smaller)} from {_pose(plan.feasible_from)}"
    return found if plan.feasible_sure else f"{found}, and the time ended before more was ruled out"


def _only_kept_out(rejections: Mapping[str, int]) -> bool:
    """Whether areas, facing and length of the drive leave nothing to ask the arm about."""
    words = set(rejections)
    ruled_out = {status.value for status in RULED_OUT}
    return bool(words & ruled_out) and words <= ruled_out | {s.value for s in NO_STAND}


def _pose(pose: tuple[float, float, float]) -> str:
    return f"({pose[0]:.3f}, {pose[1]:.3f}, {math.degrees(pose[2]):.1f} deg)"


def asked(answer: PlacementResult) -> str:
    """What was asked for, as "open fridge/door_hinge to 90 deg"."""
    task = answer.plan.task
    what = task.object if task.joint is None else f"{task.object}/{task.joint}"
    return f"{task.verb} {what}" + ("" if task.to is None else f" to {_value(answer, task.to)}")


def _question(answer: PlacementResult, most: bool) -> str:
    plan, task, to = answer.plan, answer.plan.task, ""
    if most and plan.status == "solved":
        to = ", the farthest" if task.farthest else ", the farthest found in the time"
    return f"{plan.robot_name}: {asked(answer)}{to}: {plan.status}"


def _value(answer: PlacementResult, value: float) -> str:
    return f"{100 * value:.0f} cm" if answer.slides else f"{math.degrees(value):.0f} deg"


def _span(answer: PlacementResult) -> str:
    q = answer.prepared.motion.object_q
    return f"{_value(answer, q[0])} to {_value(answer, q[-1])}"


def _times(timing: object) -> str:
    stages = dict(timing)  # type: ignore[call-overload]
    total = stages.pop("total", 0.0)
    stages.pop("tolerance", None)  # stands beside what it measures
    parts = [f"{name} {1000 * value:.0f}" for name, value in stages.items() if value >= 0.0005]
    return f"{1000 * total:.0f} ms ({', '.join(parts)})"


def _rejections(answer: PlacementResult) -> list[str]:
    candidates = answer.plan.candidates
    lines = [f"  candidates  {candidates.sampled} sampled, {candidates.checked} checked in full"]
    ranked = sorted(candidates.rejections.items(), key=lambda item: -item[1])
    lines += [f"    {count:>7}  {reason}" for reason, count in ranked[:MOST_REASONS]]
    if len(ranked) > MOST_REASONS:
        rest = sum(count for _, count in ranked[MOST_REASONS:])
        lines.append(f"    {rest:>7}  for {len(ranked) - MOST_REASONS} other reasons")
    return lines
