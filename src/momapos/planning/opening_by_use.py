"""Say how far each use of the base moves a part that none moves all the way, and what stops it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from momapos.planning.grasps import FULL_DOF

from .base_use import plan_moving
from .config import PipelineConfig
from .max_opening import last_that_works
from .max_opening_plan import MIN_TIMEOUT, answer_on_watch, by_samples
from .query import PlacementQuery
from .result import PlacementResult
from .several_stops import MAX_STOPS, STRETCHES, plan_stops

Answer: TypeAlias = "Callable[[PlacementQuery], PlacementResult]"


@dataclass(frozen=True, eq=False)
class Reached:
    """How far one use of the base moves a part."""

    use: str
    """The use in words."""
    best: PlacementResult | None
    """The answer for the farthest value that was found; None if there is none."""
    refused: PlacementResult | None
    """The answer for a farther value that has no motion; None if the part does not stay there."""
    start: float
    """Where the part is now [rad] or [m]."""

    @property
    def way(self) -> float:
        """Return how far the part moves [rad] or [m]."""
        to = None if self.best is None else self.best.plan.task.to
        return 0.0 if to is None else abs(to - self.start)

    def __str__(self) -> str:
        why = "the part does not stay where the hand would let go"
        if self.refused is not None:
            why = _why_not(self.refused)
        known = self.best or self.refused
        if known is None or known.plan.task.to is None:
            return f"{self.use}, no motion was found: {why}"
        value = known.value_words(known.plan.task.to)
        if self.best is None:
            return f"{self.use}, no motion even to {value} was found: {why}"
        return f"{self.use}, the part moves at least to {value}; farther: {why}"


def reached_by_use(query: PlacementQuery, answer: Answer) -> list[Reached]:
    """Find how far each use of the base moves the part, to an eighth of its way.

    Few searches estimate it, for most robots by samples alone; the query's stopwatch counts their
    time.

    Args:
        query: A question that has no answer, with the uses that it allows.
        answer: Answers a question from one base pose.
    """
    use, quick, task = query.config.base, by_samples(query.config), query.task
    assert task.joint is not None
    start = query.scene.object(task.object).values()[task.joint]
    best, refused = _farthest(query, quick, answer, start)
    every = [Reached("from one base pose", best, refused, start)]
    if use in ("stops", "auto"):
        found = plan_stops(query, refused, answer, how_far=True)
        last = found.stretches[-1] if found.stretches else None
        failed = found.refused if last else found.refused or refused
        every.append(Reached(f"from up to {MAX_STOPS} stops", last, failed, start))
    if use in ("moving", "auto"):
        # The base poses of a short arm are on a surface, which samples miss.
        how = query.config if query.robot.chain.size < FULL_DOF else quick
        every.append(
            Reached("with a moving base", *_farthest(query, how, plan_moving, start), start)
        )
    return every


def _farthest(
    query: PlacementQuery, config: PipelineConfig, answer: Answer, start: float
) -> tuple[PlacementResult | None, PlacementResult]:
    """Return the answer for the farthest value that has one, and that for the next, by bisection.

    The first try is the task's own value, which shows why it has no answer.
    """
    task = query.task
    assert task.to is not None
    values = np.linspace(start, task.to, STRETCHES + 1)[1:]

    def answer_to(index: int) -> PlacementResult:
        left = max(query.config.timeout - query.watch.total, MIN_TIMEOUT)
        one = replace(task, to=float(values[index]), farthest=False)
        again = replace(query, task=one, config=replace(config, timeout=left))
        return answer_on_watch(query, again, answer)

    refused = answer_to(len(values) - 1)
    if refused.plan.feasible:
        return refused, refused

    def moved_to(index: int) -> PlacementResult | None:
        nonlocal refused
        found = answer_to(index)
        if found.plan.feasible:
            return found
        refused = found
        return None

    _, best = last_that_works(moved_to, -1, len(values) - 1)
    return best, refused


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
