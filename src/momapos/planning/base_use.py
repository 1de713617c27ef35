"""Let the base stop several times, or move, where no single base pose serves a task."""

from __future__ import annotations

from dataclasses import replace

from momapos.planning.grasps import task_motion

from .any_grasp import with_any_grasp
from .moving_base import search_moving
from .query import PlacementQuery
from .result import Answer, PlacementResult
from .search_setup import prepare_search
from .several_stops import MAX_STOPS, plan_in_stretches
from .time_limit import with_note


def with_other_use(
    query: PlacementQuery, fixed: PlacementResult, answer: Answer
) -> PlacementResult:
    """Return the answer with several stops or a moving base, if the query allows it and one works.

    Args:
        query: The question; only joints are moved, and paths are followed, like that. The stops
            of a path are those of `plan_path_stops`.
        fixed: Its answer from one base pose; returned unless it is infeasible.
        answer: Answers a question from one base pose.
    """
    use, task = query.config.base, query.task
    rigid = task.joint is None and task.verb != "follow"
    if fixed.plan.status != "infeasible" or rigid or use == "fixed":
        return fixed
    words = f"no single base pose serves this {'path' if task.poses else 'task'}"
    if use in ("stops", "auto") and task.joint is not None:
        found = plan_in_stretches(query, fixed, answer)
        if found.answer is not None:
            # Where the hand lets go is a fact of the plan. How far fewer stops could move the part
            # is another question, whose answer may be farther.
            rests = [leg.value_words(leg.plan.task.to or 0.0) for leg in found.stretches]
            stops = f"the robot stops {len(rests) + 1} times, and lets go at {' and '.join(rests)}"
            return with_note(found.answer.with_notes(), f"{words}; {stops}")
        words += f", nor do up to {MAX_STOPS} stops"
    if use in ("moving", "auto"):
        moved = plan_moving(query)
        if moved.plan.status != "infeasible":
            return with_note(
                moved.with_notes(),
                f"{words}; the base moves with the {'tool' if task.poses else 'part'}",
            )
    return fixed


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
