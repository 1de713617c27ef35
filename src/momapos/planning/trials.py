"""Try variants of an infeasible query within a time limit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from momapos.core import Clock, MomaposError, Stopwatch
from momapos.model.scene import Scene
from momapos.verification import PlanVerifier

from .max_opening_plan import by_samples
from .plan import plan_to_value
from .query import PlacementQuery
from .result import PlacementResult


@dataclass(frozen=True)
class Trials:
    """Searches by samples, whose plans pass the exact check, until a time."""

    clock: Clock
    end: float
    """When the time is up, by the clock [s]."""

    @property
    def over(self) -> bool:
        """Return whether the time is up."""
        return self.clock() >= self.end

    def solve(self, query: PlacementQuery, *, count: int | None = None) -> PlacementResult | None:
        """Return a solved answer; None if none was found in time, or if the query is invalid.

        Args:
            query: The variant.
            count: Number of samples; by default that of the configuration.
        """
        left = self.end - self.clock()
        if left <= 0.0:
            return None
        config = by_samples(query.config)
        place = config.place if count is None else replace(config.place, count=count)
        config = replace(config, place=place, timeout=left)
        trial = replace(query, config=config, watch=Stopwatch(query.watch.clock))
        try:
            found = plan_to_value(trial)
        except MomaposError:
            # Such as a start that collides after the change, or a hand that holds nothing.
            return None
        return found if found.plan.feasible else None

    def keeps(self, answer: PlacementResult, scene: Scene) -> bool:
        """Return whether a plan is valid in another scene, unless the time is up."""
        plan = answer.plan
        if self.over or plan.base_pose is None or plan.motion is None:
            return False
        verifier = PlanVerifier(scene, answer.prepared.robot, plan.task)
        arm = verifier.check(plan.base_pose, plan.motion)
        return arm.valid and all(check.ok for check in verifier.drive_checks(plan))

    def smallest(
        self, solve: Callable[[int], PlacementResult | None], size: int, known: PlacementResult
    ) -> tuple[int, PlacementResult]:
        """Return the smallest size of a change that has a plan, by bisection, and the answer.

        Args:
            solve: Returns a solved answer for a size, or None.
            size: A size with a plan.
            known: Its answer.
        """
        low, best = 0, (size, known)
        while best[0] - low > 1 and not self.over:
            middle = (low + best[0]) // 2
            found = solve(middle)
            if found is None:
                low = middle
            else:
                best = (middle, found)
        return best
