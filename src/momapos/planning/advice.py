"""Find the smallest change that makes an infeasible task feasible, by trying changes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import Clock, Stopwatch
from momapos.model.records import ANYWHERE, RULED_OUT, ReachScorer
from momapos.model.robots import Robot
from momapos.planning.grasps import hand_path

from .max_opening_plan import by_samples
from .plan import plan_to_value
from .query import PlacementQuery
from .result import PlacementResult

if TYPE_CHECKING:
    from jaxtyping import Float

NEAR_OBJECTS = 1.2
"""Objects whose boxes are this near the hand's path can keep the robot away: half a base and an
arm's reach, less what the arm must bend [m]."""
MAX_OBJECTS = 8
"""Maximum number of objects that are removed for a trial, one at a time [-]."""
MIN_TIME = 1.0
"""Time for the trials even after a quick refusal [s]."""
_FIXED = ("wall", "floor", "ceiling", "window")
"""Categories that no user moves."""

Change: TypeAlias = "tuple[str, Callable[[], PlacementQuery]]"
"""A change in words, which begin with "without" or "with", and the query with it."""


def with_advice(
    answer: PlacementResult,
    others: Iterable[tuple[str, Callable[[], tuple[Robot, ReachScorer]]]] = (),
    *,
    clock: Clock = time.perf_counter,
) -> PlacementResult:
    """Add to an infeasible answer the first change with which a plan exists.

    The changes, in this order: without the restrictions of the base pose, without one of the
    objects near the part, with another robot. Each trial is a search by samples, whose plan passes
    the exact check. All together take as long as the answer itself did, at least `MIN_TIME`.

    Args:
        answer: The answer; returned unchanged unless it is infeasible and has its query.
        others: Names of other robots, and functions that load each with its reachability map.
        clock: Measures the time.
    """
    query = answer.query
    if query is None or answer.plan.status != "infeasible":
        return answer
    watch = Stopwatch(clock)
    limit = max(MIN_TIME, answer.plan.timing.get("total", 0.0))
    began = clock()
    for words, changed in _changes(answer, query, others):
        left = limit - (clock() - began)
        if left <= 0.0:
            break
        config = replace(by_samples(query.config), timeout=left)
        trial = replace(changed(), config=config, watch=Stopwatch(watch.clock))
        found = plan_to_value(trial).plan
        if found.feasible and found.base_pose is not None:
            x, y, yaw = found.base_pose
            pose = f"({x:.3f}, {y:.3f}, {np.degrees(yaw):.1f} deg)"
            return replace(
                answer, plan=replace(answer.plan, advice=f"feasible {words}, from {pose}")
            )
    return answer


def _changes(
    answer: PlacementResult,
    query: PlacementQuery,
    others: Iterable[tuple[str, Callable[[], tuple[Robot, ReachScorer]]]],
) -> Iterator[Change]:
    rejected = set(answer.plan.candidates.rejections)
    if query.region != ANYWHERE and rejected & {status.value for status in RULED_OUT}:
        yield "without the restrictions of the base pose", lambda: replace(query, region=ANYWHERE)
    for name in objects_in_the_way(answer, query):
        yield f"without {name}", partial(_without, query, name)
    if query.keep_grasps is None:
        for name, load in others:
            yield f"with {name}", partial(_with_robot, query, load)


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
    hit = {name for name in gaps if f"{name}/" in words}
    near = [name for name, gap in gaps.items() if name in hit or gap < NEAR_OBJECTS]
    return sorted(near, key=lambda name: (name not in hit, gaps[name]))[:MAX_OBJECTS]


def _gap(bounds: Float[np.ndarray, "2 3"], points: Float[np.ndarray, "k 3"]) -> float:
    """Return the distance of points from a box [m]."""
    beyond = np.maximum(np.maximum(bounds[0] - points, points - bounds[1]), 0.0)
    return float(np.linalg.norm(beyond, axis=1).min())


def _without(query: PlacementQuery, name: str) -> PlacementQuery:
    objects = tuple(item for item in query.scene.objects if item.name != name)
    return replace(query, scene=replace(query.scene, objects=objects))


def _with_robot(
    query: PlacementQuery, load: Callable[[], tuple[Robot, ReachScorer]]
) -> PlacementQuery:
    robot, reach = load()
    return replace(query, robot=robot, reach=reach)
