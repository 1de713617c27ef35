"""How much a base pose may be off: the same look for an arm path, at poses around it.

A drive ends beside its goal, and the arm is planned anew from there. A pose at the edge of what the
arm reaches is feasible, and of no use; one that a door passes by a centimeter is hit by doors whose
hinges are not quite where they are modeled.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core.geometry import compose

from .area import BaseStatus, base_pose_status, clear_of_sweep
from .config import PlaceConfig
from .grasp_scores import ScoreWays
from .problem import Problem

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

Margin: TypeAlias = "Callable[[Float[np.ndarray, '3'], int], float]"
"""Share of the poses around a base pose from which there is an arm path, in [0, 1]; those that the
part passes closely by count half. The way of holding that works there is tried first."""
_AROUND = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
"""Half the corners of a box, so that each coordinate is off both ways: a tetrahedron, in the base's
frame, so that answers move with their room [-]."""
_CLOSE = 0.5
"""What a pose counts that the part passes closely by [-]."""
_FIRST = 2.0
"""More than any score [-]."""
_GRASPS = 2
"""Grasps that are tried at a pose beside another: that one's, then the best reached [-]."""


def _beside(poses: Float[np.ndarray, "n 3"], config: PlaceConfig) -> Float[np.ndarray, "m 3"]:
    """The poses around some, those around each one after the other."""
    # The corners of the box are as far away as the disc's edge.
    way = max(config.margin, config.robust_radius / np.sqrt(2.0))
    off = np.array([way, way, np.radians(max(config.margin_turn, config.robust_turn))])
    return compose(np.repeat(poses, len(_AROUND), axis=0), np.tile(_AROUND * off, (len(poses), 1)))


def may_have_room(
    problem: Problem,
    score: ScoreWays,
    config: PlaceConfig,
    poses: Float[np.ndarray, "n 3"],
    least: float,
) -> Bool[np.ndarray, " n"]:
    """Whether base poses may have a margin as large: the map and the base's room say so."""
    around = _beside(poses, config)
    status, _ = base_pose_status(problem.geometry, around)
    clear = status == BaseStatus.CLEAR
    clear[clear] = score(problem.reach, around[clear]).scores.max(1, initial=0.0) > 0
    roomy = clear_of_sweep(problem.geometry, around, config.sweep_room)
    most = clear * np.where(roomy, 1.0, _CLOSE)
    return most.reshape(len(poses), len(_AROUND)).mean(1) >= least


def margin_of(problem: Problem, score: ScoreWays, config: PlaceConfig) -> Margin:
    """The margin of base poses, for one of the ways of holding."""

    def margin(pose: Float[np.ndarray, "3"], grasp: int) -> float:
        poses = _beside(pose[None], config)
        status, _ = base_pose_status(problem.geometry, poses)
        # Where the base cannot stand no drive ends.
        poses = poses[status == BaseStatus.CLEAR]
        if not len(poses):
            return 0.0
        scores = score(problem.reach, poses).scores
        scores[:, grasp] = np.where(scores[:, grasp] > 0, _FIRST, 0.0)
        screened = problem.screen(poses, scores, min(config.grasps, _GRASPS))
        if screened is None:
            return 0.0
        works = np.array([one.q is not None for one in screened])
        roomy = clear_of_sweep(problem.geometry, poses, config.sweep_room)
        return float((works * np.where(roomy, 1.0, _CLOSE)).mean())

    return margin
