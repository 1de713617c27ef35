"""Free arm motions between two configurations: a straight line where it is free, else OMPL."""

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
ROOM = 0.005
"""What a free motion keeps from everything where it can, from the robot itself as well: an arm is
some millimeters off its way, and between the states that are checked it may come nearer [m]."""
BETWEEN = 3000
"""Most motions checked for a way between holds or home again; most are easy, or none [-]."""
USUAL = "RRTConnect"
"""OMPL's planner where none is named."""
_UNBOUNDED = np.pi
"""Half range in which a joint without limits is sampled, about its start [rad]."""


def brief(config: PlannerConfig) -> PlannerConfig:
    """The same planner for a way between holds or home again, see `BETWEEN`."""
    return replace(config, checks=min(BETWEEN, config.checks))


class CheckerWithRoom(Protocol):
    """Gives the check of motions that keep so far from everything."""

    def __call__(self, *, room: float) -> CheckMotion:
        """The check, for a distance [m]."""
        ...


def interpolate(
    path: Float[np.ndarray, "k n"], step: float = RESOLUTION
) -> Float[np.ndarray, "m n"]:
    """Fill a path so that no joint moves more than `step` between states."""
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
        start, goal: Configurations; a joint without limits is not wrapped.
        lower, upper: Joint limits, infinite where there are none.
        free: Checks straight motions, at `RESOLUTION` or finer.
        config: Which planner, and how much it may check.
        seed: Same seed, same path.

    Returns:
        Corner states, start and goal included, or None.
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


def plan_with_room(
    start: Float[np.ndarray, " n"],
    goal: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    checker: CheckerWithRoom,
    *,
    config: PlannerConfig,
    seed: int,
) -> Float[np.ndarray, "k n"] | None:
    """Find a path that keeps `ROOM`, or else one that is free, see `plan_motion`.

    Args:
        checker: Gives the checks.
    """
    for room in (ROOM, 0.0):
        free = checker(room=room)
        path = plan_motion(start, goal, lower, upper, free, config=config, seed=seed)
        if path is not None:
            return path
    return None


class _Effort:
    """Ends a search after so many checks; a count, since a clock would let the load decide."""

    IDLE = 10
    """A search ends after so many times more turns as well, for a turn may check nothing [-]."""

    def __init__(self, most: int) -> None:
        self.checks, self.turns = most, self.IDLE * most

    def spent(self) -> bool:
        """Whether it ends; OMPL asks once a turn."""
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
    ou.RNG.setSeed(seed + 1)  # OMPL takes 0 for "from the clock"
    n, effort = len(start), _Effort(config.checks)
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
        """Checks the states of a whole edge in one call of the kernel."""

        def checkMotion(self, a: object, b: object, *_: object) -> bool:
            effort.checks -= 1
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
    planner = config.planner or USUAL
    setup.setPlanner(getattr(og, planner)(info))
    solved = setup.solve(ob.PlannerTerminationCondition(lambda: effort.spent()))
    if not solved or "Approximate" in solved.asString():
        return None
    if planner == "RRTConnect":
        effort = _Effort(config.checks)
        setup.simplifySolution(ob.PlannerTerminationCondition(lambda: effort.spent()))
    path = setup.getSolutionPath()
    return np.array([[path.getState(i)[k] for k in range(n)] for i in range(path.getStateCount())])
