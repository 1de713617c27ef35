"""Exits of a start or goal: poses from which the lattice can be entered, and the paths to them.

A base close to furniture can neither turn on the spot nor drive to the center of a cell. It backs
out straight. If a wall runs along its side, that does not help and it shuffles: it turns as far as
the clearance allows, drives, and turns again. A car-like base turns on arcs. The path to the
goal is the same in reverse.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import wrap_angle

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Float, Int

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
