"""Compute the cost of base poses: driving, robustness, clearance and the arm's motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.collision import FREE, base_hits
from momapos.model.kinematics import least_dexterity, travel_of_arm
from momapos.model.records import CostTerm

from .area import PlacementGeometry
from .config import PlaceConfig
from .problem import PoseCost, Problem

if TYPE_CHECKING:
    from jaxtyping import Float

_LEVELS = np.arange(1, 11) * 0.02
"""Clearances that are tested; more than the last one costs nothing [m]."""
_WEIGHTS = {"room": "robustness"}
"""Names of weights that differ from those of their terms in plan files."""


@dataclass(frozen=True)
class PoseCosts:
    """Costs of base poses for one task: weighted sums of terms."""

    geometry: PlacementGeometry
    config: PlaceConfig
    grasp_step: int
    """Index of the arm path's state in which the hand grasps [-]."""
    own: PoseCost | None = None
    """A further cost of base poses, known before the arm has a path [m]."""

    @classmethod
    def of(cls, problem: Problem, config: PlaceConfig) -> PoseCosts:
        """Return the costs of a search."""
        return cls(problem.geometry, config, problem.grasp_step, problem.own_cost)

    @property
    def robustness_first(self) -> bool:
        """Whether robustness is compared before all terms of finite weight."""
        return math.isinf(self.config.weight_robustness)

    def before_path(
        self, poses: Float[np.ndarray, "n 3"], travel: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Return the known part of the cost before the arm has a path, from driving lengths [m]."""
        cost = self.config.weight_driving * travel
        if self.config.weight_clearance:
            cost = cost + self.config.weight_clearance * missing_clearance(self.geometry, poses)
        return cost if self.own is None else cost + self.own(poses)

    def of_path(self, q: Float[np.ndarray, "m n"]) -> float:
        """Return the cost of an arm path (its states) from the grasp on."""
        robot, config = self.geometry.robot, self.config
        cost, q = 0.0, q[self.grasp_step :]
        if config.weight_manipulability:
            worst = least_dexterity(robot.chain, q, robot.reach)
            cost += config.weight_manipulability * (1.0 - worst)
        if config.weight_effort:
            cost += config.weight_effort * travel_of_arm(robot.chain, q, robot.reach)
        return cost

    def of_robustness(self, robustness: float) -> float:
        """Return the cost of missing robustness; 0 where robustness is compared first."""
        return 0.0 if self.robustness_first else self.config.weight_robustness * (1.0 - robustness)


def cost_terms(
    geometry: PlacementGeometry,
    config: PlaceConfig,
    base: Float[np.ndarray, "3"],
    q: Float[np.ndarray, "m n"],
    *,
    travel: float,
    robustness: float | None,
    own: float | None = None,
) -> Mapping[str, CostTerm]:
    """Return the terms of a plan's cost by name, including those of weight 0.

    Args:
        geometry: Scene and task.
        config: The weights.
        base: x [m], y [m], yaw [rad].
        q: Arm states in which the hand holds the object.
        travel: Driving length [m].
        robustness: Share of neighbors that work; None if it was not measured.
        own: The cost by the user's own function [m]; None without one.
    """
    robot = geometry.robot
    values = {
        "driving": travel,
        "room": None if robustness is None else 1.0 - robustness,
        "clearance": float(missing_clearance(geometry, base[None])[0]),
        "manipulability": 1.0 - least_dexterity(robot.chain, q, robot.reach),
        "effort": travel_of_arm(robot.chain, q, robot.reach),
    }
    weights = {name: getattr(config, f"weight_{_WEIGHTS.get(name, name)}") for name in values}
    terms = {
        name: CostTerm(value, None if math.isinf(weights[name]) else weights[name])
        for name, value in values.items()
    }
    return terms if own is None else {**terms, "own": CostTerm(own, 1.0)}


def missing_clearance(
    geometry: PlacementGeometry, poses: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Return how far each base pose's clearance falls short of 20 cm, in steps of 2 cm [m]."""
    robot, boxes = geometry.robot, geometry.boxes
    clearance, left = np.zeros(len(poses)), np.arange(len(poses))
    for level in _LEVELS:
        left = left[base_hits(poses[left], robot.base, boxes, clearance=level) == FREE]
        clearance[left] = level
    return _LEVELS[-1] - clearance
