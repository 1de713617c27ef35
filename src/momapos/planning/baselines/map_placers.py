"""Reuleaux and RM4D: base poses by an inverse reachability map at the grasp."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from momapos.planning.placement import arm_radius

from .placer_room import GRASP_WAYPOINT, PlacerRoom

if TYPE_CHECKING:
    from jaxtyping import Float

CELL = 0.05
"""Cell size of the floor [m]."""
YAWS = np.arange(-np.pi, np.pi, np.radians(10.0))
"""Base orientations in a cell (Reuleaux) [rad]."""
MIN_SHARE = 0.01
"""Minimum score of a cell as a share of the best (Reuleaux) [-]."""
GROUP = 20
"""Cells are ranked in groups of this size; the order within a group is random (Reuleaux) [-]."""


def reuleaux(room: PlacerRoom, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Propose cells with many base poses of the inverse map, drawn at random among the best.

    At each cell the base has the yaw that reaches most grasps (GraspReachabilityScore).

    Source: Makhal and Goins, Reuleaux: Robot Base Placement by Reachability Analysis (IRC 2018),
    and the plugin's `place_base.cpp`; the random draw is MoMa-Pos's baseline.
    """
    cells = _cells(room)
    cells = cells[room.navigable(cells)]
    poses = np.column_stack([np.repeat(cells, len(YAWS), 0), np.tile(YAWS, len(cells))])
    each = np.zeros(len(poses), int)
    near = np.flatnonzero(room.within_arm(poses))
    near = near[room.stands_clear(poses[near])]
    each[near] = (room.scores(poses[near], [GRASP_WAYPOINT])[..., 0] > 0).sum(1)
    hits = each.reshape(len(cells), len(YAWS))
    count, best = hits.sum(1), hits.argmax(1)
    span = max(int(count.max(initial=0) - count.min(initial=0)), 1)
    share = (count - count.min(initial=0)) / span
    ranked = np.argsort(-share, kind="stable")
    ranked = ranked[(share[ranked] > MIN_SHARE) & (count[ranked] > 0)]
    for first in range(0, len(ranked), GROUP):
        drawn = rng.permutation(ranked[first : first + GROUP])
        yield np.column_stack([cells[drawn], YAWS[best[drawn]]])


def rm4d(room: PlacerRoom, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Propose the cells from which most grasps are within reach, the best first.

    The arm's first joint turns, so the map has no yaw: the base faces the target.

    Source: Rudorfer, RM4D (ICRA 2025), and its code's `BasePosGrid`.
    """
    del rng
    poses = room.facing(_cells(room), room.target[:2])
    poses = poses[room.within_arm(poses)]
    poses = poses[room.navigable(poses[:, :2])]
    poses = poses[room.stands_clear(poses)]
    count = (room.scores(poses, [GRASP_WAYPOINT])[..., 0] > 0).sum(1)
    ranked = np.argsort(-count, kind="stable")
    yield poses[ranked[count[ranked] > 0]]


def _cells(room: PlacerRoom) -> Float[np.ndarray, "n 2"]:
    """Return the floor cells from which the target may be within reach."""
    geometry = room.prepared.geometry
    radius = float(arm_radius(geometry)[GRASP_WAYPOINT] + np.linalg.norm(geometry.shoulder[:2]))
    return room.cells(room.target[:2], radius, CELL)
