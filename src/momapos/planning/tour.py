"""Several tasks one after the other: one base pose for all where there is one, else few stops."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import Clock, SceneError, Stopwatch, TaskError
from momapos.model.records import (
    ANYWHERE,
    BaseRegion,
    PoseOutcome,
    PoseStatus,
    ReachScorer,
    Status,
    Task,
    Verb,
)
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.grasps import make_task
from momapos.planning.placement import BaseStatus, PoseFilter, base_pose_status
from momapos.planning.reachability import load_reach

from .base_pose_check import BasePoseChecks, plan_at_base_pose
from .config import PipelineConfig
from .other_regions import OTHERS, base_poses_elsewhere, without_way_on
from .plan import plan_base_placement
from .query import PlacementQuery
from .result import PlacementResult
from .task_setup import start_pose

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

DEFAULT = PipelineConfig()
MOST = 20
"""Tasks of a tour [-]."""
OTHER = {"pick": "place", "place": "pick"}
"""What has to come before a loose object can be picked, or placed, once more."""
JOINT_SHARE = 0.5
"""Share of the time that is left for each task within which one base pose for several is looked
for, so that enough remains for each by itself [-]."""


class Request(NamedTuple):
    """A task as it is asked for; what it means depends on the tasks before it."""

    verb: Verb
    object: str
    joint: str | None = None
    to: float | str | None = None
    """Value to reach, see `make_task`."""


@dataclass(frozen=True)
class Tour:
    """Answers of several tasks, in order."""

    steps: tuple[PlacementResult, ...]
    """One for each task; where one has no answer, that is the last."""
    stops: tuple[int, ...]
    """At which stop each is done, counted from 1."""
    assumed: tuple[str, ...] = ()
    """What is taken for granted between the tasks."""
    seconds: float = 0.0
    """Time that the answer took [s]."""

    @property
    def status(self) -> Status:
        """As of the last task: all others are solved."""
        return self.steps[-1].plan.status

    @property
    def driving(self) -> float:
        """Driving length in all [m]."""
        return sum(step.plan.navigation_cost or 0.0 for step in self.steps)


def plan_tour(
    scene: Scene,
    robot: Robot,
    requests: Sequence[Request],
    reach: ReachScorer | None = None,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    region: BaseRegion = ANYWHERE,
    config: PipelineConfig = DEFAULT,
    cache_dir: Path | None = None,
    seed: int = 0,
    clock: Clock = time.perf_counter,
) -> Tour:
    """Answer where the robot must stand to do several tasks one after the other.

    Each task begins in the room as the one before has left it, with the arm at home: after each but
    the last it lets go, draws back and comes home. As many tasks as there is a base pose for are
    done from one, then as many of those that are left: the fewest stops, as far as the search finds
    what there is. From a shared base pose each task but the first is done in one hold.

    What is picked stays in the model where it was, so that what follows keeps clear of it, and the
    hand is free for what follows: see `Tour.assumed`.

    Args:
        scene: The room.
        robot: The mobile manipulator.
        requests: The tasks; to values, not as far as possible.
        reach: The robot's reachability map; None to load it, or to build it at the first use.
        start: Where the base is now: x [m], y [m], yaw [rad]; the scene's start by default.
        region: Where the base is allowed to stand.
        config: How to search; the timeout is for the whole tour.
        cache_dir: Where maps are kept; the user's cache folder by default.
        seed: Same seed, same answers, as long as the time is enough.
        clock: Measures the time.

    Raises:
        TaskError: A request makes no sense in the room as it is then, or there are too many.
        SceneError: The start is no free pose.
        UnknownNameError: There is no such object or joint.
    """
    began = clock()
    planner = _Planner(
        robot, load_reach(robot, cache_dir) if reach is None else reach, region, config, seed,
        clock, began + config.timeout, list(_rooms(scene, requests)), tuple(requests),
    )  # fmt: skip
    visits = planner.stops(0, start)
    steps = [step for visit in visits for step in visit]
    stops = [k for k, visit in enumerate(visits, 1) for _ in visit]
    return Tour(tuple(steps), tuple(stops), _assumed(requests), clock() - began)


def _rooms(scene: Scene, requests: Sequence[Request]) -> list[tuple[Scene, Task]]:
    """Each task with the room in which it begins."""
    if not 1 <= len(requests) <= MOST:
        raise TaskError(f"a tour has 1 to {MOST} tasks, not {len(requests)}")
    rooms: list[tuple[Scene, Task]] = []
    last: dict[str, str] = {}
    for verb, name, joint, to in requests:
        if joint is None and verb in OTHER:
            if last.get(name) == verb:
                raise TaskError(
                    f"{verb} {name}: the tour has done that before; {OTHER[verb]} it in between"
                )
            last[name] = verb
        task = make_task(scene, verb, name, joint, to)
        if task.farthest:
            raise TaskError(
                f"{verb} {name}: the task after it needs to know how far; give a value, as 90deg"
            )
        rooms.append((scene, task))
        if task.joint is not None and task.to is not None:
            scene = scene.with_joint(name, task.joint, task.to)
    return rooms


def _assumed(requests: Sequence[Request]) -> tuple[str, ...]:
    """What holds between the tasks beside what is checked."""
    free = [
        f"after {request.verb} {request.object} it is put down on the robot, and the hand is free"
        for request in requests[:-1]
        if request.verb == "pick"
    ]
    brings = [
        f"{request.object} is in the hand when {request.verb} {request.object} begins"
        for request in requests[1:]
        if request.verb == "place"
    ]
    return (*free, *brings)


def _solved(visit: list[PlacementResult]) -> bool:
    """Whether all tasks of a stop have an answer."""
    return visit[-1].plan.status == "solved"


def _base(visit: list[PlacementResult]) -> Float[np.ndarray, "3"]:
    """Where the robot stands at a stop that has an answer: x [m], y [m], yaw [rad]."""
    pose = visit[-1].plan.base_pose
    assert pose is not None
    return np.array(pose)


def _tasks_done(visits: list[list[PlacementResult]]) -> int:
    return sum(len(visit) for visit in visits if _solved(visit))


@dataclass
class _Planner:
    """All tasks, and what is known of them so far."""

    robot: Robot
    reach: ReachScorer
    region: BaseRegion
    config: PipelineConfig
    seed: int
    clock: Clock
    deadline: float
    """[s] on that clock."""
    rooms: list[tuple[Scene, Task]]
    requests: tuple[Request, ...]
    _checks: dict[int, BasePoseChecks] = field(default_factory=dict)
    """Of base poses, by task."""

    def stops(
        self, first: int, start: Float[np.ndarray, "3"] | None
    ) -> list[list[PlacementResult]]:
        """The answers of each stop, from a task on; of the last there is none where it fails.

        Where the stop after one fails at once, that one is made elsewhere, as long as there is
        time; the tour that comes farthest is the answer.
        """
        visit = self.stop(first, start)
        best: list[list[PlacementResult]] = []
        tried: list[Float[np.ndarray, "3"]] = []
        while _solved(visit):
            found, after = [visit], first + len(visit)
            if after < len(self.rooms):
                tried.append(_base(visit))
                found += self.stops(after, tried[-1])
            best = max(best, found, key=_tasks_done)
            fails_at_once = len(found) == 2 and not _solved(found[1])
            if not fails_at_once or len(tried) > OTHERS or self.clock() > self.deadline:
                break
            elsewhere = self._elsewhere(first, visit, tried)
            if elsewhere is None:
                break
            visit = self.stop(first, start, elsewhere)
        return best or [visit]

    def _elsewhere(
        self, first: int, visit: list[PlacementResult], tried: list[Float[np.ndarray, "3"]]
    ) -> PoseFilter | None:
        """What rules out base poses of a stop from which the robot gets nowhere else."""
        after, _ = self.rooms[first + len(visit)]
        return base_poses_elsewhere(visit[0].prepared.geometry, after, tried)

    def stop(
        self, first: int, start: Float[np.ndarray, "3"] | None, elsewhere: PoseFilter | None = None
    ) -> list[PlacementResult]:
        """The longest run of tasks from the first on that one base pose serves.

        Args:
            first: The task with which it begins.
            start: Where the base is: x [m], y [m], yaw [rad]; the scene's start by default.
            elsewhere: Rules base poses out that are no other than those that were tried.

        Returns:
            One answer for each; where there is none even for the first, that alone.
        """
        tasks = len(self.rooms) - first
        for last in range(len(self.rooms) - 1, first - 1, -1):
            left = max(self.deadline - self.clock(), 1e-3)
            share = 1.0 if last == first else JOINT_SHARE / tasks
            found = self._from_one_pose(first, last, start, elsewhere, share * left)
            if found.plan.status == "solved" or last == first:
                break
        if found.plan.status != "solved" or found.plan.base_pose is None:
            return [found]
        base = np.array(found.plan.base_pose)
        others = [
            plan_at_base_pose(
                *self._asked(k), base, self.reach, start=base, config=self._config(k),
                seed=self.seed, clock=self.clock,
            )
            for k in range(first + 1, last + 1)
        ]  # fmt: skip
        return [found, *others]

    def _from_one_pose(
        self, first: int, last: int, start: Float[np.ndarray, "3"] | None,
        elsewhere: PoseFilter | None, timeout: float,
    ) -> PlacementResult:  # fmt: skip
        """The answer of the first task from a base pose that serves all up to the last."""
        scene, robot, task = self._asked(first)
        known: dict[bytes, PoseOutcome | None] = {}

        def also(base: Float[np.ndarray, "3"]) -> PoseOutcome | None:
            key = base.tobytes()
            if key not in known:
                known[key] = self._refused(base, first + 1, last)
            return known[key]

        def ruled_out(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
            out = np.zeros(len(poses), bool) if elsewhere is None else elsewhere(poses)
            for k in range(first + 1, last + 1):
                left = np.flatnonzero(~out)
                out[left] = ~self._may_serve(k, poses[left])
            return out

        config = replace(self._config(first), timeout=timeout)
        if elsewhere is not None:
            config = without_way_on(config)
        return plan_base_placement(
            scene, robot, task, self.reach, start=start, pose_filter=ruled_out, also=also,
            region=self.region, config=config, seed=self.seed, clock=self.clock,
        )  # fmt: skip

    def _refused(self, base: Float[np.ndarray, "3"], first: int, last: int) -> PoseOutcome | None:
        """Why a base pose does not serve the tasks from one to another, or what comes after."""
        for k in range(first, min(last + 2, len(self.rooms))):
            checks = self._check_of(k)
            words = f"{self.requests[k].verb} {self.requests[k].object}: "
            try:
                start_pose(
                    self.rooms[k][0], self.robot, checks.prepared.motion, base,
                    checks.query.nav_map,
                )  # fmt: skip
            except SceneError as error:
                return PoseOutcome(PoseStatus.NOT_FOR_ALL, f"before {words}{error}")
            if k > last:
                break
            attempt = checks.in_one_hold(base)
            if attempt.motion is None:
                return PoseOutcome(PoseStatus.NOT_FOR_ALL, words + attempt.outcome.summary)
        return None

    def _may_serve(self, k: int, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether the base stands clear for a task, and the map gives it a way of holding."""
        prepared = self._check_of(k).prepared
        geometry = replace(prepared.geometry, clearance=self.config.place.clearance)
        may = base_pose_status(geometry, poses)[0] == BaseStatus.CLEAR
        rows = np.flatnonzero(may)
        reached = np.zeros(len(rows), bool)
        for score in prepared.ways:
            reached |= score(self.reach, poses[rows]).scores.max(1, initial=0.0) > 0
        may[rows] = reached
        return may

    def _check_of(self, k: int) -> BasePoseChecks:
        if k not in self._checks:
            scene, robot, task = self._asked(k)
            watch = Stopwatch(lambda: 0.0)
            query = PlacementQuery(
                scene, robot, task, self.reach, None, None, self._config(k), self.seed, watch
            )
            self._checks[k] = BasePoseChecks(query)
        return self._checks[k]

    def _asked(self, k: int) -> tuple[Scene, Robot, Task]:
        scene, task = self.rooms[k]
        return scene, self.robot, task

    def _config(self, k: int) -> PipelineConfig:
        """As configured; before another task the arm comes home."""
        motion = self.config.motion
        home = motion.home_again or k + 1 < len(self.rooms)
        return replace(self.config, motion=replace(motion, home_again=home))
