"""Plan a path from a start to a goal pose: A* with headings, then as few straight legs as possible.

Sources: A* (Hart, Nilsson, Raphael 1968) over the cells and headings of the footprint map; then
any-angle shortening, for the same reason as in Theta* (Daniel, Nash, Koenig, Felner 2010): the
shortest path over a lattice is not the shortest path.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import wrap_angle

from .convex_polygons import on_floor
from .cost_map import CELL, path_lengths
from .footprint_map import HEADINGS, MAX_GAP, NavigationMap
from .lattice import (
    Lattice,
    PathModel,
    astar,
    car_curves,
    connections,
    lattice_moves,
    planned_radius,
    shorten,
    standable,
)
from .outline_gaps import gaps
from .path_ends import (
    DEFAULT_CONFIG,
    MIN_GAP,
    TURNING_COST,
    LatticeEntries,
    PathConfig,
    lattice_poses,
    lattice_shape,
    path_end,
    path_model,
)
from .reeds_shepp import shortest_lengths

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

METERS_PER_RADIAN = 0.3
"""Path length that a radian of turning counts for in progress [m/rad]."""
_SPACING = 0.15
"""Spacing of poses on straight stretches of the lattice that are offered for shortening [m]."""
_CAR_ESTIMATE = 1.5
"""Estimate of the length ahead of a car-like base, relative to that of a disc [-]. It is no lower
bound; in 15 searches in `kitchen_small`, 1.5 takes 20 to 30 % less time than 0.97, and the paths
after shortening have the same total length within 0.5 %."""
_GOOD_CURVE = 1.5
"""Cost of a curve of a car-like base, relative to the length of the shortest one between its ends,
up to which no other path is searched [-]; backwards, one without obstacles costs 1.3 to 1.5."""
_MIN_PIECE = 1e-6
"""Shorter pieces of a curve are left out [m]."""
_LOWER_BOUND = 0.97
"""Lower bound of the true length relative to that over sixteen directions, 2.7 % too long [-]."""


@dataclass(frozen=True, eq=False)
class BasePath:
    """A path, pose by pose, including turns on the spot."""

    poses: Float[np.ndarray, "n 3"]
    """x [m], y [m], heading [rad]; at most 2.5 cm or 3 degrees apart."""
    s: Float[np.ndarray, " n"]
    """Progress at each pose: meters driven plus METERS_PER_RADIAN times radians turned [m]."""
    gap: Float[np.ndarray, " n"]
    """Gap around the robot at each pose [m], at most 0.3."""
    length: float
    """Distance driven [m]."""
    nodes: Float[np.ndarray, "m 3"]
    """Ends of the legs of the path: straight, or arcs of a car-like base."""
    backwards: Bool[np.ndarray, " m-1"]
    """Whether a leg is driven backwards."""

    def follow(self, pose: Float[np.ndarray, "3"], index: int, reach: float) -> int:
        """Return the index of the pose nearest to a base, at or after its last index.

        Args:
            pose: Pose of the base.
            index: Its last index on the path.
            reach: Largest progress since then [m].
        """
        end = int(np.searchsorted(self.s, self.s[index] + reach)) + 1
        error = self.poses[index:end] - pose
        turn = np.abs(wrap_angle(error[:, 2]))
        return index + int(np.argmin(np.hypot(error[:, 0], error[:, 1]) + METERS_PER_RADIAN * turn))


def plan_path(
    nav_map: NavigationMap,
    start: Float[np.ndarray, "3"],
    goal: Float[np.ndarray, "3"],
    config: PathConfig = DEFAULT_CONFIG,
) -> BasePath | None:
    """Find a short path for the whole footprint; None without one.

    Args:
        nav_map: Navigation map.
        start: x [m], y [m], yaw [rad].
        goal: Likewise; the path ends exactly at this pose.
        config: Weights of the cost.
    """
    ends = np.stack([start, goal])
    plan = _planner(nav_map, ends, config)
    if plan is None or not on_floor(nav_map.prisms, nav_map.floor_polygon, ends).all():
        return None
    for rough in plan.rough(start, goal):
        kept = shorten(rough, plan.needs, plan.model())
        if len(kept):
            return plan.sampled(plan.merged(rough[kept]))
    return None


def direct_path(
    nav_map: NavigationMap,
    start: Float[np.ndarray, "3"],
    goal: Float[np.ndarray, "3"],
    config: PathConfig = DEFAULT_CONFIG,
) -> BasePath | None:
    """Return the path of one leg between two poses, None if it is blocked; see `plan_path`."""
    nodes = np.stack([start, goal])
    plan = _direct(nav_map, nodes, config)
    return None if plan is None else plan.sampled(nodes)


def leads_straight(
    nav_map: NavigationMap, start: Float[np.ndarray, "3"], goal: Float[np.ndarray, "3"]
) -> bool:
    """Check whether there is a path of one leg between two poses, see `direct_path`."""
    return _direct(nav_map, np.stack([start, goal]), DEFAULT_CONFIG) is not None


def lead_straight(
    nav_map: NavigationMap, starts: Float[np.ndarray, "n 3"], goal: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, " n"]:
    """Return from which of many poses a path of one leg leads to another, see `leads_straight`.

    Poses that are closer to obstacles than paths keep count as if none did.
    """
    ends = np.vstack([starts, goal])
    needs = np.minimum(0.5 * gaps(ends, nav_map.prisms, nav_map.planning_obstacles), MIN_GAP)
    out = np.zeros(len(starts), bool)
    rows = np.flatnonzero(needs[:-1] == MIN_GAP)
    if needs[-1] > 0.0 and len(rows):
        model = path_model(nav_map, DEFAULT_CONFIG, float(needs[-1]))
        goals = np.repeat(np.asarray(goal, float)[None], len(rows), axis=0)
        cost, _ = connections(ends[rows], goals, model)
        out[rows] = np.isfinite(cost)
    return out


def _direct(
    nav_map: NavigationMap, nodes: Float[np.ndarray, "2 3"], config: PathConfig
) -> _Planner | None:
    """Return the planner of a path of one leg, None if it is blocked."""
    plan = _planner(nav_map, nodes, config)
    if plan is None:
        return None
    cost, _ = connections(nodes[:1], nodes[1:], plan.model(float(plan.needs.min())))
    return plan if np.isfinite(cost[0]) else None


def _planner(
    nav_map: NavigationMap, ends: Float[np.ndarray, "2 3"], config: PathConfig
) -> _Planner | None:
    """Return the planner of a path between two poses, None if one is in collision."""
    needs = 0.5 * gaps(ends, nav_map.prisms, nav_map.planning_obstacles)
    return None if (needs <= 0).any() else _Planner(nav_map, config, np.minimum(needs, MIN_GAP))


@dataclass(frozen=True, eq=False)
class _Planner:
    nav_map: NavigationMap
    config: PathConfig
    needs: Float[np.ndarray, "2"]
    """Smallest gaps at the start and at the goal [m]."""

    @property
    def omni(self) -> bool:
        return self.nav_map.robot.drive == "omni"

    def model(self, needed_clearance: float = MIN_GAP) -> PathModel:
        return path_model(self.nav_map, self.config, needed_clearance)

    def rough(
        self, start: Float[np.ndarray, "3"], goal: Float[np.ndarray, "3"]
    ) -> Iterator[Float[np.ndarray, "n 3"]]:
        """Yield poses of paths, the most probable first; their connections are not yet checked.

        A path over the lattice comes first with fewer poses on its stretches, for speed. Then it
        comes with all poses, because dropping poses can lose a cusp or a long turn.
        """
        direct, _ = connections(start[None], goal[None], self.model(self.needs.min()))
        simple = np.stack([start, goal])
        if np.isfinite(direct[0]) and direct[0] <= self._good_cost(start, goal) + 1e-6:
            yield simple
            return
        begin, end = (
            path_end(self.nav_map, self.config, pose, need, is_goal=is_goal)
            for pose, need, is_goal in zip((start, goal), self.needs, (False, True), strict=True)
        )
        for shuffle in (False, True):
            first, last = (e.shuffled if shuffle else e.straight for e in (begin, end))
            states = self._over_lattice(first, last)
            if len(states):
                before, after = first.path(int(states[0])), last.path(int(states[-1]))
                every = lattice_poses(self.nav_map, states)
                for between in (_reduced(every), every):
                    yield np.concatenate([start[None], before, between, after[::-1], goal[None]])
            if np.isfinite(direct[0]):
                yield simple
                return

    def _good_cost(self, start: Float[np.ndarray, "3"], goal: Float[np.ndarray, "3"]) -> float:
        """Return the cost up to which a simple path is taken without a search [m]."""
        radius = planned_radius(self.nav_map.robot)
        if radius > 0:
            return _GOOD_CURVE * float(shortest_lengths(start[None], goal[None], radius)[0])
        turn = abs(wrap_angle(goal[2] - start[2])) if self.omni else 2 * np.pi
        return float(np.hypot(*(goal - start)[:2]) + TURNING_COST * turn)

    def _over_lattice(self, first: LatticeEntries, last: LatticeEntries) -> Int[np.ndarray, " k"]:
        """Return the states of the cheapest path over the lattice, flat; empty without a path."""
        nav_map = self.nav_map
        rows, columns = nav_map.shape
        if not len(first.states) or not len(last.states) or first.never_reach(last.states):
            return np.zeros(0, int)
        costs = np.full((2, math.prod(lattice_shape(nav_map))), np.inf)
        for cost, end in zip(costs, (first, last), strict=True):
            cost[end.states] = end.cost
        cells = np.unique(last.states % (rows * columns))
        share = _CAR_ESTIMATE if nav_map.robot.drive == "car" else _LOWER_BOUND
        ahead = share * path_lengths(_standable(nav_map), cells, CELL)
        path, reached = astar(
            nav_map.known_gaps, ahead, costs[0], costs[1], _lattice(nav_map), self.model()
        )
        if not len(path):
            first.remember(np.isfinite(ahead), reached)
        return path

    def merged(self, nodes: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Turn at each node directly from one leg to the next, where that is not costlier."""
        nodes, model = nodes.copy(), self.model(self.needs.min())
        if self.nav_map.robot.drive != "differential":
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
        """Sample all poses of the path over nodes."""
        if self.nav_map.robot.drive == "car":
            return self._sampled_curves(nodes)
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
        return self._path(np.array(poses), nodes, backwards)

    def _sampled_curves(self, nodes: Float[np.ndarray, "n 3"]) -> BasePath:
        """Sample the curves of a car-like base over nodes; each piece of them is a leg."""
        curves = car_curves(nodes[:-1], nodes[1:], self.model(self.needs.min()))
        poses, ends, backwards = [nodes[:1]], [nodes[:1]], []
        for curve, goal in zip(curves, nodes[1:], strict=True):
            for length, curvature in curve[np.abs(curve[:, 0]) > _MIN_PIECE]:
                poses.append(_arc(poses[-1][-1], length, curvature))
                ends.append(poses[-1][-1:])
                backwards.append(length < 0)
            poses[-1][-1] = ends[-1][-1] = goal  # rounding errors do not add up
        return self._path(np.concatenate(poses), np.concatenate(ends), np.array(backwards, bool))

    def _path(
        self,
        path: Float[np.ndarray, "n 3"],
        nodes: Float[np.ndarray, "m 3"],
        backwards: Bool[np.ndarray, " m-1"],
    ) -> BasePath:
        move = np.hypot(*np.diff(path[:, :2], axis=0).T)
        turn = np.abs(wrap_angle(np.diff(path[:, 2])))
        s = np.concatenate([[0.0], np.cumsum(move + METERS_PER_RADIAN * turn)])
        gap = gaps(path, self.nav_map.prisms, self.nav_map.planning_obstacles, cap=0.3)
        return BasePath(path, s, gap, float(move.sum()), nodes, backwards)


def _lattice(nav_map: NavigationMap) -> Lattice:
    return Lattice(nav_map.origin, CELL, HEADINGS, lattice_moves(nav_map.robot), MAX_GAP)


@owner_cache()
def _standable(nav_map: NavigationMap) -> Bool[np.ndarray, "rows columns"]:
    """Find the cells in which the base fits with some heading."""
    return standable(nav_map.inside, _lattice(nav_map), path_model(nav_map, DEFAULT_CONFIG))


def _line(
    pose: Float[np.ndarray, "3"], step: Float[np.ndarray, "2"], heading: float
) -> list[Float[np.ndarray, "3"]]:
    """Sample the poses of a straight leg with an even turn, without the first one."""
    turn = float(wrap_angle(heading - pose[2]))
    count = int(np.ceil(max(np.hypot(*step) / 0.025, abs(turn) / 0.05)))
    share = np.arange(1, count + 1)[:, None] / max(count, 1)
    line = pose + share * np.array([*step, turn])
    line[:, 2] = wrap_angle(line[:, 2])
    return list(line)


def _arc(pose: Float[np.ndarray, "3"], length: float, curvature: float) -> Float[np.ndarray, "n 3"]:
    """Sample the poses of an arc of a signed length."""
    count = int(np.ceil(max(abs(length) / 0.025, abs(curvature * length) / 0.05)))
    done = length * np.arange(1, count + 1) / count
    turn = curvature * done
    chord, middle = done * np.sinc(turn / 2 / np.pi), pose[2] + turn / 2
    x, y = pose[0] + chord * np.cos(middle), pose[1] + chord * np.sin(middle)
    return np.column_stack([x, y, wrap_angle(pose[2] + turn)])


def _reduced(poses: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """Reduce a lattice path to the poses where it turns, and one per `_SPACING` in between."""
    step = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    kept = np.ones(len(poses), bool)
    kept[1:-1] = (np.diff(poses[:-1, 2]) != 0) != (np.diff(poses[1:, 2]) != 0)
    stretch = np.floor(np.concatenate([[0], np.cumsum(step)]) / _SPACING)
    kept[1:-1] |= np.diff(stretch)[:-1] != 0
    return poses[kept]
