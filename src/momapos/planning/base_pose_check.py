"""Is this base pose feasible? One pose, all grasps, the room fully modeled."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Clock, Stopwatch
from momapos.model.records import Attempt, PoseOutcome, PoseStatus, ReachScorer, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.arm_motion import Feasibility
from momapos.planning.grasps import GraspFilter, slides
from momapos.planning.navigation import plan_path
from momapos.planning.placement import (
    BASE_OUTCOMES,
    LEAST_SCORE,
    BaseStatus,
    Search,
    base_pose_status,
)
from momapos.planning.reachability import load_reach

from .config import PipelineConfig
from .max_opening import from_the_top, values_before
from .query import PlacementQuery
from .regrasp import TwoHolds, every_two_holds
from .result import PlacementResult, plan_of
from .sliding_grasp import SlidingHook, sliding_hooks
from .task_setup import PreparedTask, driving_lengths, prepare, start_pose

if TYPE_CHECKING:
    from jaxtyping import Float

DEFAULT = PipelineConfig()
MOST_VALUES = 100
"""Values that are asked one by one at a pose; of more, only some at first [-]."""


def check_base_pose(
    scene: Scene,
    robot: Robot,
    task: Task,
    base_pose: Float[np.ndarray, "3"] | Sequence[float],
    reach: ReachScorer | None = None,
    *,
    how_far: bool = True,
    grasp_filter: GraspFilter | None = None,
    config: PipelineConfig = DEFAULT,
    cache_dir: Path | None = None,
    seed: int = 0,
) -> Attempt:
    """Plan the arm's motion at one base pose, or say why there is none and how far it goes.

    All grasps are tried, and every object of the room is modeled. Nothing is driven: whether a
    way leads to the pose does not count.

    Args:
        scene: The room.
        robot: The robot.
        task: What is to be done, see `make_task`.
        base_pose: x [m], y [m], yaw [rad].
        reach: The robot's reachability map; None to load it, or to build it at the first use.
        how_far: Whether to look for the farthest value of a joint that works, to a degree or a
            centimeter, where the task's does not.
        grasp_filter: Rules grasps out, such as those that failed; all are tried by default.
        config: How to plan.
        cache_dir: Where maps are kept; the user's cache folder by default.
        seed: Same seed, same motion.

    Returns:
        A motion that the exact check accepts, or why there is none; and the farthest value that
        works. A task that asks for as far as possible has the motion to that value.

    Raises:
        TaskError: The gripper cannot hold the object.
        RobotError: The robot and the task do not fit together.
    """
    if reach is None:
        reach = load_reach(robot, cache_dir)
    watch = Stopwatch(lambda: 0.0)
    query = PlacementQuery(scene, robot, task, reach, None, None, config, seed, watch, grasp_filter)
    return _look(query, np.asarray(base_pose, float), how_far=how_far).attempt


def plan_at_base_pose(
    scene: Scene,
    robot: Robot,
    task: Task,
    base_pose: Float[np.ndarray, "3"] | Sequence[float],
    reach: ReachScorer,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    config: PipelineConfig = DEFAULT,
    seed: int = 0,
    clock: Clock = time.perf_counter,
) -> PlacementResult:
    """Answer how the robot does a task from one base pose: drive there, move the arm.

    Args:
        scene: The room.
        robot: The robot.
        task: What is to be done, see `make_task`.
        base_pose: x [m], y [m], yaw [rad].
        reach: The robot's reachability map.
        start: Where the base is now: x [m], y [m], yaw [rad]; the scene's start by default.
        config: How to plan.
        seed: Same seed, same motion.
        clock: Measures the stages.

    Returns:
        The plan has this base pose, whether it is solved or not; where it is not, it says how far
        the part can be moved from there.

    Raises:
        SceneError: The start is no free pose.
        TaskError: The gripper cannot hold the object.
        RobotError: The robot and the task do not fit together.
    """
    watch, base = Stopwatch(clock), np.asarray(base_pose, float)
    query = PlacementQuery(scene, robot, task, reach, start, None, config, seed, watch)
    with watch.stage("search"):
        look = _look(query, base, how_far=True)
    with watch.stage("drive"):
        first = start_pose(scene, robot, look.prepared.motion, start, query.nav_map)
        # Of a cell's own width the lengths know nothing.
        stays = np.array_equal(first, base)
        length = 0.0 if stays else float(driving_lengths(look.prepared, first)(base[None, :2])[0])
    with watch.stage("way"):
        way = plan_path(query.nav_map, first, base) if np.isfinite(length) else None
    attempt = look.attempt
    if way is None:
        gone = PoseOutcome(PoseStatus.NO_ROUTE_AT_HOME)
        attempt = Attempt(None, attempt.outcome if attempt.motion is None else gone)
    solved = attempt.motion is not None
    found = Search(checked=1, base=base if solved else None, motion=attempt.motion, cost=length)
    found.note(base[None], np.array([attempt.outcome], object))
    pose = (float(base[0]), float(base[1]), float(base[2]))
    answered = replace(look.prepared.task, farthest=task.farthest and solved)
    plan = replace(
        plan_of(
            replace(query, task=answered), look.prepared, found, first, way if solved else None
        ),
        base_pose=pose,
        feasible_to=None if solved else attempt.farthest,
        feasible_from=None if solved or attempt.farthest is None else pose,
        feasible_sure=not solved and attempt.farthest is not None,
        timing=watch.timing,
    )
    return PlacementResult(plan, look.prepared, found, first, query)


@dataclass(frozen=True)
class _Look:
    """What came of a base pose, and for which value of the joint that was."""

    prepared: PreparedTask
    attempt: Attempt


def _look(query: PlacementQuery, base: Float[np.ndarray, "3"], *, how_far: bool) -> _Look:
    """Check a base pose for the task, and where that fails for what comes before its value."""
    task = query.task
    look = _attempt(query, base)
    if look.attempt.motion is not None:
        attempt = replace(look.attempt, farthest=task.to)
        return _Look(look.prepared, attempt)
    farther = _farthest(query, base) if how_far and task.joint is not None else None
    if farther is None:
        return look
    value = farther.prepared.task.to
    if task.farthest:
        return _Look(farther.prepared, replace(farther.attempt, farthest=value))
    return _Look(look.prepared, replace(look.attempt, farthest=value))


def _farthest(query: PlacementQuery, base: Float[np.ndarray, "3"]) -> _Look | None:
    """The last value before the task's that works at a base pose."""
    task = query.task
    assert task.joint is not None
    assert task.to is not None
    begin = query.scene.object(task.object).values()[task.joint]
    values = values_before(begin, task.to, slides=slides(query.scene, task))

    def ask(index: int) -> _Look | None:
        one = replace(task, to=float(values[index]))
        look = _attempt(replace(query, task=one), base)
        return look if look.attempt.motion is not None else None

    # Most poses that fail are no good for any value. One pose may fail at a value among some that
    # work, so that halving would pass by the last.
    if not len(values) or ask(0) is None:
        return None
    return from_the_top(ask, len(values), stride=1 + len(values) // MOST_VALUES)


def _attempt(query: PlacementQuery, base: Float[np.ndarray, "3"]) -> _Look:
    """Check a base pose for the value of the task."""
    checks = BasePoseChecks(query)
    return _Look(checks.prepared, checks(base))


class BasePoseChecks:
    """The check of base poses with the room modeled once, in one hold or else in more."""

    def __init__(self, query: PlacementQuery) -> None:
        self.query = query
        self.prepared = prepare(
            query.scene, query.robot, query.task, query.config, clearance=0.0,
            grasp_filter=query.grasp_filter,
        )  # fmt: skip
        self._made: list[SlidingHook | TwoHolds] = []
        self._others = self._more()

    def __call__(self, base: Float[np.ndarray, "3"]) -> Attempt:
        """The motion at a base pose x [m], y [m], yaw [rad], or why there is none."""
        attempt = self.in_one_hold(base)
        # What stands in something is not held otherwise.
        if attempt.motion is not None or attempt.outcome in BASE_OUTCOMES.values():
            return attempt
        for way in self._more_holds():
            scores = way.ways[0](self.query.reach, base[None]).at_least(LEAST_SCORE).scores
            again = _best_way(way, base, scores)
            if again.motion is not None:
                return again
        return attempt

    def in_one_hold(
        self, base: Float[np.ndarray, "3"], *, out_of_time: Callable[[], bool] = lambda: False
    ) -> Attempt:
        """The motion in one hold at a base pose, or why there is none.

        Args:
            base: x [m], y [m], yaw [rad].
            out_of_time: Whether to try no further way; then what was found out so far is told.
        """
        prepared = self.prepared
        if prepared.infeasible_reason:
            outcome = PoseOutcome(PoseStatus.TASK_INFEASIBLE, prepared.infeasible_reason)
            return Attempt(None, outcome)
        status = BaseStatus(base_pose_status(prepared.geometry, base[None])[0][0])
        if status != BaseStatus.CLEAR:
            return Attempt(None, BASE_OUTCOMES[status])
        return _in_one_hold(self.query, prepared, base, out_of_time)

    def _more(self) -> Iterator[SlidingHook | TwoHolds]:
        """A hook that slides, then two holds."""
        prepared, query = self.prepared, self.query
        feasible = prepared.feasibility(query.config, query.seed)
        yield from sliding_hooks(prepared, feasible, query.config)
        yield from every_two_holds(
            prepared, query.config, query.seed, grasp_filter=query.grasp_filter
        )

    def _more_holds(self) -> Iterator[SlidingHook | TwoHolds]:
        """Those that were made before, then others."""
        yield from self._made
        for way in self._others:
            self._made.append(way)
            yield way


def _in_one_hold(
    query: PlacementQuery,
    prepared: PreparedTask,
    base: Float[np.ndarray, "3"],
    out_of_time: Callable[[], bool],
) -> Attempt:
    """Try all ways of holding at a base pose that stands clear, the best reached first."""
    feasible = prepared.feasibility(query.config, query.seed, out_of_time=out_of_time)
    # The map is right for most poses, not for all: it orders the grasps and rules none out.
    scores = prepared.ways[0](query.reach, base[None]).at_least(LEAST_SCORE).scores
    turning = np.full((1, prepared.motion.turning.ways - scores.shape[1]), LEAST_SCORE / 2)
    scores = np.concatenate([scores, turning], axis=1)
    return _best_way(feasible, base, scores)


def _best_way(
    check: Feasibility | SlidingHook | TwoHolds,
    base: Float[np.ndarray, "3"],
    scores: Float[np.ndarray, "1 h"],
) -> Attempt:
    """Try the ways of holding at a base pose, the best reached first."""
    screened = check.screen(base[None], scores, None)
    if screened is None:
        return Attempt(None, PoseOutcome(PoseStatus.NOT_TRIED))
    if screened[0].q is None:
        return Attempt(None, screened[0].outcome)
    order = np.argsort(-scores[0], kind="stable")
    return check(base, screened[0], order[scores[0, order] > 0])
