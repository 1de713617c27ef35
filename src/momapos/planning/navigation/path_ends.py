"""Connect the start and the goal of a path to states of the lattice.

A base close to furniture can neither turn on the spot nor drive to the center of a cell. It backs
out straight. If a wall runs along its side, that does not help and it shuffles: it turns as far as
the clearance allows, drives, and turns again. A car-like base turns on arcs. The path to the
goal is the same in reverse.

A start or goal need not be a state of the lattice. Simple paths connect it to nearby states. If
obstacles are too close for that, they lead through its exits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache, refuse_below
from momapos.core.geometry import wrap_angle

from .cost_map import CELL
from .footprint_map import HEADINGS, MAX_GAP, NavigationMap
from .lattice import REVERSING_COST, PathModel, connections, planned_radius
from .outline_gaps import CostWeights, OutlineArrays, gaps
from .reeds_shepp import shortest_lengths

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Bool, Float, Int

    ConnectionCost = Callable[
        [Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], bool], Float[np.ndarray, " n"]
    ]
    """Cost of the simple path from each pose to another [m]; True allows the smaller gap of the
    start or goal."""

STRETCHES = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2])
"""Lengths of straight stretches [m]."""
_SMALL_TURNS = np.radians([0.0, 0.7, -0.7, 1.5, -1.5, 3.0, -3.0, 6.0, -6.0, 12.0, -12.0])
"""Turns before a stretch of shuffling [rad]; the lattice's headings are 8 to 18 degrees apart."""
_SMALL_BENDS = np.append(_SMALL_TURNS, np.radians([25.0, -25.0, 50.0, -50.0]))
"""Turns of a car-like base before a stretch of shuffling [rad], on arcs as long as a stretch at
most."""
_MAX_STRETCHES = 4
"""Largest number of stretches of shuffling [-]."""
_BEAM_WIDTH = 16
"""Number of poses, those with the largest gaps, that shuffling continues from [-]."""
_MIN_DIFFERENCE = 0.1, np.radians(5.0)
"""Of poses that differ by less, only one is used [m], [rad]."""


@dataclass(frozen=True)
class Maneuvers:
    """How a base moves on its way out."""

    sides: int
    """2 for a base that drives along its heading, 4 for an omni base [-]."""
    turning_radius: float
    """Turning radius of the paths of a car-like base [m]; 0 for one that turns on the spot."""

    def ends(
        self, poses: Float[np.ndarray, "l 3"], *, straight: bool
    ) -> Float[np.ndarray, "l n 3"]:
        """Return the poses that a stretch leads to from others, with turns unless straight."""
        if self.turning_radius > 0:
            short = self.turning_radius * np.abs(_SMALL_BENDS) <= STRETCHES[-1]
            turns = np.zeros(1) if straight else _SMALL_BENDS[short]
            return _bent_stretches(poses, turns, self.turning_radius)
        return _stretches(poses, np.zeros(1) if straight else _SMALL_TURNS, self.sides)


@dataclass(frozen=True, eq=False)
class Exits:
    """Tree of poses around a start or goal, which is the root at index 0."""

    poses: Float[np.ndarray, "n 3"]
    cost: Float[np.ndarray, " n"]
    """Cost of the path between the root and each pose [m]."""
    parent: Int[np.ndarray, " n"]
    """The previous pose on the path from the root; -1 for the root."""

    def path(self, index: int) -> Float[np.ndarray, "k 3"]:
        """Return the poses from the root to a pose, without the root."""
        path = []
        while index > 0:
            path.append(self.poses[index])
            index = int(self.parent[index])
        return np.array(path[::-1]).reshape(-1, 3)

    def near_root(self) -> np.ndarray:
        """Return which poses are the root or its children, where the smaller gap is allowed."""
        return self.parent <= 0


def straight_exits(
    pose: Float[np.ndarray, "3"], maneuvers: Maneuvers, connection_cost: ConnectionCost
) -> Exits:
    """Leave a pose forwards, backwards and, with four sides, sideways.

    Args:
        pose: The start or goal.
        maneuvers: How the base moves.
        connection_cost: See `ConnectionCost`.
    """
    ends = maneuvers.ends(pose[None], straight=True)[0]
    cost = connection_cost(np.broadcast_to(pose, ends.shape), ends, True)
    good = np.isfinite(cost)
    return Exits(
        np.concatenate([pose[None], ends[good]]),
        np.concatenate([[0.0], cost[good]]),
        np.concatenate([[-1], np.zeros(int(good.sum()), int)]),
    )


def shuffled_exits(
    pose: Float[np.ndarray, "3"],
    maneuvers: Maneuvers,
    connection_cost: ConnectionCost,
    gap: Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, " n"]],
    needed: float,
) -> Exits:
    """Leave a pose by small turns and straight stretches, toward larger gaps.

    Args:
        pose, maneuvers, connection_cost: See `straight_exits`.
        gap: Computes the gaps at poses [m].
        needed: Smallest gap of all poses except those next to the start or goal [m].
    """
    poses, cost, parent = pose[None], np.zeros(1), np.array([-1])
    level = np.array([0])
    for stretch in range(_MAX_STRETCHES):
        ends = maneuvers.ends(poses[level], straight=False)
        before = np.repeat(level, ends.shape[1])
        ends = ends.reshape(-1, 3)
        gaps = gap(ends)
        # Drop poses where the base does not fit; next to the root, a smaller gap is allowed.
        good = np.flatnonzero(gaps >= (0.0 if stretch == 0 else needed))
        leg = connection_cost(poses[before[good]], ends[good], stretch == 0)
        total = cost[before[good]] + leg
        good, total = good[np.isfinite(total)], total[np.isfinite(total)]
        best = _best(ends[good], gaps[good], total)
        good, total = good[best], total[best]
        if not len(good):
            break
        level = len(poses) + np.arange(len(good))
        poses = np.concatenate([poses, ends[good]])
        cost = np.concatenate([cost, total])
        parent = np.concatenate([parent, before[good]])
    return Exits(poses, cost, parent)


def _stretches(
    poses: Float[np.ndarray, "l 3"], turns: Float[np.ndarray, " t"], sides: int
) -> Float[np.ndarray, "l n 3"]:
    """Return the poses that are a turn and a straight stretch away from others."""
    side = np.arange(sides) * 2 * np.pi / sides
    heading = wrap_angle(poses[:, 2, None] + turns)[:, :, None, None]
    along = heading + side[:, None]
    x = poses[:, 0, None, None, None] + STRETCHES * np.cos(along)
    y = poses[:, 1, None, None, None] + STRETCHES * np.sin(along)
    ends = np.stack([x, y, np.broadcast_to(heading, x.shape)], -1)
    return ends.reshape(len(poses), -1, 3)


def _bent_stretches(
    poses: Float[np.ndarray, "l 3"], turns: Float[np.ndarray, " t"], radius: float
) -> Float[np.ndarray, "l n 3"]:
    """Return the poses that an arc and a straight stretch, either way, are away from others."""
    # The chord of an arc has the heading of its middle.
    chord = 2 * radius * np.sin(np.abs(turns) / 2) * np.array([[1.0], [-1.0]])
    middle = poses[:, 2, None, None] + turns / 2
    x = poses[:, 0, None, None] + chord * np.cos(middle)
    y = poses[:, 1, None, None] + chord * np.sin(middle)
    yaw = np.broadcast_to(poses[:, 2, None, None] + turns, x.shape)
    bent = np.stack([x, y, yaw], -1).reshape(-1, 3)
    return _stretches(bent, np.zeros(1), 2).reshape(len(poses), -1, 3)


def _best(
    poses: Float[np.ndarray, "n 3"], gaps: Float[np.ndarray, " n"], cost: Float[np.ndarray, " n"]
) -> Int[np.ndarray, " k"]:
    """Select distinct poses with the largest gaps, and the cheapest of equal ones."""
    order = np.lexsort((cost, -np.round(gaps, 3)))
    distance, angle = _MIN_DIFFERENCE
    cell = np.floor(poses[order] / [distance, distance, angle])
    _, first = np.unique(cell, axis=0, return_index=True)
    return np.asarray(order[np.sort(first)[:_BEAM_WIDTH]])


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
