"""Reuleaux and RM4D: base poses by an inverse reachability map of the handle as it stands."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from momapos.planning.placement import arm_radius

from .placer_room import GRASP, Room

if TYPE_CHECKING:
    from jaxtyping import Float

CELL = 0.05
"""Cell of the floor [m]."""
YAWS = np.arange(-np.pi, np.pi, np.radians(10.0))
"""Base orientations in a cell (Reuleaux) [rad]."""
LEAST = 0.01
"""Cells with less than this share of the best are dropped (Reuleaux) [-]."""
HIGH = 20
"""Best cells from which is drawn at random, before the next as many (Reuleaux) [-]."""


def reuleaux(room: Room, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Cells that hold many base poses of the inverse map, drawn at random among the best.

    At a cell the base turns as most grasps are reached (GraspReachabilityScore).

    Source: Makhal and Goins, Reuleaux: Robot Base Placement by Reachability Analysis (IRC 2018),
    and the plugin's `place_base.cpp`; the random draw is MoMa-Pos's baseline.
    """
    cells = _cells(room)
    cells = cells[room.navigable(cells)]
    poses = np.column_stack([np.repeat(cells, len(YAWS), 0), np.tile(YAWS, len(cells))])
    each = np.zeros(len(poses), int)
    near = np.flatnonzero(room.within_arm(poses))
    near = near[room.stands_clear(poses[near])]
    each[near] = (room.scores(poses[near], [GRASP])[..., 0] > 0).sum(1)
    hits = each.reshape(len(cells), len(YAWS))
    count, best = hits.sum(1), hits.argmax(1)
    span = max(int(count.max(initial=0) - count.min(initial=0)), 1)
    share = (count - count.min(initial=0)) / span
    ranked = np.argsort(-share, kind="stable")
    ranked = ranked[(share[ranked] > LEAST) & (count[ranked] > 0)]
    for first in range(0, len(ranked), HIGH):
        drawn = rng.permutation(ranked[first : first + HIGH])
        yield np.column_stack([cells[drawn], YAWS[best[drawn]]])


def rm4d(room: Room, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Cells from which most grasps are within reach, the best first.

    The arm's first joint turns, so the map has no yaw: the base looks at the target.

    Source: Rudorfer, RM4D (ICRA 2025), and its code's `BasePosGrid`.
    """
    del rng
    poses = room.facing(_cells(room), room.target[:2])
    poses = poses[room.within_arm(poses)]
    poses = poses[room.navigable(poses[:, :2])]
    poses = poses[room.stands_clear(poses)]
    count = (room.scores(poses, [GRASP])[..., 0] > 0).sum(1)
    ranked = np.argsort(-count, kind="stable")
    yield poses[ranked[count[ranked] > 0]]


def _cells(room: Room) -> Float[np.ndarray, "n 2"]:
    """The floor from which the target may be within reach."""
    geometry = room.prepared.geometry
    radius = float(arm_radius(geometry)[GRASP] + np.linalg.norm(geometry.shoulder[:2]))
    return room.cells(room.target[:2], radius, CELL)
