"""How a pose off the lattice is left: poses from which the lattice can be entered, and their paths.

A base that stands close to furniture cannot turn at once, nor go for the center of a cell. It backs
out straight; where a wall runs along its side that gains nothing, and it shuffles: it turns by the
little that there is room for, drives on, turns again. The goal is left likewise, in reverse.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import wrap_angle

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Float, Int

    Joined = Callable[
        [Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], bool], Float[np.ndarray, " n"]
    ]
    """Cost of the simple path from each pose to another [m], and whether it may keep the smaller
    gap that the start or goal has."""

AHEAD = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2])
"""How far a pose is left straight [m]."""
_SLIGHTLY = np.radians([0.0, 0.7, -0.7, 1.5, -1.5, 3.0, -3.0, 6.0, -6.0, 12.0, -12.0])
"""Turns before a stretch of shuffling [rad]; the lattice's headings are 8 to 18 degrees apart."""
_STRETCHES = 4
"""Stretches of shuffling at most [-]."""
_KEPT = 16
"""Poses with the most room from which shuffling goes on after each stretch [-]."""
_ALIKE = 0.1, np.radians(5.0)
"""Of poses that differ by less only one is kept [m], [rad]."""


@dataclass(frozen=True, eq=False)
class Exits:
    """Poses around a start or goal, in a tree whose root is that pose itself, at index 0."""

    poses: Float[np.ndarray, "n 3"]
    cost: Float[np.ndarray, " n"]
    """Of the path between the root and each [m]."""
    parent: Int[np.ndarray, " n"]
    """The pose before each on the path from the root; -1 for the root."""

    def path(self, index: int) -> Float[np.ndarray, "k 3"]:
        """Poses from the root to one of them, without the root."""
        path = []
        while index > 0:
            path.append(self.poses[index])
            index = int(self.parent[index])
        return np.array(path[::-1]).reshape(-1, 3)

    def near_root(self) -> np.ndarray:
        """Which poses are the root or next to it, where the smaller gap will do."""
        return self.parent <= 0


def straight(pose: Float[np.ndarray, "3"], sides: int, joined: Joined) -> Exits:
    """Leave a pose along its heading, backwards, and, with four sides, sideways.

    Args:
        pose: The start or goal.
        sides: 2 for a base that drives along its heading, 4 for an omni base.
        joined: See `Joined`.
    """
    ends = _stretches(pose[None], np.zeros(1), sides)[0]
    cost = joined(np.broadcast_to(pose, ends.shape), ends, True)
    good = np.isfinite(cost)
    return Exits(
        np.concatenate([pose[None], ends[good]]),
        np.concatenate([[0.0], cost[good]]),
        np.concatenate([[-1], np.zeros(int(good.sum()), int)]),
    )


def shuffled(
    pose: Float[np.ndarray, "3"],
    sides: int,
    joined: Joined,
    room: Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, " n"]],
    needed: float,
) -> Exits:
    """Leave a pose by slight turns and straight stretches, toward where there is room.

    Args:
        pose, sides, joined: See `straight`.
        room: Gap around the robot at poses [m].
        needed: Gap that every pose needs but those next to the start or goal [m].
    """
    poses, cost, parent = pose[None], np.zeros(1), np.array([-1])
    level = np.array([0])
    for stretch in range(_STRETCHES):
        ends = _stretches(poses[level], _SLIGHTLY, sides)
        before = np.repeat(level, ends.shape[1])
        ends = ends.reshape(-1, 3)
        free = room(ends)
        # Where the base does not fit no path ends; next to the root a smaller gap may do.
        good = np.flatnonzero(free >= (0.0 if stretch == 0 else needed))
        total = cost[before[good]] + joined(poses[before[good]], ends[good], stretch == 0)
        good, total = good[np.isfinite(total)], total[np.isfinite(total)]
        best = _best(ends[good], free[good], total)
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
    """Poses that are a turn and then a straight stretch away from others."""
    side = np.arange(sides) * 2 * np.pi / sides
    heading = wrap_angle(poses[:, 2, None] + turns)[:, :, None, None]
    along = heading + side[:, None]
    x = poses[:, 0, None, None, None] + AHEAD * np.cos(along)
    y = poses[:, 1, None, None, None] + AHEAD * np.sin(along)
    ends = np.stack([x, y, np.broadcast_to(heading, x.shape)], -1)
    return ends.reshape(len(poses), -1, 3)


def _best(
    poses: Float[np.ndarray, "n 3"], room: Float[np.ndarray, " n"], cost: Float[np.ndarray, " n"]
) -> Int[np.ndarray, " k"]:
    """Indices of those with the most room, no two alike; of equal ones the cheapest."""
    order = np.lexsort((cost, -np.round(room, 3)))
    cell = np.floor(poses[order] / [_ALIKE[0], _ALIKE[0], _ALIKE[1]])
    _, first = np.unique(cell, axis=0, return_index=True)
    return np.asarray(order[np.sort(first)[:_KEPT]])
