"""Calibrate a map's threshold so that it misses few reachable tool poses."""

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
CALIBRATION_POSES = 6000
"""Number of tool poses near the reach that calibrate a map [-]."""
MAX_MISSED, MAX_FALSE_POSITIVES = 0.006, 0.02
"""Largest share of the reachable poses that the map may miss, and largest increase of the poses
that it accepts by unreachable ones [-]. About 4000 of the poses are reachable, so the standard
error of 0.6 % is 0.12 %: three of these remain to 1 %."""
THRESHOLD_MARGIN = 0.01
"""The threshold is set this far below the value of the last line that it accepts [1/8 cell]."""


def calibrated(reach_map: ReachMap, robot: Robot) -> ReachMap:
    """Lower a map's threshold until it misses at most `MAX_MISSED` of the reachable poses.

    Poses near the reach that the map rejects are checked by IK, with redundant joints locked at 33
    values. The threshold is lowered past the reachable ones, by at most a cell and as far as
    `MAX_FALSE_POSITIVES` allows. A map that misses few poses already is returned unchanged.
    """
    Ts = poses_near_reach(robot, np.random.default_rng(1), CALIBRATION_POSES)
    values = _values(reach_map, Ts)
    rejected = np.flatnonzero(values <= reach_map.threshold)
    rejected = rejected[np.argsort(-values[rejected], kind="stable")]
    true = reachable(robot, Ts[rejected], robot.finer.ik)
    accepted = CALIBRATION_POSES - len(rejected)
    missed = int(true.sum()) - np.cumsum(true)
    near = values[rejected] > max(reach_map.threshold - STEPS, OUTSIDE)
    allowed = near & (np.cumsum(~true) <= MAX_FALSE_POSITIVES * accepted)
    if true.sum() <= MAX_MISSED * (accepted + true.sum()) or not allowed.any():
        return reach_map
    enough = np.flatnonzero(allowed & (missed <= MAX_MISSED * (accepted + true.sum())))
    last = enough[0] if len(enough) else np.flatnonzero(allowed)[-1]
    if not len(enough):
        share = missed[last] / (accepted + true.sum())
        log.warning("the reachability map of %s misses %.1f %%", robot.title, 100 * share)
    return replace(reach_map, threshold=float(values[rejected[last]] - THRESHOLD_MARGIN))


def _values(reach_map: ReachMap, Ts: Float[np.ndarray, "m 4 4"]) -> Float[np.ndarray, " m"]:
    """Look up the stored values of tool poses, up to four cells inside [1/8 cell]."""
    lowest = OUTSIDE - 1.0
    return replace(reach_map, threshold=lowest).score(Ts) * DEPTH + lowest
