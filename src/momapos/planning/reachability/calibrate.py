"""Move the value from which on lines count as reachable until a map misses few of them."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.robots import Robot

from .exact_reach import poses_near_reach, reachable
from .grid import DEPTH, OUTSIDE, STEPS
from .reach_map import ReachMap

if TYPE_CHECKING:
    from jaxtyping import Float

log = logging.getLogger(__name__)
POSES = 6000
"""Tool poses near reach that a map is held against [-]."""
MISSED, INVENTED = 0.006, 0.02
"""Share of what is reachable that may be missed, and what may be taken for reachable on top, of
that which already is [-]. Some 4000 of the poses are reachable, which tell 0.6 % to 0.12 points: up
to 1 % three of these are left."""
BELOW = 0.01
"""So far below the value of a line the threshold is put that lets the line in [1/8 cell]."""


def calibrated(reach_map: ReachMap, robot: Robot) -> ReachMap:
    """The map with a threshold at which it misses at most `MISSED`, where that costs little.

    Poses near reach that the map denies are asked of inverse kinematics with redundant joints
    locked at 33 values. The threshold is lowered past those that can be reached, by a cell at
    most, and no farther than `INVENTED` allows. Of a map that misses less it stays.

    Args:
        reach_map: The map of the robot.
        robot: The robot.
    """
    Ts = poses_near_reach(robot, np.random.default_rng(1), POSES)
    values = _values(reach_map, Ts)
    denied = np.flatnonzero(values <= reach_map.threshold)
    denied = denied[np.argsort(-values[denied], kind="stable")]
    true = reachable(robot, Ts[denied], robot.finer.ik)
    told = POSES - len(denied)
    missed = int(true.sum()) - np.cumsum(true)
    near = values[denied] > max(reach_map.threshold - STEPS, OUTSIDE)
    allowed = near & (np.cumsum(~true) <= INVENTED * told)
    if true.sum() <= MISSED * (told + true.sum()) or not allowed.any():
        return reach_map
    enough = np.flatnonzero(allowed & (missed <= MISSED * (told + true.sum())))
    last = enough[0] if len(enough) else np.flatnonzero(allowed)[-1]
    if not len(enough):
        share = missed[last] / (told + true.sum())
        log.warning("the reachability map of %s misses %.1f %%", robot.title, 100 * share)
    return replace(reach_map, threshold=float(values[denied[last]] - BELOW))


def _values(reach_map: ReachMap, Ts: Float[np.ndarray, "m 4 4"]) -> Float[np.ndarray, " m"]:
    """Stored values of tool poses, up to four cells inside the reachable set [1/8 cell]."""
    lowest = OUTSIDE - 1.0
    return replace(reach_map, threshold=lowest).score(Ts) * DEPTH + lowest
