"""Find how far a part can be moved if it cannot be moved to the task's value."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import (
    Clock,
    OutOfTimeError,
    Stopwatch,
    owner_cache,
    processor_time,
    time_limit,
)
from momapos.model.records import ANYWHERE, PoseOutcome, PoseStatus
from momapos.planning.grasps import FULL_DOF, slides
from momapos.verification import meets_floor_at

from .base_use import plan_moving
from .config import PipelineConfig
from .max_opening import (
    MIN_TIMEOUT,
    answer_on_watch,
    by_samples,
    find_max_opening,
    last_that_works,
    values_per_waypoint,
    values_short_of,
)
from .plan import plan_to_value
from .query import PlacementQuery
from .result import Answer, PlacementResult
from .several_stops import MAX_STOPS, STRETCHES, plan_in_stretches
from .time_limit import FARTHEST, cut_short, time_left

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Reached:
    """How far one use of the base moves a part."""

    use: str
    """The use in words."""
    best: PlacementResult | None
    """The answer for the farthest value that was found; None if there is none."""
    refused: PlacementResult | None
    """The answer for the next value, which has no motion."""
    start: float
    """Where the part is now [rad] or [m]."""

    @property
    def way(self) -> float:
        """Return how far the part moves [rad] or [m]."""
        to = None if self.best is None else self.best.plan.task.to
        return 0.0 if to is None else abs(to - self.start)

    def __str__(self) -> str:
        to, farther = (
            "" if one is None or one.plan.task.to is None else one.value_words(one.plan.task.to)
            for one in (self.best, self.refused)
        )
        why = "" if self.refused is None else f"{farther} was found: {_why_not(self.refused)}"
        if self.best is None:
            return f"{self.use}, no motion even to {why}"
        return f"{self.use}, the part moves at least to {to}" + (why and f"; no motion to {why}")


def reached_by_use(
    query: PlacementQuery, infeasible: PlacementResult, answer: Answer
) -> list[Reached]:
    """Find how far each use of the base moves the part, to an eighth of its way.

    Few searches estimate it. What is then stated is asked directly, with the query's whole
    configuration: that the part moves to a value, and that it does not move an eighth farther, with
    the reason. The query's stopwatch counts the time.

    Args:
        query: A question that has no answer, with the uses that it allows.
        infeasible: Its answer.
        answer: Answers a question from one base pose.
    """
    use = query.config.base
    ask = _Questions(query, answer, {STRETCHES - 1: infeasible})
    every = [ask.farthest("from one base pose", ask.from_one_pose, ask.estimate(answer))]
    if use in ("stops", "auto"):
        known = plan_in_stretches(query, infeasible, answer, how_far=True).stretches
        guess = ask.index_of(known[-1]) if known else -1
        name = f"from up to {MAX_STOPS} stops"
        every.append(ask.farthest(name, ask.from_stops, max(guess, ask.index_of(every[0].best))))
    if use in ("moving", "auto"):
        guess = max(ask.estimate(plan_moving), ask.index_of(every[0].best))
        every.append(ask.farthest("with a moving base", ask.with_moving_base, guess))
    return every


@dataclass
class _Questions:
    """Direct questions about eighths of the way, those from one base pose asked once."""

    query: PlacementQuery
    answer: Answer
    """Answers a question from one base pose."""
    known: dict[int, PlacementResult]
    """Answers from one base pose, by eighth."""

    @property
    def start(self) -> float:
        """Return where the part is now [rad] or [m]."""
        task = self.query.task
        assert task.joint is not None
        return self.query.scene.object(task.object).values()[task.joint]

    @property
    def values(self) -> Float[np.ndarray, " k"]:
        """Return the values that are asked for, whole degrees or centimeters [rad] or [m]."""
        task = self.query.task
        assert task.to is not None
        unit = 0.01 if slides(self.query.scene, task) else np.radians(1.0)
        every = np.linspace(self.start, task.to, STRETCHES + 1)[1:]
        return np.append(unit * np.round(every[:-1] / unit), task.to)

    def index_of(self, found: PlacementResult | None) -> int:
        """Return which value an answer reaches; -1 for none."""
        to = None if found is None else found.plan.task.to
        return -1 if to is None else int(np.abs(self.values - to).argmin())

    def estimate(self, answer: Answer) -> int:
        """Return the last value that few searches reach, -1 for none, by bisection.

        The base poses of a short arm that drives are on a surface, which samples miss.
        """
        config = self.query.config
        if answer is not plan_moving or self.query.robot.chain.size >= FULL_DOF:
            config = by_samples(config)

        def reaches(index: int) -> bool | None:
            return self._ask(index, answer, config).plan.feasible or None

        return last_that_works(reaches, -1, STRETCHES - 1)[0]

    def farthest(self, use: str, ask: Callable[[int], PlacementResult], guess: int) -> Reached:
        """Return how far a use moves the part by direct questions, starting from an estimate."""
        best, refused, at = None, None, guess
        while at >= 0 and best is None:
            found = ask(at)
            if found.plan.feasible:
                best = found
            else:
                refused, at = found, at - 1
        while at + 1 < STRETCHES and refused is None:
            found = ask(at + 1)
            if found.plan.feasible:
                best, at = found, at + 1
            else:
                refused = found
        return Reached(use, best, refused, self.start)

    def from_one_pose(self, index: int) -> PlacementResult:
        """Answer the question for a value from one base pose."""
        if index not in self.known:
            self.known[index] = self._ask(index, self.answer, self.query.config)
        return self.known[index]

    def from_stops(self, index: int) -> PlacementResult:
        """Answer the question for a value from one base pose, or else from several stops."""
        one = self.from_one_pose(index)
        if one.plan.status != "infeasible":
            return one
        found = plan_in_stretches(self._to(index), one, self.answer)
        refused = found.refused or one
        return found.answer or replace(
            refused, plan=replace(refused.plan, task=one.plan.task, feasible_to=None)
        )

    def with_moving_base(self, index: int) -> PlacementResult:
        """Answer the question for a value from one base pose, or else with a moving base."""
        one = self.from_one_pose(index)
        if one.plan.status != "infeasible":
            return one
        return self._ask(index, plan_moving, self.query.config)

    def _to(self, index: int) -> PlacementQuery:
        """Return the question for a value."""
        task = replace(self.query.task, to=float(self.values[index]), farthest=False)
        return replace(self.query, task=task)

    def _ask(self, index: int, answer: Answer, config: PipelineConfig) -> PlacementResult:
        """Answer the question for a value; the query's stopwatch counts the time."""
        left = max(self.query.config.timeout - self.query.watch.total, MIN_TIMEOUT)
        again = replace(self._to(index), config=replace(config, timeout=left))
        return answer_on_watch(self.query, again, answer)


def _why_not(answer: PlacementResult) -> str:
    """Return what stops an infeasible answer, in words: of the base pose that came farthest."""
    candidates = answer.plan.candidates
    if answer.plan.status == "timeout":
        return "the time limit"
    if candidates.nearest is not None:
        return candidates.nearest.reason
    if answer.prepared.infeasible_reason:
        return answer.prepared.infeasible_reason
    return next(iter(candidates.rejections), "there is no base pose to try")


def with_max_opening(answer: PlacementResult, *, clock: Clock = processor_time) -> PlacementResult:
    """Add to an infeasible answer how far the part can be moved, and from which base pose.

    The value is in whole degrees or centimeters, and a plan to it exists. It is sure where the part
    itself is blocked at the next value. The time limit of the answer includes this search; a
    note says if it ended the search.

    If the query allows several stops or a moving base, notes say how far each use of the base moves
    the part and what stops it. The value then is the largest of theirs, to an eighth of the way.

    Args:
        answer: The answer; returned unchanged unless it is infeasible, moves a joint and has its
            query.
        clock: Measures the time.
    """
    plan, query = answer.plan, answer.query
    if query is None or plan.status != "infeasible" or plan.task.joint is None:
        return answer
    config, watch = query.config, Stopwatch(clock)
    query = replace(query, task=plan.task, watch=watch)
    limit = time_left(plan, config.timeout)
    words: list[str] = []
    best, sure = None, False
    with suppress(OutOfTimeError), time_limit(limit, clock):
        if config.base == "fixed":
            if not is_beyond_any_opening(answer):
                best, sure = _largest(query, limit)
        else:
            every = reached_by_use(
                replace(query, config=replace(config, timeout=limit)), answer, _from_one_pose
            )
            best = max(every, key=lambda one: one.way).best
            words = [str(one) for one in every]
    late = watch.total > limit - MIN_TIMEOUT
    words += [cut_short("the search for a smaller value")] if late else []
    plan = replace(plan, timing={**plan.timing, FARTHEST: watch.total}, notes=(*plan.notes, *words))
    if best is not None:
        plan = replace(
            plan,
            feasible_to=best.plan.task.to,
            feasible_from=best.plan.base_pose,
            feasible_sure=sure,
        )
    return replace(answer, plan=plan)


def is_beyond_any_opening(answer: PlacementResult) -> bool:
    """Return whether no base pose moves the part at all, even if nothing else were in the room.

    Other objects only hinder, and a longer motion begins with a shorter one. So neither a smaller
    value nor a change of other objects helps.

    Args:
        answer: An infeasible answer about a joint, with its query.
    """
    arm = PoseOutcome(PoseStatus.NO_GRASP_IN_REACH).progress
    assert answer.query is not None
    return answer.search.progress < arm and _fails_alone(answer.query)


@owner_cache(1)
def _fails_alone(query: PlacementQuery) -> bool:
    """Return whether the shortest opening fails with no other object in the room."""
    task, config = query.task, query.config
    values = values_short_of(query)
    if not len(values):
        return False
    scene = replace(query.scene, objects=(query.scene.object(task.object),), start=None)
    alone = replace(
        query,
        scene=scene,
        task=replace(task, to=float(values[0]), farthest=False),
        start=None,
        region=ANYWHERE,
        final_check=None,
        config=replace(config, base="fixed", motion=replace(config.motion, home_again=False)),
        watch=Stopwatch(query.watch.clock),
    )
    return plan_to_value(alone).plan.status == "infeasible"


def _largest(query: PlacementQuery, limit: float) -> tuple[PlacementResult | None, bool]:
    """Return the answer for the largest value from one base pose, and whether no larger one works.

    Args:
        query: The question.
        limit: Time limit [s].
    """
    task, config, scene = query.task, query.config, query.scene
    waypoint = values_per_waypoint(config.motion, slides=slides(scene, task))
    values = values_short_of(query)
    best, sure = find_max_opening(query, plan_to_value, values, within=waypoint, timeout=limit)
    if best is not None and task.joint is not None:
        # The values end where the part meets the floor, or before the goal, which is infeasible.
        to, target = best.plan.task.to, scene.object(task.object)
        sure |= (
            bool(to == values[-1])
            and meets_floor_at(target, task.joint, task.to or 0.0) is not None
        )
    return best, sure


def _from_one_pose(query: PlacementQuery) -> PlacementResult:
    return plan_to_value(replace(query, config=replace(query.config, base="fixed")))
