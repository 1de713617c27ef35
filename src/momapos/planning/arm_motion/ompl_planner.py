"""Plan free arm motions with OMPL: RRT* for the paper's method, others for comparison."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from .config import Planner

if TYPE_CHECKING:
    from jaxtyping import Float

CheckMotion: TypeAlias = "Callable[[Float[np.ndarray, ' n'], Float[np.ndarray, ' n']], bool]"
"""Returns whether the straight motion between two configurations is free, including its ends."""


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


def ompl_path(
    start: Float[np.ndarray, " n"],
    goal: Float[np.ndarray, " n"],
    low: Float[np.ndarray, " n"],
    high: Float[np.ndarray, " n"],
    free: CheckMotion,
    *,
    planner: Planner,
    checks: int,
    step: float,
    seed: int,
    optimize: bool = False,
) -> Float[np.ndarray, "k n"] | None:
    """Find a path between two free configurations.

    Args:
        start, goal: Configurations.
        low, high: Range of each joint, which includes both.
        free: Checks straight motions.
        planner: OMPL's planner.
        checks: Maximum number of motions checked.
        step: Joint step at which motions are checked [rad] or [m].
        seed: Same seed, same path.
        optimize: Whether a planner that shortens its path spends all checks; it ends with its first
            path otherwise.

    Returns:
        Corner states, including start and goal, or None.
    """
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou

    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    ou.RNG.setSeed(seed + 1)  # OMPL seeds from the clock if the seed is 0
    n, budget = len(start), _Budget(checks)
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
    info.setStateValidityCheckingResolution(step / space.getMaximumExtent())
    ends = [space.allocState(), space.allocState()]
    for state, q in zip(ends, (start, goal), strict=True):
        for k in range(n):
            state[k] = float(q[k])
    setup.setStartAndGoalStates(ends[0], ends[1])
    shortest = ob.PathLengthOptimizationObjective(info)
    if not optimize:
        shortest.setCostThreshold(shortest.infiniteCost())
    setup.setOptimizationObjective(shortest)
    setup.setPlanner(getattr(og, planner)(info))
    solved = setup.solve(ob.PlannerTerminationCondition(lambda: budget.spent()))
    if not solved or "Approximate" in solved.asString():
        return None
    if planner == "RRTConnect":
        budget = _Budget(checks)
        setup.simplifySolution(ob.PlannerTerminationCondition(lambda: budget.spent()))
    path = setup.getSolutionPath()
    return np.array([[path.getState(i)[k] for k in range(n)] for i in range(path.getStateCount())])
