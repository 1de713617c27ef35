"""The path from a start to a goal pose: A* with headings, then as few straight legs as possible.

Sources: A* (Hart, Nilsson, Raphael 1968) over the cells and headings of the footprint map; then
any-angle shortening, for the reason that Theta* has (Daniel, Nash, Koenig, Felner 2010): the
shortest path over a lattice is not the shortest path.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.geometry.transforms import wrap_angle
from momapos.navigation.clearance import CostWeights, Surroundings, gaps
from momapos.navigation.convex_polygons import on_floor
from momapos.navigation.cost_map import CELL
from momapos.navigation.footprint_map import FARTHEST, HEADINGS, MOVES, NavigationMap
from momapos.navigation.grid_distance import path_lengths
from momapos.navigation.lattice import Lattice, PathModel, astar, connections, shorten, standable
from momapos.navigation.lattice_connection import Exits, shuffled, straight

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

NEEDED = 0.01
"""Gap that every pose of a path has, but where it begins and ends [m]."""
TURN = 0.3
"""A radian of turning counts as this much path where progress is measured [m/rad]."""
_AROUND = 0.15, 0.3
"""How far lattice states may be from an exit, and from the start or goal itself [m]."""
_SPACING = 0.15
"""Straight stretches of the lattice are offered for shortening at this spacing [m]."""
_FINER = 0.97
"""Sixteen directions measure lengths at most 2.7 % too long; more directions need less."""


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


@dataclass(frozen=True, eq=False)
class BasePath:
    """A path, pose by pose; turns in place are part of it."""

    poses: Float[np.ndarray, "n 3"]
    """x [m], y [m], heading [rad]; at most 2.5 cm or 3 degrees apart."""
    s: Float[np.ndarray, " n"]
    """Progress at each: meters driven plus TURN times radians turned [m]."""
    gap: Float[np.ndarray, " n"]
    """Room around the robot at each [m], at most 0.3."""
    length: float
    """Meters driven."""
    nodes: Float[np.ndarray, "m 3"]
    """Where the legs of the path begin and end."""
    backwards: Bool[np.ndarray, " m-1"]
    """Whether a leg is driven backwards."""

    def follow(self, pose: Float[np.ndarray, "3"], index: int, reach: float) -> int:
        """Index of the pose that a base has come to, at or after an index.

        Args:
            pose: Where the base is.
            index: Where it was on the path.
            reach: How far along the path it may have come since [m].
        """
        end = int(np.searchsorted(self.s, self.s[index] + reach)) + 1
        away = self.poses[index:end] - pose
        beside = np.hypot(away[:, 0], away[:, 1]) + TURN * np.abs(wrap_angle(away[:, 2]))
        return index + int(np.argmin(beside))


def plan_path(
    nav_map: NavigationMap,
    start: Float[np.ndarray, "3"],
    goal: Float[np.ndarray, "3"],
    config: PathConfig = PathConfig(),
) -> BasePath | None:
    """Find a short path for the whole footprint; None where there is none.

    Args:
        nav_map: Where the robot fits.
        start: x [m], y [m], yaw [rad].
        goal: Likewise; the path ends in exactly this pose.
        config: What makes one path better than another.
    """
    needs = 0.5 * gaps(np.stack([start, goal]), nav_map.prisms, nav_map.planning_obstacles)
    if (needs <= 0).any() or not on_floor(
        nav_map.prisms, nav_map.floor_polygon, np.stack([start, goal])
    ).all():
        return None
    plan = _Planner(nav_map, config, np.minimum(needs, NEEDED))
    for rough in plan.rough(start, goal):
        kept = shorten(rough, plan.needs, plan.model())
        if len(kept):
            return plan.sampled(plan.merged(rough[kept]))
    return None


def direct_path(
    nav_map: NavigationMap,
    start: Float[np.ndarray, "3"],
    goal: Float[np.ndarray, "3"],
    config: PathConfig = PathConfig(),
) -> BasePath | None:
    """The path of one leg between two poses, None where it is blocked; see `plan_path`."""
    nodes = np.stack([start, goal])
    needs = 0.5 * gaps(nodes, nav_map.prisms, nav_map.planning_obstacles)
    if (needs <= 0).any():
        return None
    plan = _Planner(nav_map, config, np.minimum(needs, NEEDED))
    cost, _ = connections(nodes[:1], nodes[1:], plan.model(float(plan.needs.min())))
    return plan.sampled(nodes) if np.isfinite(cost[0]) else None


@dataclass(frozen=True, eq=False)
class _LatticePath:
    """A path between two trees of exits."""

    states: Int[np.ndarray, " k"]
    """Of the lattice, flat."""
    before: Float[np.ndarray, "n 3"]
    """Exits on the path from the start."""
    after: Float[np.ndarray, "m 3"]
    """Exits on the path from the goal."""


@dataclass(frozen=True)
class _Planner:
    """One question to the planner."""

    nav_map: NavigationMap
    config: PathConfig
    needs: Float[np.ndarray, "2"]
    """Gaps needed at the start and at the goal [m]."""

    @property
    def omni(self) -> bool:
        return self.nav_map.robot.drive == "omni"

    @property
    def _shape(self) -> tuple[int, int, int]:
        """Headings, rows and columns of the lattice."""
        return len(HEADINGS), *self.nav_map.shape

    def model(self, needed_clearance: float = NEEDED) -> PathModel:
        """What the kernels search by."""
        c, nav_map = self.config, self.nav_map
        return PathModel(
            self.omni,
            Surroundings(nav_map.prisms.arrays, nav_map.planning_obstacles.arrays),
            CostWeights(
                float(needed_clearance), c.preferred_clearance, c.weight, c.turning, c.reversing
            ),
        )

    def rough(
        self, start: Float[np.ndarray, "3"], goal: Float[np.ndarray, "3"]
    ) -> Iterator[Float[np.ndarray, "n 3"]]:
        """Poses of paths, the likeliest first; each may still touch something where it is joined.

        A path over the lattice comes first with stretches thinned out, for speed, then with all its
        poses, for a cusp or a long turn is lost with the poses left out of it.
        """
        direct, _ = connections(start[None], goal[None], self.model(self.needs.min()))
        simple = np.stack([start, goal])
        if np.isfinite(direct[0]):
            bound = np.hypot(*(goal - start)[:2])
            turn = abs(wrap_angle(goal[2] - start[2])) if self.omni else 2 * np.pi
            if direct[0] <= bound + self.config.turning * turn + 1e-6:
                yield simple
                return
        for shuffle in (False, True):
            ends = (self._exits(start, 0, shuffle), self._exits(goal, 1, shuffle))
            found = self._over_lattice(*ends)
            if found is not None:
                every = self._states(found.states)
                for states in (_thinned(every), every):
                    yield np.concatenate(
                        [start[None], found.before, states, found.after[::-1], goal[None]]
                    )
            if np.isfinite(direct[0]):
                yield simple
                return

    def _exits(self, pose: Float[np.ndarray, "3"], end: int, shuffle: bool) -> Exits:
        """Poses from which the lattice can be entered; `end` is 0 at the start, 1 at the goal."""

        def joined(a: np.ndarray, b: np.ndarray, tight: bool) -> np.ndarray:
            return self._joined(a, b, end, tight)

        def room(poses: np.ndarray) -> np.ndarray:
            return gaps(poses, self.nav_map.prisms, self.nav_map.planning_obstacles, cap=FARTHEST)

        sides = 4 if self.omni else 2
        return shuffled(pose, sides, joined, room) if shuffle else straight(pose, sides, joined)

    def _joined(
        self,
        inner: Float[np.ndarray, "n 3"],
        outer: Float[np.ndarray, "n 3"],
        end: int,
        tight: bool,
    ) -> Float[np.ndarray, " n"]:
        """Cost of the simple path from each inner pose to the outer one; to it at the goal [m]."""
        model = self.model(float(self.needs[end]) if tight else NEEDED)
        inner, outer = np.ascontiguousarray(inner), np.ascontiguousarray(outer)
        return connections(*((outer, inner) if end else (inner, outer)), model)[0]

    def _over_lattice(self, first: Exits, last: Exits) -> _LatticePath | None:
        """The cheapest path from one tree of exits to the other."""
        costs, via = zip(*(self._attached(e, k) for k, e in enumerate((first, last))), strict=True)
        nav_map = self.nav_map
        rows, columns = nav_map.shape
        cells = np.unique(np.flatnonzero(np.isfinite(costs[1])) % (rows * columns))
        if not len(cells) or not np.isfinite(costs[0]).any():
            return None
        lattice, model = Lattice(nav_map.origin, CELL, MOVES, HEADINGS, FARTHEST), self.model()
        ahead = _FINER * path_lengths(standable(nav_map.inside, lattice, model), cells, CELL)
        states = astar(nav_map.known_gaps, ahead, *costs, lattice, model)
        if not len(states):
            return None
        before = first.path(via[0][int(states[0])])
        return _LatticePath(states, before, last.path(via[1][int(states[-1])]))

    def _states(self, index: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k 3"]:
        h, i, j = np.unravel_index(index, self._shape)
        xy = self.nav_map.origin + (np.stack([j, i], -1) + 0.5) * CELL
        return np.column_stack([xy, HEADINGS[h]])

    def _attached(
        self, exits: Exits, end: int
    ) -> tuple[Float[np.ndarray, " states"], dict[int, int]]:
        """Costs between the root of a tree and the lattice around it, and by which exit each is."""
        found = [
            self._near(pose, _AROUND[k == 0], outward=not end) for k, pose in enumerate(exits.poses)
        ]
        which = np.repeat(np.arange(len(found)), [len(f) for f in found])
        cost = np.full(math.prod(self._shape), np.inf)
        if not len(which):
            return cost, {}
        index = np.concatenate(found)
        states, total = self._states(index), exits.cost[which]
        tight = exits.near_root()[which]
        for part, same in ((tight, True), (~tight, False)):
            total[part] += self._joined(exits.poses[which[part]], states[part], end, same)
        order = np.argsort(-total)
        cost[index[order]] = total[order]  # of several paths to one state the last, cheapest stays
        return cost, {int(index[k]): int(which[k]) for k in order if np.isfinite(total[k])}

    def _near(
        self, end: Float[np.ndarray, "3"], radius: float, outward: bool
    ) -> Int[np.ndarray, " k"]:
        """Free lattice states around a pose, with the headings that suit going there or turning."""
        nav_map = self.nav_map
        count, rows, columns = self._shape
        j0, i0 = np.floor((end[:2] - nav_map.origin) / CELL).astype(int)
        span = np.arange(-int(radius / CELL), int(radius / CELL) + 1)
        i, j = (a.ravel() for a in np.meshgrid(i0 + span, j0 + span, indexing="ij"))
        inside = (i >= 0) & (j >= 0) & (i < rows) & (j < columns)
        i, j = i[inside], j[inside]
        away = nav_map.origin + (np.stack([j, i], -1) + 0.5) * CELL - end[:2]
        near = np.hypot(*away.T) <= radius
        i, j, away = i[near], j[near], away[near] * (1 if outward else -1)
        toward = np.arctan2(away[:, 1], away[:, 0])
        headings = np.stack([np.full(len(i), end[2]), toward, toward + np.pi], -1)
        apart = np.abs(wrap_angle((headings[..., None] - HEADINGS).ravel()))
        h = apart.reshape(*headings.shape, count).argmin(-1)
        h = np.column_stack([h, (h[:, 0] + 1) % count, (h[:, 0] - 1) % count])
        index = np.unique(np.ravel_multi_index((h, i[:, None], j[:, None]), self._shape))
        index = index[nav_map.inside.ravel()[index % nav_map.inside.size]]
        states = self._states(index)
        return index[gaps(states, nav_map.prisms, nav_map.planning_obstacles, cap=NEEDED) >= NEEDED]

    def merged(self, nodes: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Turn at each node from one leg to the next at once, not by way of the node's heading."""
        nodes, model = nodes.copy(), self.model(self.needs.min())
        if self.omni:
            return nodes
        for k in range(1, len(nodes) - 1):
            step = nodes[k, :2] - nodes[k - 1, :2]
            if np.hypot(*step) < 1e-6:
                continue
            around = nodes[k - 1 : k + 2]
            costs, backwards = connections(around[:-1], around[1:], model)
            straight = around.copy()
            straight[1, 2] = np.arctan2(step[1], step[0]) + np.pi * backwards[0]
            at_once = connections(straight[:-1], straight[1:], model)[0].sum()
            if np.isfinite(at_once) and at_once <= costs.sum() + 1e-9:
                nodes[k, 2] = wrap_angle(straight[1, 2])
        return nodes

    def sampled(self, nodes: Float[np.ndarray, "n 3"]) -> BasePath:
        """Every pose of the path over nodes."""
        _, backwards = connections(nodes[:-1], nodes[1:], self.model(self.needs.min()))
        poses = [nodes[0]]
        for a, b, back in zip(nodes[:-1], nodes[1:], backwards, strict=True):
            step = b[:2] - a[:2]
            if self.omni:
                poses += _line(poses[-1], step, b[2])
                continue
            heading = np.arctan2(step[1], step[0]) + np.pi * back
            if np.hypot(*step) > 1e-6:
                poses += _line(poses[-1], np.zeros(2), heading)
                poses += _line(poses[-1], step, heading)
            poses += _line(poses[-1], np.zeros(2), b[2])
        path = np.array(poses)
        move = np.hypot(*np.diff(path[:, :2], axis=0).T)
        turn = np.abs(wrap_angle(np.diff(path[:, 2])))
        s = np.concatenate([[0.0], np.cumsum(move + TURN * turn)])
        room = gaps(path, self.nav_map.prisms, self.nav_map.planning_obstacles, cap=0.3)
        return BasePath(path, s, room, float(move.sum()), nodes, backwards)


def _line(
    pose: Float[np.ndarray, "3"], step: Float[np.ndarray, "2"], heading: float
) -> list[Float[np.ndarray, "3"]]:
    """Poses of a straight leg with an even turn, without the first one."""
    turn = float(wrap_angle(heading - pose[2]))
    count = int(np.ceil(max(np.hypot(*step) / 0.025, abs(turn) / 0.05)))
    share = np.arange(1, count + 1)[:, None] / max(count, 1)
    line = pose + share * np.array([*step, turn])
    line[:, 2] = wrap_angle(line[:, 2])
    return list(line)


def _thinned(poses: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """Poses of a lattice path: those where it turns, else one every so often."""
    step = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    kept = np.ones(len(poses), bool)
    kept[1:-1] = (np.diff(poses[:-1, 2]) != 0) != (np.diff(poses[1:, 2]) != 0)
    stretch = np.floor(np.concatenate([[0], np.cumsum(step)]) / _SPACING)
    kept[1:-1] |= np.diff(stretch)[:-1] != 0
    return poses[kept]
