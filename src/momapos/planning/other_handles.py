"""Search again with the next handle of a part where the first one leads to no base pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import OutOfTimeError
from momapos.planning.grasps import TaskMotion, with_other_handle

from .query import PlacementQuery
from .result import PlacementResult
from .task_setup import PreparedTask, prepare
from .time_limit import cut_short, with_note

if TYPE_CHECKING:
    from jaxtyping import Bool

    from momapos.planning.grasps import Handle


def with_any_handle(
    query: PlacementQuery, with_first_handle: Callable[[PlacementQuery], PlacementResult]
) -> PlacementResult:
    """Return the first answer with a plan, by the part's handles in turn.

    If none has one, the answer is that for the first handle, with the reasons of the handle whose
    search came farthest, which a note names.

    Args:
        query: The question.
        with_first_handle: Answers a question with the first handle in which the hand is free, in a
            fully modeled scene if it is infeasible.
    """
    first = found = with_first_handle(query)
    every = [first]
    late = False
    try:
        while found.plan.status == "infeasible":
            other = with_other_handles_only(query, found.prepared)
            if other is None:
                break
            query, found = other, with_first_handle(other)
            every.append(found)
    except OutOfTimeError:
        late = True
    if not late and (found.plan.feasible or len(every) == 1):
        return found
    if late or found.plan.status == "timeout":
        return with_note(first, cut_short("the search with another handle"))
    best = max(every, key=lambda one: one.search.progress)
    first = replace(first, plan=replace(first.plan, candidates=best.plan.candidates))
    words = f"{len(every)} handles were searched; the reasons are those of"
    return with_note(first, f"{words} {best.prepared.motion.handle}")


def with_other_handles_only(query: PlacementQuery, prepared: PreparedTask) -> PlacementQuery | None:
    """Return the question for the handles after one; None if the hand is free at none of them.

    Args:
        query: The question.
        prepared: Its task, for that handle.
    """
    if prepared.blocked:
        return None
    used = prepared.motion.grasps.handles
    other = replace(query, keep_grasps=partial(_on_others, used, query))
    return other if _has_other(query, other, prepared.motion) else None


def _on_others(
    used: tuple[Handle, ...], query: PlacementQuery, motion: TaskMotion
) -> Bool[np.ndarray, " g"]:
    """Return which grasps of a motion hold none of some handles."""
    new = np.array([handle not in used for handle in motion.grasps.handles], bool)
    kept = new[motion.grasps.handle]
    return kept if query.keep_grasps is None else kept & query.keep_grasps(motion)


def _has_other(query: PlacementQuery, other: PlacementQuery, motion: TaskMotion) -> bool:
    """Return whether the hand is free in a grasp of another handle."""
    scene, robot, config = query.scene, query.robot, query.config
    passed = list(motion.grasps.handles)
    if with_other_handle(motion, scene, robot, config.motion, passed) is None:
        return False
    ready = prepare(
        scene, robot, query.task, config,
        clearance=config.place.clearance, keep_grasps=other.keep_grasps, watch=query.watch,
    )  # fmt: skip
    return not ready.no_grasp
