"""Answer a question with each handle, each retreat, and hands that are less open, in turn.

Fully open fingers can hit the panel behind a handle, a neighbor or a post. A hand that is open to
a width between the handle's thickness and its own opening passes them. Which widths help is known
from the hand alone: those with approach lines on which it is free and the open hand is not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import OutOfTimeError
from momapos.model.records import PoseStatus
from momapos.model.robots import opened_to
from momapos.planning.grasps import (
    SAME_LINE,
    TaskMotion,
    held_thickness,
    rigid_retreats,
    shifted_along,
    with_other_handle,
)

from .query import PlacementQuery
from .result import Answer, PlacementResult
from .task_setup import PreparedTask, prepare
from .time_limit import cut_short, unless_late, with_note

if TYPE_CHECKING:
    from jaxtyping import Bool

    from momapos.planning.grasps import Handle

OPENINGS = 4
"""Number of openings that are tried, evenly spaced [-]; the step is about a finger's thickness."""
MIN_SLACK = 0.016
"""Smallest opening beyond a handle's thickness [m]: 8 mm on each side, since bases stop within
5 mm of their goals and open hands keep 4 mm from everything."""
SIMILAR_SHARE = 1 / 3
"""Of the openings with at least this share of the narrowest one's lines, the widest is used [-]."""


def with_any_grasp(query: PlacementQuery, with_first_handle: Answer) -> PlacementResult:
    """Return the first answer with a plan: by the part's handles in turn, then by narrower hands.

    Args:
        query: The question.
        with_first_handle: Answers a question with the first handle in which the hand is free.
    """

    def with_each_handle(query: PlacementQuery) -> PlacementResult:
        return with_any_handle(query, with_first_handle)

    answer = with_each_handle(query)
    if answer.plan.status == "infeasible":
        return unless_late(lambda: with_narrower_hand(query, answer, with_each_handle), answer)
    return answer


def with_any_retreat(query: PlacementQuery, plan: Answer) -> PlacementResult:
    """Return the first answer with a plan, by the ways in which a rigid object can leave.

    They are chosen in the scene as it is: a shelf that is a box leaves no room. If none has a plan,
    the answer is that for the first one.

    Args:
        query: The question.
        plan: Answers a question.
    """
    if query.task.joint is not None or query.task.poses or not query.robot.has_gripper:
        return plan(query)
    config, first = query.config, None
    for way in rigid_retreats(query.scene, query.robot, query.task, config.motion):
        how = replace(config.motion, lift=way.lift, slide=way.slide)
        ask = partial(plan, replace(query, config=replace(config, motion=how)))
        found = ask() if first is None else unless_late(ask, first)
        if found.plan.status != "infeasible":
            return found
        first = first or found
    assert first is not None
    return first


def with_any_handle(query: PlacementQuery, with_first_handle: Answer) -> PlacementResult:
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
    following = with_other_handle(motion, scene, robot, config.motion, passed)
    if following is None:
        return False
    ready = prepare(
        scene, robot, query.task, config, motion=following,
        clearance=config.place.clearance, keep_grasps=other.keep_grasps, watch=query.watch,
    )  # fmt: skip
    return not ready.no_grasp


def with_narrower_hand(
    query: PlacementQuery,
    answer: PlacementResult,
    plan: Answer,
) -> PlacementResult:
    """Return the answer for a hand that is not fully open, if there is one.

    Args:
        query: The question.
        answer: Its infeasible answer, with every object modeled.
        plan: Answers a question.
    """
    if not answer.prepared.no_grasp and _is_infeasible_beforehand(answer):
        return answer  # no way to drive there, for example
    for other in narrower_hands(query, answer.prepared):
        found = plan(other)
        if not found.plan.feasible:
            if found.plan.status != "timeout":
                return answer
            if answer.plan.status == "infeasible":
                return found
            return with_note(answer, cut_short("the search with a wider hand"))
        answer = replace(found, query=replace(other, keep_grasps=query.keep_grasps))
    return answer


def _is_infeasible_beforehand(answer: PlacementResult) -> bool:
    """Return whether no base pose was checked, since none can work."""
    return all(one.status is PoseStatus.TASK_INFEASIBLE for one in answer.search.counts())


def narrower_hands(query: PlacementQuery, prepared: PreparedTask) -> Iterator[PlacementQuery]:
    """Yield the question for hands that are not fully open, and only for grasps that these add.

    The narrowest hand comes first: the lines of a wider hand are nearly always among its lines, so
    if it fails, wider ones would. Then comes the widest with similarly many, which forgives more.
    If the number of grasps is limited, there are none.

    Args:
        query: The question.
        prepared: Its task in the scene as it is modeled, for the open hand.
    """
    limited = query.config.motion.grasps.count is not None
    if limited or query.robot.fully_open is not None or prepared.blocked or query.task.poses:
        return
    hands = [opened_to(query.robot, width) for width in _openings(prepared)]
    queries = [
        replace(query, robot=hand, keep_grasps=partial(_added, prepared, query))
        for hand in hands
        if hand is not None
    ]
    most = _lines(queries[0], prepared) if queries else 0
    if most:
        yield queries[0]
        wider = reversed(queries[1:])
        yield from islice((q for q in wider if _lines(q, prepared) >= SIMILAR_SHARE * most), 1)


def _lines(query: PlacementQuery, prepared: PreparedTask) -> int:
    """Return the number of approach lines on which a hand is free, of those that it adds."""
    ready = prepare(
        prepared.scene, query.robot, query.task, query.config,
        clearance=query.config.place.clearance, keep_grasps=query.keep_grasps,
    )  # fmt: skip
    return 0 if ready.no_grasp else len(ready.motion.grasps)


def _openings(prepared: PreparedTask) -> list[float]:
    """Return openings between the thinnest handle and the open hand, the narrowest first [m]."""
    task, widest = prepared.task, prepared.robot.opening
    thin = held_thickness(prepared.scene.object(task.object), task.joint)
    widths = np.linspace(thin + MIN_SLACK, widest, OPENINGS, endpoint=False)
    return [round(width, 3) for width in widths.tolist() if width < widest - SAME_LINE]


def _added(
    prepared: PreparedTask, query: PlacementQuery, motion: TaskMotion
) -> Bool[np.ndarray, " g"]:
    """Return which grasps of a hand the open hand does not have.

    These are grasps of handles on lines on which the open hand is not free. The free edges of a
    part count only if the open hand has no grasp, or holds them, too.
    """
    known = prepared.motion
    added = np.ones(len(motion.grasps), bool)
    if not prepared.no_grasp:
        edges = np.array([handle.edge for handle in motion.grasps.handles], bool)
        if len(edges) and not any(handle.edge for handle in known.grasps.handles):
            added &= ~edges[motion.grasps.handle]
        ours, theirs = (m.Ts_world_tool[:, m.grasp_step] for m in (motion, known))
        added &= ~shifted_along(ours, theirs, prepared.robot.approach_axis)
    return added if query.keep_grasps is None else added & query.keep_grasps(motion)
