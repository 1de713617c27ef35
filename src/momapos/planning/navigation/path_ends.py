"""Connect the start and the goal of a path to states of the lattice.

A start or goal need not be a state of the lattice. Simple paths connect it to nearby states. If
obstacles are too close for that, they lead through its exits (`lattice_connection`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache, refuse_below
from momapos.core.geometry import wrap_angle

from .car_connection import shortest_lengths
from .cost_map import CELL
from .footprint_map import HEADINGS, MAX_GAP, NavigationMap
from .lattice import PathModel, connections
from .lattice_connection import Exits, Maneuvers, shuffled_exits, straight_exits
from .lattice_moves import REVERSING_COST, planned_radius
from .outline_gaps import CostWeights, OutlineArrays, gaps

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MIN_GAP = 0.01
"""Smallest gap along a path, except at its ends [m]."""
_RADII = 0.15, 0.3
"""Radius of the lattice states connected to an exit, and to the start or goal itself [m]."""
_CAR_RADII = 0.3, 0.6
"""The same for a car-like base, which has to drive farther for a small offset [m]."""
_MAX_CURVE = 0.9
"""Largest length of the path between an exit and a lattice state [m]. Only longer curves of a
car-like base exceed it; they take half of the time and lead to no better paths."""
_MAX_FAILURES = 8
"""Number of searches without a path that a start remembers, of about 1 MB each [-]."""
CONTACT_COST = 1.0
"""Additional cost of a meter in contact with obstacles [-]."""
TURNING_COST = 0.1
"""Cost of turning [m/rad]."""
CUSP_COST = 0.2
"""Cost of a reversal of a car-like base [m]: about the way that it drives while it stops."""


@dataclass(frozen=True)
class PathConfig:
    """Weights of the cost of a path."""

    preferred_clearance: float = 0.08
    """Gap above which proximity to obstacles costs nothing [m]."""

    def __post_init__(self) -> None:
        refuse_below(self, 0, "preferred_clearance")


DEFAULT_CONFIG = PathConfig()


def path_model(
    nav_map: NavigationMap, config: PathConfig, needed_clearance: float = MIN_GAP
) -> PathModel:
    """Collect the data of a path search for the kernels."""
    weights = CostWeights(
        float(needed_clearance), config.preferred_clearance, CONTACT_COST, TURNING_COST,
        REVERSING_COST, CUSP_COST,
    )  # fmt: skip
    surroundings = OutlineArrays(nav_map.prisms.arrays, nav_map.planning_obstacles.arrays)
    robot = nav_map.robot
    return PathModel(robot.drive == "omni", planned_radius(robot), surroundings, weights)


def lattice_shape(nav_map: NavigationMap) -> tuple[int, int, int]:
    """Return the number of headings, rows and columns of the lattice."""
    return len(HEADINGS), *nav_map.shape


def lattice_poses(nav_map: NavigationMap, index: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k 3"]:
    """Return the poses of lattice states, given as flat indices."""
    h, i, j = np.unravel_index(index, lattice_shape(nav_map))
    xy = nav_map.origin + (np.stack([j, i], -1) + 0.5) * CELL
    return np.column_stack([xy, HEADINGS[h]])


@dataclass(frozen=True, eq=False)
class LatticeEntries:
    """States of the lattice that are connected to a start or goal."""

    exits: Exits
    states: Int[np.ndarray, " n"]
    """Flat indices."""
    cost: Float[np.ndarray, " n"]
    """Cost of the cheapest path between the start or goal and each state [m]."""
    via: Int[np.ndarray, " n"]
    """Index of the exit on that path."""
    failures: list[tuple[Bool[np.ndarray, " c"], Bool[np.ndarray, " s"]]] = field(
        default_factory=list
    )
    """The cells that a search from here without a path considered, and the states it reached."""

    def remember(
        self, cells: Bool[np.ndarray, "rows columns"], reached: Bool[np.ndarray, " s"]
    ) -> None:
        """Remember a search from here without a path.

        Args:
            cells: The cells that are connected to its goal, whatever the heading.
            reached: The states that it reached.
        """
        if len(self.failures) < _MAX_FAILURES:
            self.failures.append((cells.ravel(), reached))

    def never_reach(self, states: Int[np.ndarray, " n"]) -> bool:
        """Check whether an earlier search shows that none of some states can be reached."""
        return any(
            cells[states % len(cells)].all() and not reached[states].any()
            for cells, reached in self.failures
        )

    def path(self, state: int) -> Float[np.ndarray, "k 3"]:
        """Return the exits on the path from the start or goal to a state."""
        return self.exits.path(int(self.via[np.flatnonzero(self.states == state)[0]]))


@dataclass(frozen=True, eq=False)
class PathEnd:
    """The start or the goal of a path."""

    nav_map: NavigationMap
    config: PathConfig
    pose: Float[np.ndarray, "3"]
    is_goal: bool
    needed: float
    """Smallest gap at the pose itself [m]."""

    @cached_property
    def straight(self) -> LatticeEntries:
        """Entries through straight exits."""
        return self._entries(straight_exits(self.pose, self._maneuvers, self._connection_cost))

    @cached_property
    def shuffled(self) -> LatticeEntries:
        """Entries through shuffled exits, which are slow to compute."""
        cost = self._connection_cost
        exits = shuffled_exits(self.pose, self._maneuvers, cost, self._gaps, MIN_GAP)
        return self._entries(exits)

    @property
    def _maneuvers(self) -> Maneuvers:
        robot = self.nav_map.robot
        return Maneuvers(4 if robot.drive == "omni" else 2, planned_radius(robot))

    def _gaps(self, poses: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        return gaps(poses, self.nav_map.prisms, self.nav_map.planning_obstacles, cap=MAX_GAP)

    def _connection_cost(
        self, inner: Float[np.ndarray, "n 3"], outer: Float[np.ndarray, "n 3"], tight: bool
    ) -> Float[np.ndarray, " n"]:
        """Compute the cost of the simple path from inner to outer poses, reversed at a goal [m]."""
        model = path_model(self.nav_map, self.config, self.needed if tight else MIN_GAP)
        inner, outer = np.ascontiguousarray(inner), np.ascontiguousarray(outer)
        return connections(*((outer, inner) if self.is_goal else (inner, outer)), model)[0]

    def _entries(self, exits: Exits) -> LatticeEntries:
        """Connect each lattice state near the exits to the cheapest of them."""
        radii = _CAR_RADII if self._maneuvers.turning_radius > 0 else _RADII
        found = [self._near(pose, radii[k == 0]) for k, pose in enumerate(exits.poses)]
        which = np.repeat(np.arange(len(found)), [len(f) for f in found])
        states, of = np.unique(np.concatenate(found), return_inverse=True)
        poses, tight = lattice_poses(self.nav_map, states), exits.near_root()
        least = exits.cost[which] + self._least_costs(exits.poses[which], poses[of])
        near = least <= exits.cost[which] + _MAX_CURVE
        which, of, least = which[near], of[near], least[near]
        cost, via = np.full(len(states), np.inf), np.full(len(states), -1)
        left = np.lexsort((least, of))
        while len(left):
            # Try the exit with the lowest bound of the cost first, for each state.
            first = np.append(True, np.diff(of[left]) > 0)
            tried, left = left[first], left[~first]
            for same in (True, False):
                k = tried[tight[which[tried]] == same]
                total = exits.cost[which[k]]
                total = total + self._connection_cost(exits.poses[which[k]], poses[of[k]], same)
                k, total = k[total < cost[of[k]]], total[total < cost[of[k]]]
                cost[of[k]], via[of[k]] = total, which[k]
            left = left[least[left] < cost[of[left]]]
        good = np.isfinite(cost)
        return LatticeEntries(exits, states[good], cost[good], via[good])

    def _least_costs(
        self, a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        """Compute lower bounds of the costs of simple paths [m]."""
        away, radius = b - a, self._maneuvers.turning_radius
        if radius > 0:
            return shortest_lengths(*map(np.ascontiguousarray, (a, b)), radius)
        return np.hypot(*away[:, :2].T) + TURNING_COST * np.abs(wrap_angle(away[:, 2]))

    def _near(self, exit_pose: Float[np.ndarray, "3"], radius: float) -> Int[np.ndarray, " k"]:
        """Find free lattice states around a pose with headings for turning or driving there."""
        nav_map, shape = self.nav_map, lattice_shape(self.nav_map)
        count, rows, columns = shape
        j0, i0 = np.floor((exit_pose[:2] - nav_map.origin) / CELL).astype(int)
        span = np.arange(-int(radius / CELL), int(radius / CELL) + 1)
        i, j = (a.ravel() for a in np.meshgrid(i0 + span, j0 + span, indexing="ij"))
        inside = (i >= 0) & (j >= 0) & (i < rows) & (j < columns)
        i, j = i[inside], j[inside]
        away = nav_map.origin + (np.stack([j, i], -1) + 0.5) * CELL - exit_pose[:2]
        near = np.hypot(*away.T) <= radius
        i, j, away = i[near], j[near], away[near] * (-1 if self.is_goal else 1)
        toward = np.arctan2(away[:, 1], away[:, 0])
        headings = np.stack([np.full(len(i), exit_pose[2]), toward, toward + np.pi], -1)
        if self._maneuvers.turning_radius > 0:
            headings = headings[:, :1]  # others are far on arcs
        apart = np.abs(wrap_angle((headings[..., None] - HEADINGS).ravel()))
        h = apart.reshape(*headings.shape, count).argmin(-1)
        h = np.column_stack([h, (h[:, 0] + 1) % count, (h[:, 0] - 1) % count])
        index = np.unique(np.ravel_multi_index((h, i[:, None], j[:, None]), shape))
        index = index[nav_map.inside.ravel()[index % nav_map.inside.size]]
        poses = lattice_poses(nav_map, index)
        return index[
            gaps(poses, nav_map.prisms, nav_map.planning_obstacles, cap=MIN_GAP) >= MIN_GAP
        ]


def path_end(
    nav_map: NavigationMap,
    config: PathConfig,
    pose: Float[np.ndarray, "3"],
    needed: float,
    *,
    is_goal: bool,
) -> PathEnd:
    """Return the start or goal of a path; cached, because many paths can share it."""
    x, y, yaw = map(float, pose)
    return _path_end(nav_map, config, (x, y, yaw), is_goal, float(needed))


@owner_cache(8)
def _path_end(
    nav_map: NavigationMap,
    config: PathConfig,
    pose: tuple[float, float, float],
    is_goal: bool,
    needed: float,
) -> PathEnd:
    return PathEnd(nav_map, config, np.array(pose), is_goal, needed)
