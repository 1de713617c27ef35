"""Try variants of an infeasible query: a number of them, within a time limit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from momapos.core import Clock, MomaposError, Stopwatch
from momapos.model.scene import Scene, with_assumptions
from momapos.verification import PlanVerifier

from .max_opening_plan import MIN_TIMEOUT, by_samples
from .plan import plan_to_value
from .query import PlacementQuery
from .result import PlacementResult

MAX_TRIALS = 10
"""Maximum number of searches [-]. Not a time, so that a busy machine gives the same advice; of 8
infeasible tasks in two kitchens, 5 become feasible in trials 5 to 10 and 3 in none of 16."""


@dataclass
class Trials:
    """Searches by samples, whose plans pass the exact check."""

    clock: Clock
    end: float
    """When the time is up, by the clock [s]."""
    left: int = MAX_TRIALS
    """Number of further searches [-]."""

    @property
    def late(self) -> bool:
        """Return whether the time is up."""
        return self.clock() >= self.end

    @property
    def over(self) -> bool:
        """Return whether no search is left."""
        return self.left <= 0 or self.late

    def solve(self, query: PlacementQuery, *, count: int | None = None) -> PlacementResult | None:
        """Return a solved answer; None if none was found, or if the query is invalid.

        Args:
            query: The variant.
            count: Number of samples; by default that of the configuration.
        """
        if self.over:
            return None
        self.left -= 1
        left = max(self.end - self.clock(), MIN_TIMEOUT)
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
        if self.late or plan.base_pose is None or plan.motion is None:
            return False
        verifier = PlanVerifier(with_assumptions(scene, plan), answer.prepared.robot, plan.task)
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
