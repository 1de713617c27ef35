"""Plan several tasks one after the other, from one base pose if possible, else from few stops."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, get_args

import numpy as np

from momapos.core import Clock, OutOfTimeError, SceneError, Stopwatch, TaskError
from momapos.model import with_times
from momapos.model.plan_files import write_tour
from momapos.model.records import (
    ANYWHERE,
    PoseOutcome,
    PoseStatus,
    RequestVerb,
    Status,
    Task,
    status_of_all,
)
from momapos.model.scene import Scene, copied, save_scene, scene_after
from momapos.planning.grasps import GraspFilter, make_task, turns_to
from momapos.planning.placement import (
    BaseStatus,
    PoseMask,
    base_pose_status,
    reachable_rectangle,
)

from .base_pose_check import BasePoseChecks, plan_at_pose
from .carries import MAX_CHOICES, Carry, at_home_only, carries_for, refuse_place
from .config import PipelineConfig
from .max_opening import MIN_TIMEOUT, by_samples
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
MAX_THOROUGH = 2
"""Number of tours whose base poses are searched on a grid, of those that differ in how they move
objects; samples find one that works sooner [-]."""
SHARED_POSE_SHARE = 0.5
"""Share of the remaining time per task for the search of a base pose that serves several tasks;
the rest is for each task alone [-]."""


class Request(NamedTuple):
    """A requested task; its meaning depends on the tasks before it."""

    verb: RequestVerb
    object: str
    joint: str | None = None
    to: float | str | None = None
    """Value to reach, see `make_task`; for `bring` and `place` where to put it, see `spots_for`."""


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
    scenes: tuple[Scene, ...] = ()
    """The scene of each task; that of a task that places something has it at its goal."""

    @property
    def status(self) -> Status:
        """Return the status of the last task, or `assumed` if only that keeps it from solved."""
        if self.unanswered:
            return "timeout"
        return status_of_all([step.plan for step in self.steps])

    @property
    def done(self) -> int:
        """Return how many tasks, or poses of the tool, have a plan."""
        return sum(max(1, len(step.plan.task.poses)) for step in self.steps if step.plan.feasible)

    @property
    def driving(self) -> float:
        """Return the total driving length [m]."""
        return sum(step.plan.navigation_cost or 0.0 for step in self.steps)

    def with_scene_files(self, out: Path) -> Tour:
        """Write the scenes in which something has been moved; return the tour that names them.

        Args:
            out: File of the tour; the scenes become `<stem>_room_<number>.json` next to it, with
                the files of their models in `<stem>_room_<number>_files`.

        Raises:
            SceneError: A file cannot be written or copied.
        """
        steps: list[PlacementResult] = []
        files: dict[int, Path] = {}
        for number, (step, scene) in enumerate(zip(self.steps, self.scenes, strict=False), 1):
            if scene.path is None:
                if id(scene) not in files:
                    file = files[id(scene)] = out.with_name(f"{out.stem}_room_{number}.json")
                    if file.is_file():  # of an earlier answer
                        file.unlink()
                        shutil.rmtree(file.with_name(f"{file.stem}_files"), ignore_errors=True)
                    with copied(scene, file) as own:
                        save_scene(own, file)
                plan = replace(step.plan, scene=str(files[id(scene)]), scene_joints={})
                step = replace(step, plan=plan)
            steps.append(step)
        return replace(self, steps=tuple(steps))

    def timed(self) -> Tour:
        """Return the tour whose plans have their notes and times."""
        return replace(self, steps=tuple(
            replace(step, plan=with_times(step.with_notes().plan, step.prepared.robot))
            for step in self.steps
        ))  # fmt: skip

    def save(self, out: Path) -> Tour:
        """Write the tour, its plans and its scenes, see `with_scene_files`; return what is written.

        Raises:
            InputError: A file cannot be written.
            SceneError: A scene cannot be written or copied.
        """
        tour = self.timed().with_scene_files(out)
        write_tour(out, [one.plan for one in tour.steps], tour.stops, tour.assumed, tour.status)
        return tour


def best_tour(tours: Sequence[Tour]) -> Tour:
    """Return the tour with the most solved tasks, then by status, stops and driving."""
    order: tuple[Status, ...] = get_args(Status)
    return min(tours, key=lambda t: (-t.done, order.index(t.status), max(t.stops), t.driving))


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
    requests = expanded(requests, query.scene)
    picks = carried(requests)
    best: Tour | None = None
    passes = [(query.config, MAX_THOROUGH)]
    if picks:
        passes.insert(0, (by_samples(query.config), MAX_CHOICES))
    for config, most in passes:
        tours = _tours(replace(query, config=config), requests, picks, began)
        try:
            for tour in islice(tours, most):
                best = tour if best is None or _solved_tasks(tour) >= _solved_tasks(best) else best
        except OutOfTimeError:
            if best is None:
                raise
            best = _late(best)
        if best is not None and best.steps[-1].plan.status != "infeasible":
            break
    assert best is not None
    return replace(best, seconds=clock() - began)


def _late(tour: Tour) -> Tour:
    """Return a tour whose last task has no plan yet, rather than none."""
    *done, last = tour.steps
    if last.plan.feasible:
        return tour
    return replace(tour, steps=(*done, replace(last, plan=replace(last.plan, status="timeout"))))


def _tours(
    query: PlacementQuery, requests: Sequence[Request], picks: Sequence[int], began: float
) -> Iterator[Tour]:
    """Yield tours, with other ways to move the object at which the one before fails.

    Args:
        query: See `plan_requests`.
        requests: The tasks, without `bring`.
        picks: Indices of tasks that pick up what the next one places.
        began: Time on the query's clock at which the answer began [s].
    """
    clock, tried = query.watch.clock, dict.fromkeys(picks, 0)
    while True:
        choices = Choices(query, tried)
        scenes = scenes_of(query.scene, requests, choices)
        planner = _Planner(
            query, clock, began + query.config.timeout, scenes, tuple(requests), choices.carries
        )
        visits = planner.stops(0, query.start)
        steps = [step for visit in visits for step in visit]
        stops = [k for k, visit in enumerate(visits, 1) for _ in visit]
        unanswered = len(requests) - len(steps) if steps[-1].plan.feasible else 0
        rooms = tuple(room for room, _ in scenes[: len(steps)])
        yield Tour(
            tuple(steps), tuple(stops), _assumed(requests), clock() - began, unanswered, rooms
        )
        failed = len(steps) - 1
        pick = failed if failed in tried else failed - 1
        if steps[-1].plan.status != "infeasible" or pick not in tried:
            return
        tried[pick] += 1
        if tried[pick] == choices.count[pick] or clock() > planner.deadline:
            return


def _solved_tasks(tour: Tour) -> int:
    return sum(step.plan.feasible for step in tour.steps)


def expanded(requests: Sequence[Request], scene: Scene) -> list[Request]:
    """Return requests that each take one grasp.

    To bring an object is to pick it up and to place it, and to turn a wheel by more than half a
    turn is to turn it several times.
    """
    tasks: list[Request] = []
    turned = dict[tuple[str, str], float]()
    for one in requests:
        if one.verb == "bring":
            refuse_place(one.verb, one.object, one.to)
            tasks += [Request("pick", one.object, one.joint), one._replace(verb="place")]
            continue
        named = isinstance(one.object, str) and isinstance(one.joint, str | None)
        before = turned.get((one.object, one.joint or "")) if named else None
        turns = turns_to(scene, one.verb, one.object, one.joint, one.to, before)
        if turns is not None:
            joint, values = turns
            tasks += [one._replace(joint=joint, to=value) for value in values]
        else:
            tasks.append(one)
        if named and isinstance(tasks[-1].to, float):
            turned[one.object, tasks[-1].joint or ""] = tasks[-1].to
            turned[one.object, one.joint or ""] = tasks[-1].to
    return tasks


def carried(requests: Sequence[Request]) -> list[int]:
    """Return the indices of tasks that pick up what the next one places."""
    return [
        k
        for k, (one, then) in enumerate(pairwise(requests))
        if (one.verb, then.verb, one.object) == ("pick", "place", then.object)
    ]


@dataclass
class Choices:
    """What is chosen of the ways to move objects, and the grasps that it leaves to the tasks."""

    query: PlacementQuery
    tried: Mapping[int, int]
    """Number of ways that failed, by the index of the task that picks the object up."""
    carries: dict[int, Carry] = field(default_factory=dict)
    """The chosen way, by the index of that task."""
    count: dict[int, int] = field(default_factory=dict)
    """Number of ways, by the index of that task."""

    def carry(self, k: int, scene: Scene, name: str, to: float | str | None) -> Scene:
        """Choose how to move the object that a task picks up; return the scene with it there."""
        if to is not None:
            refuse_place("place", name, to)
        every = carries_for(self.query, scene, name, None if to is None else str(to))
        carry = self.carries[k] = every[min(self.tried[k], len(every) - 1)]
        self.count[k] = len(every)
        return scene if to is None else scene.with_pose(name, carry.T_world_goal)


def scenes_of(
    scene: Scene, requests: Sequence[Request], choices: Choices | None = None
) -> list[tuple[Scene, Task]]:
    """Return each task with the scene in which it begins, or in which it places something.

    Args:
        scene: The scene before the first task.
        requests: The tasks, without `bring`.
        choices: Chooses where objects are put; None to leave them where they are.
    """
    if not 1 <= len(requests) <= MAX_TASKS:
        raise TaskError(f"a tour has 1 to {MAX_TASKS} tasks, not {len(requests)}")
    scenes: list[tuple[Scene, Task]] = []
    last: dict[str, str] = {}
    placed: dict[int, Scene] = {}
    for k, (verb, name, joint, to) in enumerate(requests):
        if k in placed:
            scene = placed[k]
        if joint is None and verb in _INVERSE:
            if last.get(name) == verb:
                raise TaskError(
                    f"{verb} {name}: the tour has done that before; {_INVERSE[verb]} it in between"
                )
            last[name] = verb
        brought = verb == "place" and k > 0 and requests[k - 1][:2] == ("pick", name)
        task = make_task(scene, verb, name, joint, None if brought else to)
        if task.farthest:
            raise TaskError(
                f"{verb} {name}: the task after it needs to know how far; give a value, as 90deg"
            )
        scenes.append((scene, task))
        scene = scene_after(scene, task)
        if choices is not None and k in choices.tried:
            placed[k + 1] = choices.carry(k, scene, name, requests[k + 1].to)
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
        for before, request in pairwise(requests)
        if request.verb == "place" and before[:2] != ("pick", request.object)
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
    carries: dict[int, Carry] = field(default_factory=dict)
    """How objects are moved, by the index of the task that picks one up for the next task."""
    _whole: dict[int, Carry] = field(default_factory=dict)
    """The same before a grasp was chosen."""
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
            if not self._within_one_reach(first, last):
                continue
            left = max(self.deadline - self.clock(), 1e-3)
            share = 1.0 if last == first else SHARED_POSE_SHARE / tasks
            try:
                limit = max(share * left, MIN_TIMEOUT)
                found = self._from_one_pose(first, last, start, in_others, limit)
            except OutOfTimeError:
                if last == first:
                    raise
                continue
            if found.plan.feasible or last == first:
                break
        pose = found.plan.final_base_pose
        if not found.plan.feasible or pose is None:
            return [found]
        self._keep_grasp(first, found)
        base = np.array(pose)
        visit = [found]
        with suppress(OutOfTimeError):
            for k in range(first + 1, last + 1):
                visit += self._then(k, base, visit)
                self._keep_grasp(k, visit[-1])
        return visit

    def _then(
        self, k: int, base: Float[np.ndarray, "3"], visit: list[PlacementResult]
    ) -> list[PlacementResult]:
        """Return the answer of a task at the stop of the tasks before it.

        If it cannot place an object as that was picked up, the pick is planned again, with the
        grasp and to the arm's state from which it can.
        """
        found = plan_at_pose(replace(self._query(k), start=base), base)
        if found.plan.feasible or k - 1 not in self.carries:
            return [found]
        held, whole = self.carries[k - 1], self._whole[k - 1]
        self.carries[k - 1] = whole
        other = plan_at_pose(replace(self._query(k), start=base), base)
        if other.plan.feasible:
            self.carries[k - 1] = whole.holding(self.scenes[k][0], other)
            pick = replace(self._query(k - 1), start=visit[-1].start)
            again = plan_at_pose(pick, base)
            if again.plan.feasible:
                visit[-1] = again
                return [other]
        self.carries[k - 1] = held
        return [found]

    def _within_one_reach(self, first: int, last: int) -> bool:
        """Return whether one base pose may reach all that is picked up and placed."""
        rigid = [k for k in range(first, last + 1) if self.scenes[k][1].joint is None]
        if len(rigid) < 2:
            return True
        tasks = [self._checks_of(k).prepared for k in rigid]
        if any(task.infeasible_reason for task in tasks):
            return False
        every = [reachable_rectangle(task.geometry) for task in tasks]
        boxes = np.array([box for box in every if box is not None])
        return len(boxes) < len(every) or bool((boxes[:, 0].max(0) < boxes[:, 1].min(0)).all())

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
            keep_grasps=self._grasps_of(k),
            carried=next((self.carries[j].carried for j in (k, k - 1) if j in self.carries), None),
        )  # fmt: skip

    def _grasps_of(self, k: int) -> GraspFilter | None:
        """Return which grasps a task may use."""
        scene, task = self.scenes[k]
        for pick in (k, k - 1):
            if pick in self.carries:
                return self.carries[pick].keeps(scene, task, self.query.keep_grasps)
        if task.verb == "pick" and k + 1 < len(self.scenes):
            return at_home_only(self.query.robot, self.query.keep_grasps)
        return self.query.keep_grasps

    def _keep_grasp(self, k: int, found: PlacementResult) -> None:
        """Keep the grasp in which a task picks something up, for the task that places it."""
        if k in self.carries and found.plan.feasible:
            whole = self._whole[k] = self.carries[k]
            self.carries[k] = whole.holding(self.scenes[k][0], found)
            self._checks.pop(k + 1, None)

    def _config(self, k: int) -> PipelineConfig:
        """Return the configuration of a task; before another task the arm returns home."""
        motion = self.query.config.motion
        home = motion.home_again or k + 1 < len(self.scenes)
        return replace(self.query.config, motion=replace(motion, home_again=home))
