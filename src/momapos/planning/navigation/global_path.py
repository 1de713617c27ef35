"""The path from a start to a goal pose: A* with headings, then as few straight legs as possible.

Sources: A* (Hart, Nilsson, Raphael 1968) over the cells and headings of the footprint map; then
any-angle shortening, for the reason that Theta* has (Daniel, Nash, Koenig, Felner 2010): the
shortest path over a lattice is not the shortest path.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import wrap_angle

from .convex_polygons import on_floor
from .cost_map import CELL
from .footprint_map import FARTHEST, HEADINGS, MOVES, NavigationMap
from .grid_distance import path_lengths
from .lattice import Lattice, PathModel, astar, connections, shorten, standable
from .outline_gaps import gaps
from .path_ends import (
    DEFAULT,
    NEEDED,
    Attached,
    PathConfig,
    lattice_poses,
    lattice_shape,
    path_end,
    path_model,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

TURN = 0.3
"""A radian of turning counts as this much path where progress is measured [m/rad]."""
_SPACING = 0.15
"""Straight stretches of the lattice are offered for shortening at this spacing [m]."""
_FINER = 0.97
"""Sixteen directions measure lengths at most 2.7 % too long; more directions need less."""


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
    config: PathConfig = DEFAULT,
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
    config: PathConfig = DEFAULT,
) -> BasePath | None:
    """The path of one leg between two poses, None where it is blocked; see `plan_path`."""
    nodes = np.stack([start, goal])
    plan = _direct(nav_map, nodes, config)
    return None if plan is None else plan.sampled(nodes)


def leads_straight(
    nav_map: NavigationMap, start: Float[np.ndarray, "3"], goal: Float[np.ndarray, "3"]
) -> bool:
    """Whether there is a path of one leg between two poses, see `direct_path`."""
    return _direct(nav_map, np.stack([start, goal]), DEFAULT) is not None


def _direct(
    nav_map: NavigationMap, nodes: Float[np.ndarray, "2 3"], config: PathConfig
) -> _Planner | None:
    """What plans the path of one leg; None where it is blocked."""
    needs = 0.5 * gaps(nodes, nav_map.prisms, nav_map.planning_obstacles)
    if (needs <= 0).any():
        return None
    plan = _Planner(nav_map, config, np.minimum(needs, NEEDED))
    cost, _ = connections(nodes[:1], nodes[1:], plan.model(float(plan.needs.min())))
    return plan if np.isfinite(cost[0]) else None


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

    def model(self, needed_clearance: float = NEEDED) -> PathModel:
        """What the kernels search by."""
        return path_model(self.nav_map, self.config, needed_clearance)

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
        begin, end = (
            path_end(self.nav_map, self.config, pose, need, is_goal=is_goal)
            for pose, need, is_goal in zip((start, goal), self.needs, (False, True), strict=True)
        )
        for shuffle in (False, True):
            first, last = (e.shuffling if shuffle else e.simply for e in (begin, end))
            states = self._over_lattice(first, last)
            if len(states):
                before, after = first.path(int(states[0])), last.path(int(states[-1]))
                every = lattice_poses(self.nav_map, states)
                for between in (_thinned(every), every):
                    yield np.concatenate([start[None], before, between, after[::-1], goal[None]])
            if np.isfinite(direct[0]):
                yield simple
                return

    def _over_lattice(self, first: Attached, last: Attached) -> Int[np.ndarray, " k"]:
        """States of the cheapest path over the lattice, flat; empty where there is none."""
        nav_map = self.nav_map
        rows, columns = nav_map.shape
        if not len(first.states) or not len(last.states):
            return np.zeros(0, int)
        costs = np.full((2, math.prod(lattice_shape(nav_map))), np.inf)
        for cost, end in zip(costs, (first, last), strict=True):
            cost[end.states] = end.cost
        cells = np.unique(last.states % (rows * columns))
        ahead = _FINER * path_lengths(_standable(nav_map), cells, CELL)
        return astar(nav_map.known_gaps, ahead, *costs, _lattice(nav_map), self.model())

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


def _lattice(nav_map: NavigationMap) -> Lattice:
    return Lattice(nav_map.origin, CELL, MOVES, HEADINGS, FARTHEST)


@lru_cache(maxsize=8)
def _standable(nav_map: NavigationMap) -> Bool[np.ndarray, "rows columns"]:
    """Where the base can be with some heading."""
    return standable(nav_map.inside, _lattice(nav_map), path_model(nav_map, DEFAULT))


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
