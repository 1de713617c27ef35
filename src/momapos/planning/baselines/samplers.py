"""pycram, BEHAVIOR and MoMaGen: poses around the handle that pass the method's own check."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import local_points
from momapos.planning.placement import sees

from .placer_room import GRASP_WAYPOINT, PlacerRoom

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

CELL, SIDE, SAMPLES = 0.02, 4.0, 600
"""Cell size and side of the cost map [m], and number of its best cells tried (pycram) [-]."""
STRIP = 0.2
"""Half width of a drawer's path, which is excluded from the map (pycram) [m]."""
PART_OPEN = 1 / 1.5
"""Share of the opening at the second pose that must be reached (pycram) [-]."""
MAX_DISTANCE, DRAWS = 1.5, 200
"""Maximum distance from the handle [m], and number of draws (BEHAVIOR) [-]."""
FLOOR_DRAWS = 20
"""Number of draws until the position is on the floor (BEHAVIOR) [-]."""
ROUNDS, SUBSET = 3, 8
"""Number of calls of the sampler, and of waypoints that must be reached (MoMaGen) [-]."""
_BATCH = 20
"""Poses checked together [-]."""


def pycram(room: PlacerRoom, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Propose the free cells nearest to the handle that reach it closed, partly open and open.

    The cost map is the navigable area times a Gaussian around the handle, so its best cells are the
    nearest.

    Source: pycram, `AccessingLocation` and `CostmapLocation`.
    """
    del rng
    target = room.target[:2]
    last = room.Ts_world_tool.shape[1] - 1
    part = GRASP_WAYPOINT + round((last - GRASP_WAYPOINT) * PART_OPEN)
    steps = sorted({GRASP_WAYPOINT, part, last}) if room.articulated else list(range(last + 1))
    look = room.Ts_world_tool[0, part, :2, 3] if room.articulated else target
    cells = room.cells(target, SIDE / 2, CELL)
    cells = cells[room.navigable(cells)]
    if room.slides:
        cells = cells[~_in_drawer_path(room, cells)]
    away = np.linalg.norm(cells - target, axis=1)
    cells = cells[np.argsort(away, kind="stable")[:SAMPLES]]
    yield from _that_reach(room, room.facing(cells, look), steps)


def behavior(room: PlacerRoom, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Propose draws around the handle from which the grasp is within reach.

    Source: OmniGibson (BEHAVIOR-1K), `StarterSemanticActionPrimitives._sample_pose_near_object`.
    """
    yield from _that_reach(room, _around(room, rng), [GRASP_WAYPOINT])


def momagen(room: PlacerRoom, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Propose draws around the handle that see it and reach it during the whole motion.

    Source: MoMaGen (2025), `WaypointTrajectory.execute`: BEHAVIOR's sampler, called again if it
    fails, with eight poses of the motion and the camera's view.
    """
    steps = np.unique(np.linspace(0, room.Ts_world_tool.shape[1] - 1, SUBSET).astype(int)).tolist()
    for _ in range(ROUNDS):
        poses = _around(room, rng)
        yield from _that_reach(room, poses[_in_view(room, poses)], steps)


def _that_reach(
    room: PlacerRoom, poses: Float[np.ndarray, "n 3"], waypoints: Sequence[int]
) -> Iterator[Float[np.ndarray, "k 3"]]:
    """Yield the poses that stand clear and have a grasp at some waypoints, in order."""
    for first in range(0, len(poses), _BATCH):
        some = poses[first : first + _BATCH]
        some = some[room.stands_clear(some)]
        if len(some):
            yield some[room.holds_at(some, waypoints)]


def _around(room: PlacerRoom, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Draw poses on the floor at uniform distances and angles from the target, facing it."""
    target = room.target[:2]
    away = rng.uniform(0.0, MAX_DISTANCE, (DRAWS, FLOOR_DRAWS))
    angle = rng.uniform(-np.pi, np.pi, (DRAWS, FLOOR_DRAWS))
    xy = target + away[..., None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    inside = room.on_floor(xy.reshape(-1, 2)).reshape(DRAWS, FLOOR_DRAWS)
    return room.facing(xy[np.arange(DRAWS), inside.argmax(1)], target)


def _in_view(room: PlacerRoom, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Check that nothing static hides the handle from the robot's head."""
    eyes = np.column_stack([poses[:, :2], np.full(len(poses), room.eye_height)])
    return sees(eyes, room.target[None], room.prepared.motion.static)[:, 0]


def _in_drawer_path(room: PlacerRoom, cells: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
    """Check whether cells lie on the path of a drawer's handle."""
    begin, end = room.Ts_world_tool[0, [GRASP_WAYPOINT, -1], :2, 3]
    path = end - begin
    local = local_points(np.append(begin, np.arctan2(path[1], path[0])), cells)
    along = (local[:, 0] >= 0) & (local[:, 0] <= np.linalg.norm(path))
    return along & (np.abs(local[:, 1]) <= STRIP)
