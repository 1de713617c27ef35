"""Study from where a robot reaches a set of tool poses, and how well from one base pose.

The map of base positions counts the poses that each serves, at its best yaw. Where a base pose is
not given, the one that serves the most is studied, of equal ones the nearest to their middle. The
drive and the arm's motion are not planned: `plan_pose_stops` does that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import finite_array
from momapos.model.kinematics import dexterities

from .opening_maps import FloorMap, cell_poses
from .query import PlacementQuery
from .reach_poses import PoseSearch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jaxtyping import Bool, Float, Int

CELL = 0.1
"""Edge of a cell [m]."""
MAX_CHECKS = 400_000
"""Pairs of base pose and tool pose that a map checks [-]; with more poses its cells grow."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseMap(FloorMap):
    """How many tool poses each cell of the floor serves, at its best yaw."""

    served: Float[np.ndarray, "rows columns"]
    """Number of poses; NaN where the base cannot stand [-]."""
    poses: int
    """Number of poses [-]."""

    @property
    def best(self) -> tuple[float, float, float] | None:
        """Return the base pose that serves the most, the middle one of equals; None without any."""
        most = np.nanmax(self.served, initial=0.0)
        if most <= 0.0:
            return None
        cells = np.argwhere(self.served == most)
        row, column = cells[int(np.abs(cells - cells.mean(0)).sum(1).argmin())]
        x, y = self.low + self.cell * (np.array([column, row]) + 0.5)
        return (float(x), float(y), float(self.yaw[row, column]))


@dataclass(frozen=True, eq=False)
class ReachStudy:
    """How well a robot reaches tool poses from one base pose."""

    base_pose: tuple[float, float, float] | None
    """x [m], y [m], yaw [rad]; None if no base pose serves any pose."""
    dexterity: Float[np.ndarray, " p"]
    """Largest dexterity of the free arm states at each pose, see `dexterities`; 0 for a pose that
    is not reached, or only in a singular state [-]."""
    reached: Bool[np.ndarray, " p"]
    """Which poses are reached."""
    why: str = ""
    """Why the base cannot stand there, or its arm not be at home; "" if both can."""


def map_poses(query: PlacementQuery, *, cell: float = CELL) -> PoseMap:
    """Count the tool poses that each cell of the floor serves.

    The reachability map chooses a cell's yaw; at it, inverse kinematics and collisions decide.

    Args:
        query: The question; its task has the poses.
        cell: Edge of a cell [m]; larger where that would be more than `MAX_CHECKS` pairs.

    Raises:
        InputError: The region limits the angle to the grasp.
        OutOfTimeError: The time was over.
    """
    with query.in_time():
        search = PoseSearch.of(query, in_order=False)
        low, high = search.rectangle(search.usable)
        area = float(np.prod(np.maximum(high - low, 0.0)))
        cell = max(cell, float(np.sqrt(area * len(search.usable) / MAX_CHECKS)))
        columns, rows = np.maximum(np.ceil((high - low) / cell), 0).astype(int).tolist()
        served, yaw = np.full((rows, columns), np.nan), np.full((rows, columns), np.nan)
        bases = cell_poses(low, cell, (rows, columns)).reshape(-1, 3)
        found = search.rows_of(bases, every=True)
        at = ((found.bases[:, :2] - low) / cell).astype(int)
        where = at[:, 1] * columns + at[:, 0]
        chosen = _best_of_each(where, found.serves.sum(1))
        search.check(found, chosen[found.serves[chosen].any(1)])
        served.flat[where[chosen]] = found.serves[chosen].sum(1)
        yaw.flat[where[chosen]] = found.bases[chosen, 2]
        return PoseMap(yaw=yaw, low=low, cell=cell, served=served, poses=len(search.tools))


def study_reach(query: PlacementQuery, base_pose: Sequence[float] | None = None) -> ReachStudy:
    """Return how well a robot reaches the poses of a task from a base pose, or from the best.

    Args:
        query: The question; its task has the poses.
        base_pose: x [m], y [m], yaw [rad]; None for the one that serves the most poses, of a map.

    Raises:
        InputError: The base pose is not three finite numbers, or the region limits the angle to
            the grasp.
        OutOfTimeError: The time was over.
    """
    search = PoseSearch.of(query, in_order=False)
    base = map_poses(query).best if base_pose is None else tuple(base_pose)
    found, reached = np.zeros(len(search.tools)), np.zeros(len(search.tools), bool)
    if base is None:
        return ReachStudy(None, found, reached)
    at = finite_array("base_pose", base, (3,))
    pose = (float(at[0]), float(at[1]), float(at[2]))
    with query.in_time():
        rows = search.rows_of(at[None], by_map=False)
        if len(rows.bases):
            search.check(rows, np.zeros(1, int))
        if not len(rows.bases) or search.arm is None or not rows.serves.any():
            return ReachStudy(pose, found, reached, _most(search))
        served, robot = np.flatnonzero(rows.serves[0]), query.robot
        states = search.arm.states(at, served)
        each = dexterities(robot.chain, np.concatenate(states), robot.reach)
        owner = np.repeat(served, [len(one) for one in states])
        np.maximum.at(found, owner, each)
        reached[owner] = True
        return ReachStudy(pose, found, reached)


def _most(search: PoseSearch) -> str:
    """Return the outcome of most base poses of a search, in words."""
    outcome, count = max(search.counts.items(), key=lambda one: one[1])
    return str(outcome) if count else ""


def _best_of_each(
    where: Int[np.ndarray, " n"], count: Int[np.ndarray, " n"]
) -> Int[np.ndarray, " c"]:
    """Return the base pose with the largest count of each cell, the first of equals."""
    order = np.lexsort((np.arange(len(where)), -count, where))
    _, first = np.unique(where[order], return_index=True)
    return np.asarray(order[first])
