"""How true a map is, against exact inverse kinematics."""

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
    """A map against exact inverse kinematics on random tool poses."""

    count: int
    accuracy: float
    """Share of poses on which both agree [-]."""
    false_positives: float
    """Share of what the map calls reachable that is not [-]."""
    misses: float
    """Share of what is reachable that the map denies [-]."""
    reachable: float
    """Share of the poses that are reachable [-]."""
    bytes: int
    """Size of the map's file."""
    build_seconds: float
    """What building it took."""


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
        ik: What counts as exact; the robot's own IK where None.
        near: Whether the poses are those near reach, not all in the ball around the shoulder.
    """
    Ts = (poses_near_reach if near else random_poses)(robot, rng, count)
    truth, told = reachable(robot, Ts, ik), reach_map.score(Ts) > 0
    both = float((truth & told).sum())
    return ReachEvaluation(
        count,
        float((truth == told).mean()),
        1 - both / max(float(told.sum()), 1.0),
        1 - both / max(float(truth.sum()), 1.0),
        float(truth.mean()),
        len(encode(reach_map)),
        reach_map.build_seconds,
    )
