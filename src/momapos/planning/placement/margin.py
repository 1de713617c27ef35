"""Measure the robustness of base poses: the share of their neighbors with an arm path.

A drive ends a few centimeters from its goal, and the arm motion is replanned from there. Modeled
hinges have errors, too: a door that passes the base by a centimeter may hit it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core.geometry import compose

from .area import BaseStatus, base_pose_status, clears_sweep
from .config import PlaceConfig
from .grasp_scores import GraspModeScorer
from .problem import Problem

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

Robustness: TypeAlias = "Callable[[Float[np.ndarray, '3'], int], float]"
"""Return the robustness of a base pose, in [0, 1], given its grasp mode, which is tried first."""
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
    """Return a function that measures the robustness of base poses."""

    def robustness(pose: Float[np.ndarray, "3"], grasp: int) -> float:
        poses = _neighbors(pose[None], config)
        status, _ = base_pose_status(problem.geometry, poses)
        # No drive ends where the base cannot stand.
        poses = poses[status == BaseStatus.CLEAR]
        if not len(poses):
            return 0.0
        scores = score(problem.reach, poses).scores
        scores[:, grasp] = np.where(scores[:, grasp] > 0, _FIRST, 0.0)
        screened = problem.screen(poses, scores, min(config.grasps, _GRASPS))
        if screened is None:
            return 0.0
        works = np.array([one.q is not None for one in screened])
        roomy = clears_sweep(problem.geometry, poses, config.sweep_clearance)
        return float((works * np.where(roomy, 1.0, _CLOSE_PASS_SHARE)).mean())

    return robustness
