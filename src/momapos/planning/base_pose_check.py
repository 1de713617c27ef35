"""Check one base pose with all grasps and every object modeled."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Stopwatch, finite_array
from momapos.model.records import ANYWHERE, Attempt, Motion, PoseOutcome, PoseStatus
from momapos.planning.arm_motion import Feasibility
from momapos.planning.navigation import BasePath, TravelLengths, plan_path
from momapos.planning.placement import (
    BASE_OUTCOMES,
    MIN_MODE_SCORE,
    BaseStatus,
    PoseOutcomes,
    Search,
    base_pose_status,
)

from .any_grasp import narrower_hands, with_other_handles_only
from .carrying import SAME_GRASP, Carrying
from .max_opening import from_the_top, values_short_of
from .query import PlacementQuery
from .regrasp import TwoGrasps, iter_two_grasps
from .result import PlacementResult, plan_of
from .sliding_grasp import SlidingHook, sliding_hooks
from .task_setup import PreparedTask, cost_map, prepare, start_pose

if TYPE_CHECKING:
    from jaxtyping import Float

_SAME_FOR_ALL_HANDLES = (PoseStatus.BASE_BLOCKED, PoseStatus.OFF_FLOOR)
"""Outcomes of a base pose that no other handle changes."""
MAX_VALUES_IN_TURN = 100
"""Number of values that are tried one by one at a pose; if there are more, in larger steps [-]."""


def check_pose(
    query: PlacementQuery,
    base_pose: Float[np.ndarray, "3"] | Sequence[float],
    *,
    how_far: bool = True,
) -> Attempt:
    """Plan the arm's motion at one base pose, or return why there is none and how far it goes.

    All grasps are tried, and every object of the scene is modeled. Driving there is not checked.

    Args:
        query: The question; its start and region are ignored.
        base_pose: x [m], y [m], yaw [rad].
        how_far: Whether to find the largest joint value that works, to a degree or a centimeter,
            if the task's value does not.

    Returns:
        A motion that passes the exact check, or why there is none; and the largest value that
        works. A task that requests the maximum gets the motion to that value.

    Raises:
        InputError: The base pose is not three finite numbers.
        TaskError: The gripper cannot hold the object.
        RobotError: The robot and the task do not fit together.
    """
    base = finite_array("base_pose", base_pose, (3,))
    # Without a clock nothing depends on the time that is left.
    timeless = replace(query, watch=Stopwatch(lambda: 0.0))
    return _look(timeless, base, how_far=how_far).attempt


def plan_at_pose(
    query: PlacementQuery, base_pose: Float[np.ndarray, "3"] | Sequence[float]
) -> PlacementResult:
    """Return how the robot does a task from one base pose: the drive there and the arm's motion.

    Args:
        query: The question; its region is ignored.
        base_pose: x [m], y [m], yaw [rad].

    Returns:
        The plan has this base pose, whether it is solved or not. If it is not, the plan states how
        far the part can be moved from there.

    Raises:
        InputError: The base pose is not three finite numbers.
        SceneError: The robot collides at its start pose.
        TaskError: The gripper cannot hold the object.
        RobotError: The robot and the task do not fit together.
        OutOfTimeError: The time was over before.
    """
    base = finite_array("base_pose", base_pose, (3,))
    with query.in_time():
        return _plan_at_pose(replace(query, region=ANYWHERE), base)


def _plan_at_pose(query: PlacementQuery, base: Float[np.ndarray, "3"]) -> PlacementResult:
    watch, task = query.watch, query.task
    with watch.stage("search"):
        look = _look_with_any_hand(query, base)
    query = replace(query, robot=look.prepared.robot)
    with watch.stage("drive"):
        first = start_pose(
            query.scene, query.robot, look.prepared.motion, query.start, query.nav_map
        )
        # Driving lengths have the resolution of a cell.
        stays = np.array_equal(first, base)
        length = 0.0 if stays else _driving_length(look.prepared, first, base)
    path = None
    with watch.stage("path"):
        if np.isfinite(length):
            look, path = _with_path(query, look, first, base)
    attempt = look.attempt
    if path is None:
        carries = PoseOutcome(PoseStatus.NO_ROUTE_CARRYING, task.object)
        no_route = carries if task.verb == "place" else PoseOutcome(PoseStatus.NO_ROUTE_AT_HOME)
        attempt = Attempt(None, attempt.outcome if attempt.motion is None else no_route)
    solved = attempt.motion is not None
    found = Search(checked=1, base=base if solved else None, motion=attempt.motion, cost=length)
    found.note(base[None], PoseOutcomes([attempt.outcome]))
    pose = (float(base[0]), float(base[1]), float(base[2]))
    answered = replace(look.prepared.task, farthest=task.farthest and solved)
    plan = replace(
        plan_of(
            replace(query, task=answered), look.prepared, found, first, path if solved else None
        ),
        base_pose=pose,
        feasible_to=None if solved else attempt.farthest,
        feasible_from=None if solved or attempt.farthest is None else pose,
        feasible_sure=not solved and attempt.farthest is not None,
        timing=watch.timing,
    )
    return PlacementResult(plan, look.prepared, found, first, query)


def _with_path(
    query: PlacementQuery, look: _Look, start: Float[np.ndarray, "3"], base: Float[np.ndarray, "3"]
) -> tuple[_Look, BasePath | None]:
    """Return the outcome at a base pose and the path there, with what the robot carries.

    If it does not get there as the arm is at home, or has no motion, other states are tried.
    """
    if query.task.verb != "place":
        return look, plan_path(query.nav_map, start, base)
    carrying = Carrying(query, look.prepared, start)
    if look.attempt.motion is not None:
        path = plan_path(carrying.map_of(look.attempt.motion), start, base)
        if path is not None:
            return look, path
    for nav_map, keep_grasp in carrying.others():
        path = plan_path(nav_map, start, base)
        if path is not None:
            carrier = replace(query, robot=nav_map.robot, keep_grasps=keep_grasp, from_home=True)
            again = _look(carrier, base, how_far=False)
            if again.attempt.motion is not None:
                return again, path
    return look, None


def _driving_length(
    prepared: PreparedTask, start: Float[np.ndarray, "3"], base: Float[np.ndarray, "3"]
) -> float:
    travel = TravelLengths(cost_map(prepared, start), prepared.robot, start)
    return float(travel(base[None])[0])


@dataclass(frozen=True)
class _Look:
    """The outcome at a base pose, for one value of the joint."""

    prepared: PreparedTask
    """The task with the handle that the motion holds; without one, with the first handle."""
    attempt: Attempt


def _look_with_any_hand(query: PlacementQuery, base: Float[np.ndarray, "3"]) -> _Look:
    """Check a base pose for the task, if it fails also with hands that are not fully open."""
    look = _look(query, base, how_far=True)
    if look.attempt.motion is None and look.attempt.outcome not in BASE_OUTCOMES.values():
        for other in narrower_hands(query, look.prepared):
            again = _look(other, base, how_far=False)
            if again.attempt.motion is None:
                break
            look = again
    return look


def _look(query: PlacementQuery, base: Float[np.ndarray, "3"], *, how_far: bool) -> _Look:
    """Check a base pose for the task and, if that fails, for smaller values."""
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
    """Find the last value before the task's that works at a base pose."""
    task = query.task
    values = values_short_of(query)

    def evaluate(index: int) -> _Look | None:
        one = replace(task, to=float(values[index]))
        look = _attempt(replace(query, task=one), base)
        return look if look.attempt.motion is not None else None

    # Most poses that fail do so for every value. A pose may also fail at a value between two that
    # work, so bisection could miss the last.
    if not len(values) or evaluate(0) is None:
        return None
    return from_the_top(evaluate, len(values), stride=1 + len(values) // MAX_VALUES_IN_TURN)


def _attempt(query: PlacementQuery, base: Float[np.ndarray, "3"]) -> _Look:
    """Check a base pose for the value of the task."""
    return _with_any_handle(BasePoseChecks(query), lambda one: one.with_this_handle(base))


def _with_any_handle(
    checks: BasePoseChecks, attempt_with: Callable[[BasePoseChecks], Attempt]
) -> _Look:
    """Check a base pose with a part's handles in turn; else give the reason that came farthest.

    Args:
        checks: The checks with the first handle.
        attempt_with: Checks the base pose with the handle of the given checks.
    """
    failed: list[Attempt] = []
    for one in checks.by_handle():
        attempt = attempt_with(one)
        if attempt.motion is not None:
            return _Look(one.prepared, attempt)
        failed.append(attempt)
        if attempt.outcome.status in _SAME_FOR_ALL_HANDLES:
            break
    return _Look(checks.prepared, max(failed, key=lambda one: one.outcome.progress))


class BasePoseChecks:
    """The check of base poses, with one grasp or else with more; the scene is modeled once."""

    def __init__(self, query: PlacementQuery) -> None:
        self.query = query
        self.prepared = prepare(
            query.scene, query.robot, query.task, query.config, clearance=0.0,
            keep_grasps=query.keep_grasps,
        )  # fmt: skip
        self._made: list[SlidingHook | TwoGrasps] = []
        self._unmade = self._make_variants()

    def __call__(self, base: Float[np.ndarray, "3"]) -> Attempt:
        """Return the motion at a base pose x [m], y [m], yaw [rad], or why there is none."""
        return _with_any_handle(self, lambda one: one.with_this_handle(base)).attempt

    def with_one_grasp(self, base: Float[np.ndarray, "3"]) -> Attempt:
        """Return the motion with one grasp of any handle at a base pose, or why there is none.

        Args:
            base: x [m], y [m], yaw [rad].
        """
        return _with_any_handle(self, lambda one: one._with_one_grasp(base)).attempt

    def by_handle(self) -> Iterator[BasePoseChecks]:
        """Yield these checks, then those with each further handle in which the hand is free."""
        one: BasePoseChecks | None = self
        while one is not None:
            yield one
            one = one._next

    def holding(self, motion: Motion) -> BasePoseChecks:
        """Return the checks with the handle that a motion holds first."""
        away: list[float] = []
        every: list[BasePoseChecks] = []
        for one in self.by_handle():
            grasps = one.prepared.motion.Ts_world_tool[:, one.prepared.motion.grasp_step]
            away.append(float(np.abs(grasps - motion.Ts_world_tool[0]).sum((1, 2)).min()))
            every.append(one)
            if away[-1] < SAME_GRASP:
                break
        return every[int(np.argmin(away))]

    @cached_property
    def _next(self) -> BasePoseChecks | None:
        """The checks with the handles after this one; None if the hand is free at none of them."""
        other = with_other_handles_only(self.query, self.prepared)
        return None if other is None else BasePoseChecks(other)

    def with_this_handle(self, base: Float[np.ndarray, "3"]) -> Attempt:
        """Return the motion at a base pose with the first handle only, or why there is none."""
        attempt = self._with_one_grasp(base)
        # More grasps do not help a base that collides.
        if attempt.motion is not None or attempt.outcome in BASE_OUTCOMES.values():
            return attempt
        for variant in self._variants():
            scores = variant.mode_scorers[0](self.query.reach, base[None])
            again = _best_mode(variant, base, scores.at_least(MIN_MODE_SCORE).scores)
            if again.motion is not None:
                return again
        return attempt

    def _with_one_grasp(self, base: Float[np.ndarray, "3"]) -> Attempt:
        prepared = self.prepared
        if prepared.infeasible_reason:
            outcome = PoseOutcome(PoseStatus.TASK_INFEASIBLE, prepared.infeasible_reason)
            return Attempt(None, outcome)
        status = BaseStatus(base_pose_status(prepared.geometry, base[None])[0][0])
        if status != BaseStatus.CLEAR:
            return Attempt(None, BASE_OUTCOMES[status])
        return _with_one_grasp(self.query, prepared, base)

    def _make_variants(self) -> Iterator[SlidingHook | TwoGrasps]:
        """Yield the task with a sliding hook, then with two grasps."""
        prepared, query = self.prepared, self.query
        feasible = prepared.feasibility(query.config, query.seed)
        yield from sliding_hooks(prepared, feasible, query.config)
        yield from iter_two_grasps(
            prepared, query.config, query.seed, keep_grasps=query.keep_grasps
        )

    def _variants(self) -> Iterator[SlidingHook | TwoGrasps]:
        """Yield the variants made before, then others."""
        yield from self._made
        for variant in self._unmade:
            self._made.append(variant)
            yield variant


def _with_one_grasp(
    query: PlacementQuery,
    prepared: PreparedTask,
    base: Float[np.ndarray, "3"],
) -> Attempt:
    """Try all grasp modes at a free base pose, the best reached first."""
    carried = query.carried
    homes = None if carried is None else lambda *_: (carried,)
    feasible = prepared.feasibility(query.config, query.seed, homes=homes)
    # The map misses some poses: it orders the grasps and excludes none.
    scores = prepared.mode_scorers[0](query.reach, base[None]).at_least(MIN_MODE_SCORE).scores
    turning = np.full((1, prepared.motion.turning.modes - scores.shape[1]), MIN_MODE_SCORE / 2)
    scores = np.concatenate([scores, turning], axis=1)
    return _best_mode(feasible, base, scores)


def _best_mode(
    check: Feasibility | SlidingHook | TwoGrasps,
    base: Float[np.ndarray, "3"],
    scores: Float[np.ndarray, "1 h"],
) -> Attempt:
    """Try the grasp modes at a base pose, the best reached first."""
    screened = check.screen(base[None], scores, None)
    if screened[0].q is None:
        return Attempt(None, screened[0].outcome)
    order = np.argsort(-scores[0], kind="stable")
    return check(base, screened[0], order[scores[0, order] > 0])
