"""Compute the cost of base poses: driving, robustness, clearance, reach and the arm's motion.

A drive ends a few centimeters from its goal, and the arm motion is replanned from there. Modeled
hinges have errors, too: a door that passes the base by a centimeter may hit it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from momapos.core.geometry import compose
from momapos.model.collision import FREE, base_hits
from momapos.model.kinematics import least_dexterity, travel_of_arm
from momapos.model.records import ArmPathResult, CostTerm

from .area import BaseStatus, PlacementGeometry, base_pose_status, clears_sweep
from .config import PlaceConfig
from .grasp_scores import GraspModeScorer
from .problem import PoseCost, Problem

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


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


class Robustness(Protocol):
    """Measures the robustness of base poses with an arm path."""

    def __call__(
        self, pose: Float[np.ndarray, "3"], path: ArmPathResult, least: float = 0.0, /
    ) -> float:
        """Return the share of neighbors that work, in [0, 1].

        Below `least`, an upper bound is enough: it is returned as soon as it is known.
        """
        ...


_CORNERS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
"""Offsets of the neighbors: a tetrahedron in the base frame, so that each coordinate varies to both
sides and results move with the scene [-]."""
_CLOSE_PASS_SHARE = 0.5
"""Value of a neighbor that the moving part passes closely [-]."""
_FIRST = 2.0
"""Above any score [-]."""
_GRASPS = 2
"""Grasps tried at a neighbor: that of the base pose, then the best reached [-]."""


def _neighbors(poses: Float[np.ndarray, "n 3"], config: PlaceConfig) -> Float[np.ndarray, "m 3"]:
    """Return the neighbors of base poses, grouped by pose."""
    # The corners of the box are as far away as the edge of the required disc.
    offset = max(config.margin, config.robust_radius / np.sqrt(2.0))
    turn = np.radians(max(config.margin_turn, config.robust_turn))
    off = _CORNERS * np.array([offset, offset, turn])
    return compose(np.repeat(poses, len(off), axis=0), np.tile(off, (len(poses), 1)))


def can_be_robust(
    problem: Problem,
    score: GraspModeScorer,
    config: PlaceConfig,
    poses: Float[np.ndarray, "n 3"],
    least: float,
) -> Bool[np.ndarray, " n"]:
    """Check, by the reachability map and the base alone, that a robustness is possible."""
    neighbors = _neighbors(poses, config)
    status, _ = base_pose_status(problem.geometry, neighbors)
    clear = status == BaseStatus.CLEAR
    clear[clear] = score(problem.reach, neighbors[clear]).scores.max(1, initial=0.0) > 0
    roomy = clears_sweep(problem.geometry, neighbors, config.sweep_clearance)
    most = clear * np.where(roomy, 1.0, _CLOSE_PASS_SHARE)
    return most.reshape(len(poses), len(_CORNERS)).mean(1) >= least


def robustness_of(problem: Problem, score: GraspModeScorer, config: PlaceConfig) -> Robustness:
    """Return a function that measures the robustness of base poses.

    First the arm path is adapted to the neighbors. Where that fails a path is searched, with the
    same grasp mode first.
    """

    def robustness(
        pose: Float[np.ndarray, "3"], path: ArmPathResult, least: float = 0.0, /
    ) -> float:
        poses = _neighbors(pose[None], config)
        status, _ = base_pose_status(problem.geometry, poses)
        # No drive ends where the base cannot stand.
        poses = poses[status == BaseStatus.CLEAR]
        if not len(poses):
            return 0.0
        roomy = clears_sweep(problem.geometry, poses, config.sweep_clearance)
        most = np.where(roomy, 1.0, _CLOSE_PASS_SHARE)
        if most.mean() < least:
            return float(most.mean())
        works = np.zeros(len(poses), bool)
        if problem.near is not None:
            works = problem.near(pose, path, poses)
        left = np.flatnonzero(~works)
        scores = score(problem.reach, poses[left]).scores
        scores[:, path.grasp] = np.where(scores[:, path.grasp] > 0, _FIRST, 0.0)
        for k, scored in zip(left.tolist(), scores, strict=True):
            (found,) = problem.screen(poses[k : k + 1], scored[None], min(config.grasps, _GRASPS))
            most[k] *= found.q is not None
            if most.mean() < least:
                break
        return float(most.mean())

    return robustness
