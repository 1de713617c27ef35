"""Plan free arm motions between two configurations: a straight line if it is free, else OMPL."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Protocol

import numpy as np

from momapos.model.collision import CheckMotion

from .config import PlannerConfig

if TYPE_CHECKING:
    from jaxtyping import Float

RESOLUTION = 0.04
"""Largest joint step at which a motion is checked [rad] or [m]."""
PREFERRED_CLEARANCE = 0.005
"""Preferred clearance of a free motion to everything, including the robot itself: an arm deviates
from its path by millimeters, and between the checked states it may come closer [m]."""
BRIEF_CHECKS = 3000
"""Maximum number of checks for a path between two grasps or home; most are easy or infeasible."""
DEFAULT_PLANNER = "RRTConnect"
_UNBOUNDED = np.pi
"""Half range, around the start, in which a joint without limits is sampled [rad]."""


def brief_config(config: PlannerConfig) -> PlannerConfig:
    """Limit the planner for a path between two grasps or home, see `BRIEF_CHECKS`."""
    return replace(config, checks=min(BRIEF_CHECKS, config.checks))


class MotionCheckerFactory(Protocol):
    """Builds checks of motions."""

    def __call__(self, *, extra_clearance: float) -> CheckMotion:
        """Return the check for a clearance [m]."""
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
    free: CheckMotion,
    *,
    config: PlannerConfig,
    seed: int,
) -> Float[np.ndarray, "k n"] | None:
    """Find a free path between two configurations.

    Args:
        start, goal: Configurations; joints without limits are not wrapped.
        lower, upper: Joint limits; infinite if there are none.
        free: Checks straight motions, at `RESOLUTION` or finer.
        config: The planner and its maximum number of checks.
        seed: Same seed, same path.

    Returns:
        Corner states, including start and goal, or None.
    """
    if not (free(start, start) and free(goal, goal)):
        return None
    if free(start, goal):
        return np.stack([start, goal])
    low = np.where(np.isfinite(lower), lower, np.minimum(start, goal) - _UNBOUNDED)
    high = np.where(np.isfinite(upper), upper, np.maximum(start, goal) + _UNBOUNDED)
    path = _ompl(np.clip(start, low, high), np.clip(goal, low, high), low, high, free, config, seed)
    if path is None:
        return None
    path = np.concatenate([start[None], path[1:-1], goal[None]])
    return path if all(free(a, b) for a, b in pairwise(path)) else None


def plan_with_clearance(
    start: Float[np.ndarray, " n"],
    goal: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    checker: MotionCheckerFactory,
    *,
    config: PlannerConfig,
    seed: int,
) -> Float[np.ndarray, "k n"] | None:
    """Find a path with `PREFERRED_CLEARANCE`, or else one that is free, see `plan_motion`."""
    for clearance in (PREFERRED_CLEARANCE, 0.0):
        free = checker(extra_clearance=clearance)
        path = plan_motion(start, goal, lower, upper, free, config=config, seed=seed)
        if path is not None:
            return path
    return None


class _Budget:
    """Ends a search after a number of checks; a time limit would make results irreproducible."""

    TURNS_PER_CHECK = 10
    """A search also ends after this many turns per check, since a turn may check nothing [-]."""

    def __init__(self, checks: int) -> None:
        self.checks, self.turns = checks, self.TURNS_PER_CHECK * checks

    def spent(self) -> bool:
        """Count one turn of OMPL, and check whether the search ends."""
        self.turns -= 1
        return min(self.checks, self.turns) < 0


def _ompl(
    start: np.ndarray,
    goal: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    free: CheckMotion,
    config: PlannerConfig,
    seed: int,
) -> Float[np.ndarray, "k n"] | None:
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou

    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    ou.RNG.setSeed(seed + 1)  # OMPL seeds from the clock if the seed is 0
    n, budget = len(start), _Budget(config.checks)
    space = ob.RealVectorStateSpace(n)
    bounds = ob.RealVectorBounds(n)
    for k in range(n):
        bounds.setLow(k, float(low[k]))
        bounds.setHigh(k, float(high[k]) + 1e-9)
    space.setBounds(bounds)
    setup = og.SimpleSetup(space)

    def read(state: object) -> Float[np.ndarray, " n"]:
        return np.array([state[k] for k in range(n)])  # type: ignore[index]

    class Edges(ob.MotionValidator):  # type: ignore[misc]
        """Checks all states of an edge in one call of the kernel."""

        def checkMotion(self, a: object, b: object, *_: object) -> bool:
            budget.checks -= 1
            return free(read(a), read(b))

    def valid(state: object) -> bool:
        q = read(state)
        return free(q, q)

    setup.setStateValidityChecker(valid)
    info = setup.getSpaceInformation()
    edges = Edges(info)
    info.setMotionValidator(edges)
    info.setStateValidityCheckingResolution(RESOLUTION / space.getMaximumExtent())
    ends = [space.allocState(), space.allocState()]
    for state, q in zip(ends, (start, goal), strict=True):
        for k in range(n):
            state[k] = float(q[k])
    setup.setStartAndGoalStates(ends[0], ends[1])
    planner = config.planner or DEFAULT_PLANNER
    setup.setPlanner(getattr(og, planner)(info))
    solved = setup.solve(ob.PlannerTerminationCondition(lambda: budget.spent()))
    if not solved or "Approximate" in solved.asString():
        return None
    if planner == "RRTConnect":
        budget = _Budget(config.checks)
        setup.simplifySolution(ob.PlannerTerminationCondition(lambda: budget.spent()))
    path = setup.getSolutionPath()
    return np.array([[path.getState(i)[k] for k in range(n)] for i in range(path.getStateCount())])
