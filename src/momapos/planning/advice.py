"""Find a small change that makes an infeasible task feasible, by trying changes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import Clock, OutOfTimeError, Stopwatch, processor_time, time_limit
from momapos.model.records import (
    ANYWHERE,
    RULED_OUT,
    JointResistance,
    PoseStatus,
    ReachScorer,
    is_text_of,
)
from momapos.model.robots import Robot
from momapos.model.scene import SceneObject, assumes_springs
from momapos.planning.grasps import hand_path

from .moved_objects import smallest_move
from .query import PlacementQuery
from .result import PlacementResult
from .time_limit import ADVICE, cut_short, time_left, with_note
from .trials import Trials
from .wider_regions import relaxed_restriction

if TYPE_CHECKING:
    from jaxtyping import Float

    from momapos.model.urdf import Joint

NEAR_OBJECTS = 1.2
"""Objects whose boxes are this near the hand's path can keep the robot away: half a base and an
arm's reach, less what the arm must bend [m]."""
MAX_OBJECTS = 8
"""Maximum number of objects that are removed for a trial, one at a time [-]."""
MAX_JOINTS = 6
"""Maximum number of joints that are put at another end for a trial, one at a time [-]."""
SAME_VALUE = 0.01
"""A joint that would move less is there already [rad] or [m]."""
_FORCES = (PoseStatus.OVERLOAD, PoseStatus.TIPS_OVER)
_FIXED = ("wall", "floor", "ceiling", "window")
"""Categories that no user removes."""

Change: TypeAlias = "tuple[str, PlacementResult]"
"""A change in words, and an answer with a plan."""
Robots: TypeAlias = "Iterable[tuple[str, Callable[[], tuple[Robot, ReachScorer]]]]"
"""Names of robots, and functions that load each with its reachability map."""


def with_advice(
    answer: PlacementResult, others: Robots = (), *, clock: Clock = processor_time
) -> PlacementResult:
    """Add to an infeasible answer the first change with which a plan exists.

    The changes, in this order: a wider restriction of the base pose; no springs, where they are
    assumed and forces refuse the task; a door or drawer of
    furniture that is hit at its other end; one of the objects near the part moved, as little as
    trials show, or else removed; another robot. Each trial is a search by samples, whose plan
    passes the exact check. Their number is limited, and the time limit of the answer includes them.

    Args:
        answer: The answer; returned unchanged unless it is infeasible and has its query.
        others: Other robots.
        clock: Measures the time.
    """
    query = answer.query
    if query is None or answer.plan.status != "infeasible":
        return answer
    watch = Stopwatch(clock)
    left, change = time_left(answer.plan, query.config.timeout), None
    trials = Trials(clock, clock() + left)
    with watch.stage(ADVICE), suppress(OutOfTimeError), time_limit(left, clock):
        change = next(_changes(answer, query, others, trials), None)
    answer = replace(
        answer, plan=replace(answer.plan, timing={**answer.plan.timing, **watch.seconds})
    )
    base = None if change is None else change[1].plan.base_pose
    if change is None or base is None:
        return answer if not trials.late else with_note(answer, cut_short("the trials for advice"))
    x, y, yaw = base
    advice = f"feasible {change[0]}, from ({x:.3f}, {y:.3f}, {np.degrees(yaw):.1f} deg)"
    return replace(answer, plan=replace(answer.plan, advice=advice))


def _changes(
    answer: PlacementResult, query: PlacementQuery, others: Robots, trials: Trials
) -> Iterator[Change]:
    rejections = answer.plan.candidates.rejections
    if query.region != ANYWHERE and any(is_text_of(text, RULED_OUT) for text in rejections):
        relaxed = relaxed_restriction(query, trials)
        if relaxed is not None:
            yield relaxed
    yield from _without_springs(answer, query, trials)
    yield from _with_other_joints(query, " ".join(rejections), trials)
    for name in objects_in_the_way(answer, query):
        without = trials.solve(_without(query, name))
        if without is not None:
            move = smallest_move(query, name, without, trials)
            yield (f"without {name}", without) if move is None else (move.words(name), move.answer)
    if query.keep_grasps is None:
        for name, load in others:
            if trials.over:
                return
            robot, reach = load()
            found = trials.solve(replace(query, robot=robot, reach=reach))
            if found is not None:
                yield f"with {name}", found


def _without_springs(
    answer: PlacementResult, query: PlacementQuery, trials: Trials
) -> Iterator[Change]:
    """Yield an answer without the springs that are assumed, if forces are what refuses the task.

    The weight of a part may help to move it, against friction for example.
    """
    task, known = query.task, answer.prepared.motion.resistance
    if task.joint is None or known is None:
        return
    forces = bool(answer.prepared.motion.refusal) or any(
        one.status in _FORCES for one in answer.search.counts()
    )
    item, config = query.scene.object(task.object), query.config.motion.grasps.resistance
    if forces and assumes_springs(item, task.joint, config):
        stated = item.resistance.get(task.joint, JointResistance())
        weighed = {task.object: {task.joint: replace(stated, balanced=False)}}
        found = trials.solve(replace(query, scene=query.scene.with_resistance(weighed)))
        if found is not None:
            yield f"without springs that bear the weight of {task.object}/{task.joint}", found


def _with_other_joints(query: PlacementQuery, reasons: str, trials: Trials) -> Iterator[Change]:
    """Yield answers with a joint at its other end, for furniture that the reasons name.

    Joints whose parts are named come first.
    """
    task = query.task
    found: list[tuple[bool, SceneObject, Joint]] = []
    for item in query.scene.objects:
        if not _names(reasons, f"{item.name}/"):
            continue
        for name, joint in item.model.joints.items():
            if (item.name, name) != (task.object, task.joint) and joint.mimic is None:
                links = item.model.moved_by(name)
                hit = any(_names(reasons, f"{item.name}/{link}") for link in links)
                found.append((not hit, item, joint))
    for _, item, joint in sorted(found, key=lambda one: one[0])[:MAX_JOINTS]:
        for end in _other_ends(item, joint):
            scene = query.scene.with_joint(item.name, joint.name, end)
            answer = trials.solve(replace(query, scene=scene))
            if answer is not None:
                slides = joint.kind == "prismatic"
                to = f"{100 * end:.0f} cm" if slides else f"{np.degrees(end):.0f} deg"
                yield f"with {item.name}/{joint.name} at {to}", answer


def _other_ends(item: SceneObject, joint: Joint) -> list[float]:
    """Return the limits of a joint at which it is not now, the farther one first [rad] or [m]."""
    now = item.values()[joint.name]
    ends = sorted((joint.lower, joint.upper), key=lambda end: -abs(end - now))
    return [end for end in ends if SAME_VALUE < abs(end - now) < np.inf]


def _names(reasons: str, label: str) -> bool:
    """Return whether the reasons name a link, or an object by its name and a slash.

    A longer name that contains the label does not count.
    """
    end = "" if label.endswith("/") else r"(?!\w)"
    return re.search(rf"(?<![\w/]){re.escape(label)}{end}", reasons) is not None


def objects_in_the_way(answer: PlacementResult, query: PlacementQuery) -> list[str]:
    """Return the objects that may keep a robot from a task, the most probable first.

    Those that the arm or the part hits come first, then those nearest to the path of the hand.
    """
    scene, task = query.scene, query.task
    path = hand_path(scene, task.object, task.joint, task.to)
    movable = [
        item
        for item in scene.objects
        if item.name != task.object and item.category.lower() not in _FIXED
    ]
    gaps = {item.name: _gap(item.bounds, path) for item in movable}
    words = " ".join(answer.plan.candidates.rejections)
    hit = {name for name in gaps if _names(words, f"{name}/")}
    near = [name for name, gap in gaps.items() if name in hit or gap < NEAR_OBJECTS]
    return sorted(near, key=lambda name: (name not in hit, gaps[name]))[:MAX_OBJECTS]


def _gap(bounds: Float[np.ndarray, "2 3"], points: Float[np.ndarray, "k 3"]) -> float:
    """Return the distance of points from a box [m]."""
    beyond = np.maximum(np.maximum(bounds[0] - points, points - bounds[1]), 0.0)
    return float(np.linalg.norm(beyond, axis=1).min())


def _without(query: PlacementQuery, name: str) -> PlacementQuery:
    return replace(query, scene=query.scene.without(name))
