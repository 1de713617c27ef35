"""Measure the accuracy of a map against exact inverse kinematics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from momapos.model.kinematics import IkModel
from momapos.model.robots import Robot

from .exact_reach import poses_near_reach, random_poses, reachable
from .map_store import encode
from .reach_map import ReachMap


@dataclass(frozen=True)
class ReachEvaluation:
    """Agreement of a map with exact inverse kinematics on random tool poses."""

    count: int
    accuracy: float
    """Share of poses on which both agree [-]."""
    false_positives: float
    """Share of the poses that the map accepts that are unreachable [-]."""
    misses: float
    """Share of the reachable poses that the map rejects [-]."""
    reachable: float
    """Share of the poses that are reachable [-]."""
    bytes: int
    """Size of the map's file."""
    build_seconds: float


def evaluate(
    reach_map: ReachMap,
    robot: Robot,
    rng: np.random.Generator,
    count: int = 20_000,
    ik: IkModel | None = None,
    *,
    near: bool = False,
) -> ReachEvaluation:
    """Compare a map with exact inverse kinematics, self-collision and floor included.

    Args:
        reach_map: The map of the robot.
        robot: The robot.
        rng: Draws the poses.
        count: Number of poses [-].
        ik: The reference IK; None for the robot's own.
        near: Draw poses near the reach instead of from the whole ball around the shoulder.
    """
    Ts = (poses_near_reach if near else random_poses)(robot, rng, count)
    truth, accepted = reachable(robot, Ts, ik), reach_map.score(Ts) > 0
    both = float((truth & accepted).sum())
    accuracy = float((truth == accepted).mean())
    false_positives = 1 - both / max(float(accepted.sum()), 1.0)
    misses, size = 1 - both / max(float(truth.sum()), 1.0), len(encode(reach_map))
    return ReachEvaluation(
        count, accuracy, false_positives, misses, float(truth.mean()), size, reach_map.build_seconds
    )
