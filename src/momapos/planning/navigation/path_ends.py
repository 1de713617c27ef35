"""How a path leaves its start and comes to its goal: by which states of the lattice, at what cost.

A start or goal need not be a state of the lattice. It is joined to the states around it by simple
paths, and by way of its exits (`lattice_connection`), where it stands too close to things for that.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import wrap_angle

from .cost_map import CELL
from .footprint_map import FARTHEST, HEADINGS, NavigationMap
from .lattice import PathModel, connections
from .lattice_connection import Exits, shuffled, straight
from .outline_gaps import CostWeights, Surroundings, gaps

if TYPE_CHECKING:
    from jaxtyping import Float, Int

NEEDED = 0.01
"""Gap that every pose of a path has, but where it begins and ends [m]."""
_AROUND = 0.15, 0.3
"""How far lattice states may be from an exit, and from the start or goal itself [m]."""


@dataclass(frozen=True)
class PathConfig:
    """What makes one path better than another of the same length."""

    preferred_clearance: float = 0.08
    """Gap to everything that is kept where there is room [m]."""
    weight: float = 1.0
    """By which a meter along obstacles costs more than one with room [-]."""
    turning: float = 0.1
    """Cost of turning [m/rad]."""
    reversing: float = 1.3
    """Cost of a meter driven backwards, where a base has a front [-]."""


DEFAULT = PathConfig()


def path_model(
    nav_map: NavigationMap, config: PathConfig, needed_clearance: float = NEEDED
) -> PathModel:
    """What the kernels search by.

    Args:
        nav_map: Where the robot fits.
        config: What makes one path better than another.
        needed_clearance: Gap that is kept all along [m].
    """
    return PathModel(
        nav_map.robot.drive == "omni",
        Surroundings(nav_map.prisms.arrays, nav_map.planning_obstacles.arrays),
        CostWeights(
            float(needed_clearance),
            config.preferred_clearance,
            config.weight,
            config.turning,
            config.reversing,
        ),
    )


def lattice_shape(nav_map: NavigationMap) -> tuple[int, int, int]:
    """Headings, rows and columns of the lattice."""
    return len(HEADINGS), *nav_map.shape


def lattice_poses(nav_map: NavigationMap, index: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k 3"]:
    """Poses of states of the lattice, given as flat indices."""
    h, i, j = np.unravel_index(index, lattice_shape(nav_map))
    xy = nav_map.origin + (np.stack([j, i], -1) + 0.5) * CELL
    return np.column_stack([xy, HEADINGS[h]])


@dataclass(frozen=True, eq=False)
class Attached:
    """States of the lattice that are joined to a start or goal."""

    exits: Exits
    states: Int[np.ndarray, " n"]
    """Flat indices."""
    cost: Float[np.ndarray, " n"]
    """Of the cheapest path between the start or goal and each [m]."""
    via: Int[np.ndarray, " n"]
    """The exit by which that goes."""

    def path(self, state: int) -> Float[np.ndarray, "k 3"]:
        """Exits between the start or goal and a state, from there on."""
        return self.exits.path(int(self.via[np.flatnonzero(self.states == state)[0]]))


@dataclass(frozen=True, eq=False)
class PathEnd:
    """The start or the goal of a path."""

    nav_map: NavigationMap
    config: PathConfig
    pose: Float[np.ndarray, "3"]
    is_goal: bool
    needed: float
    """Gap that is needed there [m]."""

    @cached_property
    def simply(self) -> Attached:
        """By exits that are left straight."""
        return self._attached(straight(self.pose, self._sides, self._joined))

    @cached_property
    def shuffling(self) -> Attached:
        """By exits that a base shuffles to, which takes long to tell."""
        return self._attached(shuffled(self.pose, self._sides, self._joined, self._room, NEEDED))

    @property
    def _sides(self) -> int:
        return 4 if self.nav_map.robot.drive == "omni" else 2

    def _room(self, poses: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        return gaps(poses, self.nav_map.prisms, self.nav_map.planning_obstacles, cap=FARTHEST)

    def _joined(
        self, inner: Float[np.ndarray, "n 3"], outer: Float[np.ndarray, "n 3"], tight: bool
    ) -> Float[np.ndarray, " n"]:
        """Cost of the simple path from each inner pose to the outer one; to it at the goal [m]."""
        model = path_model(self.nav_map, self.config, self.needed if tight else NEEDED)
        inner, outer = np.ascontiguousarray(inner), np.ascontiguousarray(outer)
        return connections(*((outer, inner) if self.is_goal else (inner, outer)), model)[0]

    def _attached(self, exits: Exits) -> Attached:
        """Join the lattice around exits to them, each state by the cheapest."""
        found = [self._near(pose, _AROUND[k == 0]) for k, pose in enumerate(exits.poses)]
        which = np.repeat(np.arange(len(found)), [len(f) for f in found])
        states, of = np.unique(np.concatenate(found), return_inverse=True)
        poses, tight = lattice_poses(self.nav_map, states), exits.near_root()
        away = poses[of] - exits.poses[which]
        turn = np.abs(wrap_angle(away[:, 2]))
        least = exits.cost[which] + np.hypot(*away[:, :2].T) + self.config.turning * turn
        cost, via = np.full(len(states), np.inf), np.full(len(states), -1)
        left = np.lexsort((least, of))
        while len(left):
            # Of each state the exit by which it costs least, if nothing is in between.
            first = np.append(True, np.diff(of[left]) > 0)
            asked, left = left[first], left[~first]
            for same in (True, False):
                k = asked[tight[which[asked]] == same]
                total = exits.cost[which[k]]
                total = total + self._joined(exits.poses[which[k]], poses[of[k]], same)
                k, total = k[total < cost[of[k]]], total[total < cost[of[k]]]
                cost[of[k]], via[of[k]] = total, which[k]
            left = left[least[left] < cost[of[left]]]
        good = np.isfinite(cost)
        return Attached(exits, states[good], cost[good], via[good])

    def _near(self, exit_pose: Float[np.ndarray, "3"], radius: float) -> Int[np.ndarray, " k"]:
        """Free lattice states around a pose, with the headings that suit going there or turning."""
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
        apart = np.abs(wrap_angle((headings[..., None] - HEADINGS).ravel()))
        h = apart.reshape(*headings.shape, count).argmin(-1)
        h = np.column_stack([h, (h[:, 0] + 1) % count, (h[:, 0] - 1) % count])
        index = np.unique(np.ravel_multi_index((h, i[:, None], j[:, None]), shape))
        index = index[nav_map.inside.ravel()[index % nav_map.inside.size]]
        poses = lattice_poses(nav_map, index)
        return index[gaps(poses, nav_map.prisms, nav_map.planning_obstacles, cap=NEEDED) >= NEEDED]


def path_end(
    nav_map: NavigationMap,
    config: PathConfig,
    pose: Float[np.ndarray, "3"],
    needed: float,
    *,
    is_goal: bool,
) -> PathEnd:
    """The start or goal of a path. Kept, for many paths may begin in one.

    Args:
        nav_map: Where the robot fits.
        config: What makes one path better than another.
        pose: x [m], y [m], yaw [rad].
        needed: Gap that is needed there [m].
        is_goal: Whether paths end there.
    """
    x, y, yaw = map(float, pose)
    return _path_end(nav_map, config, (x, y, yaw), is_goal, float(needed))


@lru_cache(maxsize=8)
def _path_end(
    nav_map: NavigationMap,
    config: PathConfig,
    pose: tuple[float, float, float],
    is_goal: bool,
    needed: float,
) -> PathEnd:
    return PathEnd(nav_map, config, np.array(pose), is_goal, needed)
