"""pycram, BEHAVIOR and MoMaGen: poses around the handle that pass a check of their own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import local_points
from momapos.planning.placement import sees

from .placer_room import GRASP, Room

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

CELL, SIDE, SAMPLES = 0.02, 4.0, 600
"""Cell and side of the cost map [m], and how many of its best cells are tried (pycram) [-]."""
STRIP = 0.2
"""Half width of what a drawer's way takes out of the map (pycram) [m]."""
PART_OPEN = 1 / 1.5
"""How far the part is open at the second pose that must be reached (pycram) [-]."""
FARTHEST, TRIES = 1.5, 200
"""Distance from the handle up to which is drawn [m], and how often (BEHAVIOR) [-]."""
ROOM_TRIES = 20
"""Draws until the place is in the room (BEHAVIOR) [-]."""
ROUNDS, SUBSET = 3, 8
"""Times the sampler is asked, and waypoints that must be reached (MoMaGen) [-]."""
_BATCH = 20
"""Poses whose check is made together [-]."""


def pycram(room: Room, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """The free cells nearest to the handle, from where it is in reach shut, part open and open.

    The cost map is what is navigable times a Gaussian around the handle, so its best cells are the
    nearest.

    Source: pycram, `AccessingLocation` and `CostmapLocation`.
    """
    del rng
    target = room.target[:2]
    last = room.Ts_world_tool.shape[1] - 1
    part = GRASP + round((last - GRASP) * PART_OPEN)
    steps = sorted({GRASP, part, last}) if room.articulated else list(range(last + 1))
    look = room.Ts_world_tool[0, part, :2, 3] if room.articulated else target
    cells = room.cells(target, SIDE / 2, CELL)
    cells = cells[room.navigable(cells)]
    if room.slides:
        cells = cells[~_in_drawers_way(room, cells)]
    away = np.linalg.norm(cells - target, axis=1)
    cells = cells[np.argsort(away, kind="stable")[:SAMPLES]]
    yield from _that_hold(room, room.facing(cells, look), steps)


def behavior(room: Room, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Places drawn around the handle, from where it is in reach as it stands.

    Source: OmniGibson (BEHAVIOR-1K), `StarterSemanticActionPrimitives._sample_pose_near_object`.
    """
    yield from _that_hold(room, _around(room, rng), [GRASP])


def momagen(room: Room, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Places drawn around the handle, from where it is in reach all along and in view.

    Source: MoMaGen (2025), `WaypointTrajectory.execute`: BEHAVIOR's sampler, asked again where it
    fails, with eight poses of the motion and the camera's view.
    """
    steps = np.unique(np.linspace(0, room.Ts_world_tool.shape[1] - 1, SUBSET).astype(int)).tolist()
    for _ in range(ROUNDS):
        poses = _around(room, rng)
        yield from _that_hold(room, poses[_in_view(room, poses)], steps)


def _that_hold(
    room: Room, poses: Float[np.ndarray, "n 3"], waypoints: Sequence[int]
) -> Iterator[Float[np.ndarray, "k 3"]]:
    """Those that stand clear and from where the hand gets hold at some waypoints, in order."""
    for first in range(0, len(poses), _BATCH):
        some = poses[first : first + _BATCH]
        some = some[room.stands_clear(some)]
        if len(some):
            yield some[room.holds_at(some, waypoints)]


def _around(room: Room, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Poses at uniform distances and angles from the target, looking at it, in the room."""
    target = room.target[:2]
    away = rng.uniform(0.0, FARTHEST, (TRIES, ROOM_TRIES))
    angle = rng.uniform(-np.pi, np.pi, (TRIES, ROOM_TRIES))
    xy = target + away[..., None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    inside = room.on_floor(xy.reshape(-1, 2)).reshape(TRIES, ROOM_TRIES)
    return room.facing(xy[np.arange(TRIES), inside.argmax(1)], target)


def _in_view(room: Room, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """From where nothing that stands still hides the handle from the robot's head."""
    eyes = np.column_stack([poses[:, :2], np.full(len(poses), room.eye_height)])
    return sees(eyes, room.target[None], room.prepared.motion.static)[:, 0]


def _in_drawers_way(room: Room, cells: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
    """Cells between where a drawer's handle is and where it goes."""
    begin, end = room.Ts_world_tool[0, [GRASP, -1], :2, 3]
    way = end - begin
    local = local_points(np.append(begin, np.arctan2(way[1], way[0])), cells)
    along = (local[:, 0] >= 0) & (local[:, 0] <= np.linalg.norm(way))
    return along & (np.abs(local[:, 1]) <= STRIP)
