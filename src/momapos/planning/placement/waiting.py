"""Base poses with an arm path that wait until the best of them is known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import ArmPathResult

from .grasp_scores import ScoreWays
from .margin import Margin, margin_of
from .pose_cost import PoseCosts
from .problem import Problem
from .shortlist import Candidate

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass
class Waiting:
    """Base poses of one round with an arm path, by index, of which the best is chosen.

    Where room comes first, the margin of some is looked at, and the one with most of it is the
    best; else the one that costs least, and none is chosen while one that is left may cost less.
    """

    costs: PoseCosts
    margin: Margin
    looks: float
    """Poses whose margin is looked at, at most; 0: it does not count [-]."""
    paths: dict[int, ArmPathResult] = field(default_factory=dict)
    cost: dict[int, float] = field(default_factory=dict)
    """Of each pose with a path."""
    margins: dict[bytes, float] = field(default_factory=dict)
    """By base pose."""
    looked: int = 0
    """Poses whose margin was looked at to choose [-]."""
    bound: float = math.inf
    """A pose that costs as much before it has a path is not better than the best that waits."""

    @classmethod
    def of(cls, problem: Problem, score: ScoreWays, costs: PoseCosts) -> Waiting:
        """None waits yet; how many margins are looked at is as configured."""
        config = costs.config
        if problem.fit is not None:  # beside a fitted pose an arm of few joints does nothing
            looks = 0.0
        elif costs.room_first:
            looks = float(config.looks) if config.method == "ours" else 0.0
        else:
            looks = math.inf if config.weight_room > 0.0 else 0.0
        return cls(costs, margin_of(problem, score, config), looks)

    def take(
        self,
        passed: dict[int, ArmPathResult],
        poses: Float[np.ndarray, "n 3"],
        known: Float[np.ndarray, " n"],
    ) -> None:
        """Let more poses wait.

        Args:
            passed: Those with a path.
            poses: All base poses of the round.
            known: What each costs before it has a path.
        """
        for i, path in passed.items():
            self.paths[i] = path
            self.cost[i] = self.full_cost(poses[i], path, float(known[i]))
            if not self.costs.room_first:
                self.bound = min(self.bound, self.cost[i])

    def full_cost(self, pose: Float[np.ndarray, "3"], path: ArmPathResult, known: float) -> float:
        """What a pose costs with its path; its room counts where no other is better already."""
        assert path.q is not None
        cost = known + self.costs.of_path(path.q)
        if self.costs.room_first or not self.looks or cost >= self.bound:
            return cost
        return cost + self.costs.of_room(self.margin_at(pose, path.grasp))

    def choose(self, poses: Float[np.ndarray, "n 3"], *, last: bool) -> dict[int, ArmPathResult]:
        """Give all that wait, in the order to be completed, as soon as the best is known.

        Args:
            poses: All base poses of the round.
            last: Whether no others come.
        """
        by_cost = sorted(self.paths, key=lambda i: self.cost[i])
        if self.costs.room_first:
            full = False
            for i in by_cost:
                if full or self.looked >= self.looks:
                    break
                self.looked += poses[i].tobytes() not in self.margins
                full = self.margin_at(poses[i], self.paths[i].grasp) == 1.0
            if not (full or last or self.looked >= self.looks):
                return {}
            by_cost.sort(key=lambda i: -self.margins.get(poses[i].tobytes(), 0.0))
        elif not last:
            return {}
        paths, self.paths, self.bound = self.paths, {}, math.inf
        return {i: paths[i] for i in by_cost}

    def prefers(self, step: Candidate, to: Candidate) -> bool:
        """Whether a base pose is better than another: it has no less room, or costs less.

        It was stepped to because it costs less before it has a path.
        """
        if not self.costs.room_first:
            cost, before = (self.full_cost(one.pose, one.path, one.known) for one in (step, to))
            return cost < before
        least = self.margins.get(to.pose.tobytes(), 0.0)
        return not self.looks or self.margin_at(step.pose, step.path.grasp) >= least

    def known_margin(self, pose: Float[np.ndarray, "3"]) -> float | None:
        """The margin of a base pose where it was looked at."""
        return self.margins.get(pose.tobytes())

    def margin_at(self, pose: Float[np.ndarray, "3"], grasp: int) -> float:
        """The margin of a base pose; looked at once."""
        key = pose.tobytes()
        if key not in self.margins:
            self.margins[key] = self.margin(pose, grasp)
        return self.margins[key]
