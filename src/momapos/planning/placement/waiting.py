"""Hold back base poses with an arm path until the best of them is known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import ArmPathResult

from .grasp_scores import GraspModeScorer
from .margin import Robustness, robustness_of
from .pose_cost import PoseCosts
from .problem import Problem
from .shortlist import Candidate

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass
class Waiting:
    """Base poses of one round with an arm path, by index.

    If robustness is compared first, the best is the most robust of some; otherwise it is the
    cheapest, chosen as soon as no remaining pose may cost less.
    """

    costs: PoseCosts
    robustness: Robustness
    looks: float
    """Maximum number of poses whose robustness is measured; 0: it does not count [-]."""
    paths: dict[int, ArmPathResult] = field(default_factory=dict)
    cost: dict[int, float] = field(default_factory=dict)
    """Cost of each pose with a path."""
    measured: dict[bytes, float] = field(default_factory=dict)
    """Robustness by base pose."""
    looked: int = 0
    """Number of poses whose robustness was measured to choose [-]."""
    bound: float = math.inf
    """A pose of this known cost cannot be better than the best that waits."""

    @classmethod
    def of(cls, problem: Problem, score: GraspModeScorer, costs: PoseCosts) -> Waiting:
        """Start with no poses, as the costs are configured."""
        config = costs.config
        if problem.fit is not None:  # an arm of few joints has no path next to a fitted pose
            looks = 0.0
        elif costs.robustness_first:
            looks = float(config.compared) if config.method == "ours" else 0.0
        else:
            looks = math.inf if config.weight_robustness > 0.0 else 0.0
        return cls(costs, robustness_of(problem, score, config), looks)

    def take(
        self,
        passed: dict[int, ArmPathResult],
        poses: Float[np.ndarray, "n 3"],
        known: Float[np.ndarray, " n"],
    ) -> None:
        """Add the poses with a path; `poses` and `known` costs cover the whole round."""
        for i, path in passed.items():
            self.paths[i] = path
            self.cost[i] = self.full_cost(poses[i], path, float(known[i]))
            if not self.costs.robustness_first:
                self.bound = min(self.bound, self.cost[i])

    def full_cost(self, pose: Float[np.ndarray, "3"], path: ArmPathResult, known: float) -> float:
        """Return a pose's cost with its path, and with its robustness unless another is better."""
        assert path.q is not None
        cost = known + self.costs.of_path(path.q)
        if self.costs.robustness_first or not self.looks or cost >= self.bound:
            return cost
        return cost + self.costs.of_robustness(self.robustness_at(pose, path.grasp))

    def choose(self, poses: Float[np.ndarray, "n 3"], *, last: bool) -> dict[int, ArmPathResult]:
        """Return all waiting poses, best first, as soon as the best is known; nothing before.

        Args:
            poses: All base poses of the round.
            last: Whether no more poses follow.
        """
        by_cost = sorted(self.paths, key=lambda i: self.cost[i])
        if self.costs.robustness_first:
            full = False
            for i in by_cost:
                if full or self.looked >= self.looks:
                    break
                self.looked += poses[i].tobytes() not in self.measured
                full = self.robustness_at(poses[i], self.paths[i].grasp) == 1.0
            if not (full or last or self.looked >= self.looks):
                return {}
            by_cost.sort(key=lambda i: -self.measured.get(poses[i].tobytes(), 0.0))
        elif not last:
            return {}
        paths, self.paths, self.bound = self.paths, {}, math.inf
        return {i: paths[i] for i in by_cost}

    def prefers(self, step: Candidate, to: Candidate) -> bool:
        """Check that a step of lower known cost improves: it costs less, or is as robust."""
        if not self.costs.robustness_first:
            cost, before = (self.full_cost(one.pose, one.path, one.known) for one in (step, to))
            return cost < before
        least = self.measured.get(to.pose.tobytes(), 0.0)
        return not self.looks or self.robustness_at(step.pose, step.path.grasp) >= least

    def known_robustness(self, pose: Float[np.ndarray, "3"]) -> float | None:
        """Return the robustness of a base pose if it was measured."""
        return self.measured.get(pose.tobytes())

    def robustness_at(self, pose: Float[np.ndarray, "3"], grasp: int) -> float:
        """Measure the robustness of a base pose, once."""
        key = pose.tobytes()
        if key not in self.measured:
            self.measured[key] = self.robustness(pose, grasp)
        return self.measured[key]
