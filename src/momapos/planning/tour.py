"""Plan several tasks one after the other, from one base pose if possible, else from few stops."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import Clock, OutOfTimeError, SceneError, Stopwatch, TaskError
from momapos.model.records import (
    ANYWHERE,
    PoseOutcome,
    PoseStatus,
    Status,
    Task,
    Verb,
    status_of_all,
)
from momapos.model.scene import Scene
from momapos.planning.grasps import make_task
from momapos.planning.placement import BaseStatus, PoseMask, base_pose_status

from .base_pose_check import BasePoseChecks, plan_at_pose
from .config import PipelineConfig
from .other_regions import MAX_OTHER_REGIONS, poses_in_other_regions, without_departure_check
from .plan import plan_placement
from .query import PlacementQuery
from .result import PlacementResult
from .task_setup import start_pose

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MAX_TASKS = 20
"""Maximum number of tasks in a tour [-]."""
_INVERSE = {"pick": "place", "place": "pick"}
"""Verb that must precede the repetition of a verb for the same movable object."""
SHARED_POSE_SHARE = 0.5
"""Share of the remaining time per task for the search of a base pose that serves several tasks;
the rest is for each task alone [-]."""


class Request(NamedTuple):
    """A requested task; its meaning depends on the tasks before it."""

    verb: Verb
    object: str
    joint: str | None = None
    to: float | str | None = None
    """Value to reach, see `make_task`."""


@dataclass(frozen=True)
class Tour:
    """Answers of several tasks, in order."""

    steps: tuple[PlacementResult, ...]
    """One per task; the first task without a plan is the last."""
    stops: tuple[int, ...]
    """Number of the stop of each task, from 1."""
    assumed: tuple[str, ...] = ()
    """Assumptions between the tasks."""
    seconds: float = 0.0
    """Planning time [s]."""
    unanswered: int = 0
    """Number of tasks, after these, that the time limit left without an answer [-]."""

    @property
    def status(self) -> Status:
        """Return the status of the last task, or `assumed` if only that keeps it from solved."""
        if self.unanswered:
            return "timeout"
        return status_of_all([step.plan for step in self.steps])

    @property
    def driving(self) -> float:
        """Return the total driving length [m]."""
        return sum(step.plan.navigation_cost or 0.0 for step in self.steps)


def plan_requests(query: PlacementQuery, requests: Sequence[Request]) -> Tour:
    """Return where the robot must stand to do several tasks one after the other.

    Each task begins in the scene as the one before has left it, with the arm at home: after each
    task but the last the hand lets go, draws back, and the arm goes home. As many tasks as one base
    pose serves are done from it, then as many of the rest: the fewest stops that the search finds.
    From a shared base pose each task but the first is done with one grasp.

    A picked object stays in the model where it was, so that later tasks keep clear of it, and the
    hand counts as free: see `Tour.assumed`.

    Args:
        query: The question of the first task. Its scene, robot, region, configuration, seed and
            clock apply to all; the timeout is for the whole tour.
        requests: All tasks, the first included; each to a value, not as far as possible.

    Raises:
        TaskError: A request makes no sense in the scene at its turn, or there are too many.
        SceneError: The robot collides at its start pose.
        UnknownNameError: There is no such object or joint.
        OutOfTimeError: The time was over before the first task had an answer.
    """
    clock = query.watch.clock
    began = clock()
    planner = _Planner(
        query,
        clock,
        began + query.config.timeout,
        scenes_of(query.scene, requests),
        tuple(requests),
    )
    visits = planner.stops(0, query.start)
    steps = [step for visit in visits for step in visit]
    stops = [k for k, visit in enumerate(visits, 1) for _ in visit]
    unanswered = len(requests) - len(steps) if steps[-1].plan.feasible else 0
    return Tour(tuple(steps), tuple(stops), _assumed(requests), clock() - began, unanswered)


def scenes_of(scene: Scene, requests: Sequence[Request]) -> list[tuple[Scene, Task]]:
    """Return each task with the scene in which it begins."""
    if not 1 <= len(requests) <= MAX_TASKS:
        raise TaskError(f"a tour has 1 to {MAX_TASKS} tasks, not {len(requests)}")
    scenes: list[tuple[Scene, Task]] = []
    last: dict[str, str] = {}
    for verb, name, joint, to in requests:
        if joint is None and verb in _INVERSE:
            if last.get(name) == verb:
                raise TaskError(
                    f"{verb} {name}: the tour has done that before; {_INVERSE[verb]} it in between"
                )
            last[name] = verb
        task = make_task(scene, verb, name, joint, to)
        if task.farthest:
            raise TaskError(
                f"{verb} {name}: the task after it needs to know how far; give a value, as 90deg"
            )
        scenes.append((scene, task))
        if task.joint is not None and task.to is not None:
            scene = scene.with_joint(name, task.joint, task.to)
    return scenes


def _assumed(requests: Sequence[Request]) -> tuple[str, ...]:
    """Return the assumptions between the tasks, which nothing checks."""
    hand_free = [
        f"after {request.verb} {request.object} it is put down on the robot, and the hand is free"
        for request, then in pairwise(requests)
        if request.verb == "pick" and (then.verb, then.object) != ("place", request.object)
    ]
    in_hand = [
        f"{request.object} is in the hand when {request.verb} {request.object} begins"
        for request in requests[1:]
        if request.verb == "place"
    ]
    return (*hand_free, *in_hand)


def _solved(visit: list[PlacementResult]) -> bool:
    return visit[-1].plan.feasible


def _base(visit: list[PlacementResult]) -> Float[np.ndarray, "3"]:
    """Return the base pose of a solved stop: x [m], y [m], yaw [rad]."""
    pose = visit[-1].plan.final_base_pose
    assert pose is not None
    return np.array(pose)


def _tasks_done(visits: list[list[PlacementResult]]) -> int:
    return sum(len(visit) for visit in visits if _solved(visit))


@dataclass
class _Planner:
    """The tasks of a tour, with the checks prepared so far."""

    query: PlacementQuery
    """The question of the first task."""
    clock: Clock
    deadline: float
    """Time on that clock [s]."""
    scenes: list[tuple[Scene, Task]]
    requests: tuple[Request, ...]
    _checks: dict[int, BasePoseChecks] = field(default_factory=dict)
    """Checks of base poses, by task."""

    def stops(
        self, first: int, start: Float[np.ndarray, "3"] | None
    ) -> list[list[PlacementResult]]:
        """Return the answers of each stop, starting at a task; only the last stop may fail.

        If the next stop fails at its first task, this stop is planned again in another region,
        while there is time. The tour with the most solved tasks is returned.
        """
        visit = self.stop(first, start)
        best: list[list[PlacementResult]] = []
        tried: list[Float[np.ndarray, "3"]] = []
        while _solved(visit):
            found, after = [visit], first + len(visit)
            try:
                if after < len(self.scenes):
                    tried.append(_base(visit))
                    found += self.stops(after, tried[-1])
                best = max(best, found, key=_tasks_done)
                fails_at_once = len(found) == 2 and not _solved(found[1])
                late = self.clock() > self.deadline
                if not fails_at_once or len(tried) > MAX_OTHER_REGIONS or late:
                    break
                in_others = self._in_other_regions(first, visit, tried)
                if in_others is None:
                    break
                visit = self.stop(first, start, in_others)
            except OutOfTimeError:
                best = max(best, found, key=_tasks_done)
                break
        return best or [visit]

    def _in_other_regions(
        self, first: int, visit: list[PlacementResult], tried: list[Float[np.ndarray, "3"]]
    ) -> PoseMask | None:
        """Return which base poses of a stop lead to other regions; None if there are none."""
        after, _ = self.scenes[first + len(visit)]
        return poses_in_other_regions(visit[0].prepared.geometry, after, tried)

    def stop(
        self, first: int, start: Float[np.ndarray, "3"] | None, in_others: PoseMask | None = None
    ) -> list[PlacementResult]:
        """Plan the longest sequence of tasks that one base pose serves.

        Args:
            first: The first task.
            start: Pose of the base: x [m], y [m], yaw [rad]; the scene's start by default.
            in_others: Returns which base poses lead to other regions than those tried; None to
                allow all.

        Returns:
            One answer per task; if the first has no solution, its answer alone.
        """
        tasks = len(self.scenes) - first
        for last in range(len(self.scenes) - 1, first - 1, -1):
            left = max(self.deadline - self.clock(), 1e-3)
            share = 1.0 if last == first else SHARED_POSE_SHARE / tasks
            try:
                found = self._from_one_pose(first, last, start, in_others, share * left)
            except OutOfTimeError:
                if last == first:
                    raise
                continue
            if found.plan.feasible or last == first:
                break
        pose = found.plan.final_base_pose
        if not found.plan.feasible or pose is None:
            return [found]
        base = np.array(pose)
        visit = [found]
        with suppress(OutOfTimeError):
            for k in range(first + 1, last + 1):
                visit.append(plan_at_pose(replace(self._query(k), start=base), base))
        return visit

    def _from_one_pose(
        self, first: int, last: int, start: Float[np.ndarray, "3"] | None,
        in_others: PoseMask | None, timeout: float,
    ) -> PlacementResult:  # fmt: skip
        """Answer the first task from a base pose that also serves all tasks up to the last."""
        known: dict[bytes, PoseOutcome | None] = {}

        def serves_rest(base: Float[np.ndarray, "3"]) -> PoseOutcome | None:
            key = base.tobytes()
            if key not in known:
                known[key] = self._refused(base, first + 1, last)
            return known[key]

        def serve_all(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
            kept = np.ones(len(poses), bool) if in_others is None else in_others(poses)
            for k in range(first + 1, last + 1):
                left = np.flatnonzero(kept)
                kept[left] = self._may_serve(k, poses[left])
            return kept

        config = replace(self._config(first), timeout=timeout)
        if last > first:  # a base pose that serves several tasks is a single one
            config = replace(config, base="fixed")
        if in_others is not None:
            config = without_departure_check(config)
        query = replace(
            self._query(first), start=start, config=config, region=self.query.region,
            keep_poses=serve_all, final_check=serves_rest,
        )  # fmt: skip
        return plan_placement(query)

    def _refused(self, base: Float[np.ndarray, "3"], first: int, last: int) -> PoseOutcome | None:
        """Return why a base pose does not serve tasks or the start of the next; None if it does."""
        for k in range(first, min(last + 2, len(self.scenes))):
            checks = self._checks_of(k)
            name = f"{self.requests[k].verb} {self.requests[k].object}: "
            try:
                start_pose(
                    self.scenes[k][0], self.query.robot, checks.prepared.motion, base,
                    checks.query.nav_map,
                )  # fmt: skip
            except SceneError as error:
                return PoseOutcome(PoseStatus.NOT_FOR_ALL, f"before {name}{error}")
            if k > last:
                break
            attempt = checks.with_one_grasp(base)
            if attempt.motion is None:
                return PoseOutcome(PoseStatus.NOT_FOR_ALL, name + attempt.outcome.summary)
        return None

    def _may_serve(self, k: int, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return at which poses the base is free for a task and the map reaches a grasp mode."""
        may = np.zeros(len(poses), bool)
        for checks in self._checks_of(k).by_handle():
            prepared, left = checks.prepared, np.flatnonzero(~may)
            geometry = replace(prepared.geometry, clearance=self.query.config.place.clearance)
            rows = left[base_pose_status(geometry, poses[left])[0] == BaseStatus.CLEAR]
            for score in prepared.mode_scorers:
                reached = score(self.query.reach, poses[rows]).scores.max(1, initial=0.0) > 0
                may[rows[reached]] = True
                rows = rows[~reached]
        return may

    def _checks_of(self, k: int) -> BasePoseChecks:
        if k not in self._checks:
            query = replace(self._query(k), start=None, watch=Stopwatch(lambda: 0.0))
            self._checks[k] = BasePoseChecks(query)
        return self._checks[k]

    def _query(self, k: int) -> PlacementQuery:
        """Return the question of one task, without a region."""
        scene, task = self.scenes[k]
        return replace(
            self.query, scene=scene, task=task, config=self._config(k), region=ANYWHERE,
            from_home=self.query.from_home or k > 0, watch=Stopwatch(self.clock),
        )  # fmt: skip

    def _config(self, k: int) -> PipelineConfig:
        """Return the configuration of a task; before another task the arm returns home."""
        motion = self.query.config.motion
        home = motion.home_again or k + 1 < len(self.scenes)
        return replace(self.query.config, motion=replace(motion, home_again=home))
