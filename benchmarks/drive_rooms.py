"""Draw the questions of drive.py: rooms, starts, goals and people; check whether a path exists."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.ndimage import label
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from momapos.core.geometry import inscribed_radius, wrap_angle
from momapos.model.scene import LAYOUTS, Scene, builtin_names, generate_kitchen, load_scene
from momapos.planning.grasps import scene_boxes
from momapos.planning.navigation import (
    CELL,
    NavigationMap,
    base_height,
    build_cost_map,
    floor_plan,
    gaps,
)
from momapos.planning.navigation.cost_map import FloorPlan
from momapos.planning.navigation.footprint_map import HEADINGS

MIN_LENGTH = 1.5
"""Minimum geodesic length of a drive [m]."""
MIN_GAP = 0.01
"""Minimum gap around start and goal [m], as in placement."""
PERSON = 0.25
"""Radius of a person [m]."""
PACE = 0.3, 0.6
"""Range of walking speeds [m/s]."""
AWAY, PATIENCE = 0.4, 3.0
"""Distance from the robot at which people stop [m], and how long they wait there [s]."""
_FINE, _TURNS = CELL / 2, 72
"""Cell size [m] and number of headings [-] of the grid that checks whether a path exists."""


@dataclass(frozen=True, eq=False)
class Question:
    """A requested drive."""

    start: Float[np.ndarray, "3"]
    goal: Float[np.ndarray, "3"]
    disc: float
    """Geodesic length for a disc of the inscribed radius, placement's cost [m]."""
    footprint: float
    """Geodesic length over cells in which the footprint fits at some heading [m]."""

    @property
    def detour(self) -> float:
        """Return how much longer the path is than the straight line [m]."""
        return self.disc - float(np.hypot(*(self.goal - self.start)[:2]))


def rooms(folder: Path, layouts: int) -> Iterator[Scene]:
    """Yield the built-in kitchens and one kitchen of each generated layout."""
    for name in builtin_names():
        yield load_scene(name)
    for seed, layout in enumerate(LAYOUTS[:layouts]):
        yield load_scene(generate_kitchen(layout, seed=seed, out=folder / f"{layout}.json"))


def questions(nav_map: NavigationMap, scene: Scene, rng: np.random.Generator) -> Iterator[Question]:
    """Yield random starts and goals that the disc can drive between."""
    robot = nav_map.robot
    plan = floor_plan(
        scene_boxes(scene), height=base_height(robot), floor_polygon=scene.floor_polygon
    )
    # Minus half a cell: a footprint that fits between two cell centers also counts.
    fits = FloorPlan(nav_map.origin, np.asarray(~(nav_map.gap > -CELL / 2).any(0)))
    states = np.argwhere(nav_map.free)
    while True:
        h, i, j = states[rng.integers(len(states), size=2)].T
        xy = nav_map.origin + (np.stack([j, i], -1) + rng.uniform(0, 1, (2, 2))) * CELL
        ends = np.column_stack([xy, wrap_angle(HEADINGS[h] + rng.uniform(-0.1, 0.1, 2))])
        if (gaps(ends, nav_map.prisms, nav_map.planning_obstacles) < MIN_GAP).any():
            continue
        cost = build_cost_map(plan, ends[0, :2], radius=inscribed_radius(robot.footprint))
        length = float(cost.lengths(ends[1:, :2])[0])
        if MIN_LENGTH <= length < np.inf:
            real = build_cost_map(fits, ends[0, :2], radius=0.0)
            yield Question(ends[0], ends[1], length, float(real.lengths(ends[1:, :2])[0]))


def connected(
    nav_map: NavigationMap, start: Float[np.ndarray, "3"], goal: Float[np.ndarray, "3"]
) -> bool:
    """Return whether a fine grid of free poses connects two poses, by steps of one cell or turn.

    It ignores the kinematics of the base, so it may find a path that the base cannot drive.
    """
    high = nav_map.origin + np.array(nav_map.gap.shape[:0:-1]) * CELL
    x, y = (np.arange(nav_map.origin[k] + _FINE / 2, high[k], _FINE) for k in (0, 1))
    X, Y = (a.ravel() for a in np.meshgrid(x, y))
    turns = np.arange(_TURNS) * 2 * np.pi / _TURNS
    room = [
        gaps(
            np.column_stack([X, Y, np.full(X.size, t)]),
            nav_map.prisms,
            nav_map.planning_obstacles,
            cap=0.05,
        )
        for t in turns
    ]
    parts, count = label((np.array(room) > 0).reshape(_TURNS, len(y), len(x)))
    around = (parts[0] > 0) & (parts[-1] > 0)  # the last heading is next to the first one
    pairs = parts[0][around], parts[-1][around]
    ones = np.ones(len(pairs[0]))
    _, group = connected_components(coo_matrix((ones, pairs), (count + 1, count + 1)), False)

    def near(pose: np.ndarray) -> set[int]:
        i, j = np.abs(y - pose[1]).argmin(), np.abs(x - pose[0]).argmin()
        h = np.abs(wrap_angle(turns - pose[2])).argmin()
        found = parts[np.arange(h - 1, h + 2) % _TURNS, i - 1 : i + 2, j - 1 : j + 2]
        return set(group[found[found > 0]].tolist())

    return bool(near(start) & near(goal))


class People:
    """Two people who walk back and forth between free places, and stop in front of the robot.

    They treat the robot as a disc and keep a step away from it; after a long wait they turn back.
    They start at least a meter from it.
    """

    def __init__(
        self, nav_map: NavigationMap, start: Float[np.ndarray, "3"], rng: np.random.Generator
    ) -> None:
        self.robot, self.radius, self.time = start[:2], nav_map.prisms.radius, 0.0
        self.begin, self.toward, self.length = self._walks(nav_map, rng)
        self.pace = rng.uniform(*PACE, size=2)
        self.gone, self.sense, self.waited = np.zeros(2), np.ones(2), np.zeros(2)

    def _walks(
        self, nav_map: NavigationMap, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "2 2"], Float[np.ndarray, "2 2"], Float[np.ndarray, " 2"]]:
        fits = np.asarray((nav_map.gap > 0.0).any(0))
        cells = np.argwhere(fits)
        walks: list[tuple[np.ndarray, np.ndarray, float]] = []
        while len(walks) < 2:
            i, j = cells[rng.integers(len(cells), size=2)].T
            a, b = nav_map.origin + (np.stack([j, i], -1) + 0.5) * CELL
            length = float(np.hypot(*(b - a)))
            away = float(np.hypot(*(a - self.robot))) - self.radius - PERSON
            line = a + np.linspace(0, 1, 100)[:, None] * (b - a)
            column, row = np.floor((line - nav_map.origin) / CELL).astype(int).T
            if length > 1.0 and away > 1.0 and fits[row, column].all():
                walks.append((a, (b - a) / length, length))
        begin, toward, lengths = (np.array(parts) for parts in zip(*walks, strict=True))
        return begin, toward, lengths

    def meet(self, robot: Float[np.ndarray, "3"]) -> None:
        """Observe the position of the robot."""
        self.robot = robot[:2]

    def __call__(self, time: float) -> Float[np.ndarray, "2 5"]:
        """Advance to a time [s] and return the states of the people."""
        dt, self.time = time - self.time, time
        where = self.begin + self.toward * self.gone[:, None]
        to_robot = self.robot - where
        near = np.hypot(*to_robot.T) < self.radius + PERSON + AWAY
        ahead = self.sense * (to_robot * self.toward).sum(1) > 0
        stopped = near & ahead
        self.waited = np.where(stopped, self.waited + dt, 0.0)
        turned = self.waited > PATIENCE
        self.gone += np.where(stopped, 0.0, self.sense * self.pace * dt)
        at_end = (self.gone >= self.length) & (self.sense > 0)
        turned |= at_end | (self.gone <= 0) & (self.sense < 0)
        self.sense = np.where(turned, -self.sense, self.sense)
        self.waited[turned] = 0.0
        self.gone = np.clip(self.gone, 0.0, self.length)
        velocity = np.where(stopped, 0.0, self.sense * self.pace)[:, None] * self.toward
        where = self.begin + self.toward * self.gone[:, None]
        return np.column_stack([where, velocity, np.full(2, PERSON)])
