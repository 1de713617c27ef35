"""Let the base stop several times, or move, where no single base pose serves a task."""

from __future__ import annotations

from dataclasses import replace

from momapos.model.records import PlacementPlan
from momapos.planning.grasps import task_motion

from .any_grasp import Answer, with_any_grasp
from .moving_base import search_moving
from .query import PlacementQuery
from .result import PlacementResult
from .search_setup import prepare_search
from .several_stops import plan_stops
from .time_limit import with_note


def with_other_use(
    query: PlacementQuery, fixed: PlacementResult, answer: Answer
) -> PlacementResult:
    """Return the answer with several stops or a moving base, if the query allows it and one works.

    Args:
        query: The question, about the joint of an object.
        fixed: Its answer from one base pose; returned unless it is infeasible.
        answer: Answers a question from one base pose.
    """
    use, task = query.config.base, query.task
    if fixed.plan.status != "infeasible" or task.joint is None or use == "fixed":
        return fixed
    words = ["no single base pose serves this task"]
    if use in ("stops", "auto"):
        found = plan_stops(query, fixed, answer)
        words += [_reached(count, leg) for count, leg in enumerate(found.stretches, 1)]
        if found.answer is not None:
            return _noted(found.answer, words, f"the robot stops {_stops(found.answer.plan)} times")
    if use in ("moving", "auto"):
        moved = plan_moving(query)
        if moved.plan.status != "infeasible":
            return _noted(moved, words, "the base moves with the part")
    return fixed


def _reached(stops: int, answer: PlacementResult) -> str:
    """Say how far a number of stops moves the part, given the answer of the last stretch."""
    assert answer.plan.task.to is not None
    to = answer.value_words(answer.plan.task.to)
    return f"one moves the part to {to}" if stops == 1 else f"{stops} stops to {to}"


def plan_moving(query: PlacementQuery) -> PlacementResult:
    """Answer the query with a base that moves while the hand holds the part."""
    return with_any_grasp(query, _with_first_handle)


def _with_first_handle(query: PlacementQuery) -> PlacementResult:
    """Answer the query with a moving base and the first handle in which the hand is free."""
    scene, watch = query.scene, query.watch
    with watch.stage("model"):
        motion = task_motion(scene, query.robot, query.task, query.config.motion)
    setup = prepare_search(query, scene, motion)
    with watch.stage("search"):
        found = search_moving(setup, query.config.place)
    answer = setup.result(found)
    return replace(answer, plan=replace(answer.plan, timing=watch.timing))


def _stops(plan: PlacementPlan) -> int:
    """Return at how many base poses the hand holds the part."""
    motion = plan.motion
    assert motion is not None
    assert motion.base is not None
    return len({motion.base[hold.first].tobytes() for hold in motion.grasps})


def _noted(answer: PlacementResult, others: list[str], note: str) -> PlacementResult:
    """Return an answer with a note on what other uses of the base reach, and on its own."""
    return with_note(answer.with_notes(), f"{', '.join(others)}; {note}")
