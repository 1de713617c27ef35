"""Plan free arm motions between two configurations: a straight line if it is free, or a search."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Protocol

import numpy as np

from momapos.model.collision import StraightMotions

from .config import PlannerConfig
from .ompl_planner import ompl_path
from .rounding import round_corners
from .rrt_connect import connect

if TYPE_CHECKING:
    from jaxtyping import Float

RESOLUTION = 0.04
"""Largest joint step at which a motion is checked [rad] or [m]."""
PREFERRED_CLEARANCE = 0.005
"""Preferred clearance of a free motion to everything, including the robot itself: an arm deviates
from its path by millimeters, and between the checked states it may come closer [m]."""
BRIEF_SHARE = 0.25
"""Share of the checks for a path between two grasps or home; most are easy or infeasible [-]."""
QUICK_SHARE = 0.005
"""Share for a path that is searched again, with more checks, if nothing else is found [-]: of 75
ways between two grasps at a door, the six that exist take less, and 69 have none even with 30 times
as many as `BRIEF_SHARE`."""
_MIN_BEYOND = np.pi / 4
"""Least range beyond the ends in which a joint without limits is sampled, where a whole turn that
contains both is no wider [rad]."""


def brief_config(config: PlannerConfig) -> PlannerConfig:
    """Limit the planner for a path between two grasps or home, see `BRIEF_SHARE`."""
    return replace(config, checks=max(1, round(BRIEF_SHARE * config.budget)))


def quick_config(config: PlannerConfig) -> PlannerConfig:
    """Limit the planner for a path that is searched again, see `QUICK_SHARE`."""
    return replace(config, checks=max(1, round(QUICK_SHARE * config.budget)))


@dataclass(frozen=True, eq=False)
class FreePath:
    """A free path between two configurations."""

    corners: Float[np.ndarray, "k n"]
    """States with straight motions between them, including both ends."""
    free: StraightMotions
    """The check that the path passes."""

    def states(self, then: Float[np.ndarray, "m n"] | None = None) -> Float[np.ndarray, "s n"]:
        """Return close states of the path with rounded corners.

        Args:
            then: States that follow the last one, whose corner with the path is rounded as well.
        """
        states = interpolate(self.corners)
        if then is not None:
            states = np.concatenate([states, then])
        return round_corners(states, self.free, RESOLUTION)


class MotionCheckerFactory(Protocol):
    """Builds checks of motions."""

    def __call__(self, *, extra_clearance: float, fine: bool) -> StraightMotions:
        """Return the check for a clearance [m], see `build_motions`."""
        ...


def interpolate(
    path: Float[np.ndarray, "k n"], step: float = RESOLUTION
) -> Float[np.ndarray, "m n"]:
    """Add states to a path so that no joint moves more than `step` between them."""
    pieces = [path[:1]]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.abs(b - a).max() / step - 1e-9)))
        pieces.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(pieces)


def plan_motion(
    start: Float[np.ndarray, " n"],
    goal: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    free: StraightMotions,
    *,
    config: PlannerConfig,
    seed: int,
) -> Float[np.ndarray, "k n"] | None:
    """Find a free path between two configurations.

    Args:
        start, goal: Configurations; joints without limits are not wrapped.
        lower, upper: Joint limits; infinite if there are none.
        free: Checks straight motions, at `RESOLUTION` or finer. Between the checked states a motion
            may graze an obstacle.
        config: The planner and its maximum number of checks.
        seed: Same seed, same path.

    Returns:
        Corner states, including start and goal, or None.
    """
    if not (free(start, start) and free(goal, goal)):
        return None
    if free(start, goal):
        return np.stack([start, goal])
    beyond = np.maximum(np.pi - np.abs(goal - start) / 2, _MIN_BEYOND)
    low = np.where(np.isfinite(lower), lower, np.minimum(start, goal) - beyond)
    high = np.where(np.isfinite(upper), upper, np.maximum(start, goal) + beyond)
    ends = np.clip(start, low, high), np.clip(goal, low, high)
    if config.planner is None:
        path, _ = connect(*ends, low, high, free.arrays, config.budget, seed)
    else:
        path = ompl_path(
            *ends, low, high, free, planner=config.planner, checks=config.budget, step=RESOLUTION,
            seed=seed, optimize=config.optimize,
        )  # fmt: skip
    if path is None or not len(path):
        return None
    return np.concatenate([start[None], path[1:-1], goal[None]])


def plan_with_clearance(
    start: Float[np.ndarray, " n"],
    goal: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    checker: MotionCheckerFactory,
    *,
    config: PlannerConfig,
    seed: int,
) -> FreePath | None:
    """Find a path with `PREFERRED_CLEARANCE`, or else a free one past obstacles, see `plan_motion`.

    Spheres judge the clearance. Where they leave no path, hulls decide what is free.
    """
    for clearance, fine in ((PREFERRED_CLEARANCE, False), (0.0, True)):
        free = checker(extra_clearance=clearance, fine=fine)
        path = plan_motion(start, goal, lower, upper, free, config=config, seed=seed)
        if path is not None:
            return FreePath(path, free)
    return None
