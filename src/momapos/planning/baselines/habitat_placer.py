"""Habitat: a fixed area in front of articulated furniture; otherwise the nearest free position.

Source: habitat-lab, `SetArticulatedObjectTask` (articulated objects) and
`place_robot_at_closest_point` (rigid objects), MoMa-Pos's baseline Habitat.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import place_points

from .placer_room import PlacerRoom

if TYPE_CHECKING:
    from jaxtyping import Float

HINGED = np.array([[0.833, -0.6], [1.25, 0.6]])
"""Base area for a fridge, corners in the object frame [m]."""
OPEN_DRAWER = np.array([[0.80, -0.35], [0.95, 0.35]])
"""Base area to open a drawer, corners in the handle frame [m]."""
CLOSE_DRAWER = np.array([[0.80, -0.35], [0.85, 0.35]])
"""Base area to close a drawer, corners in the handle frame [m]."""
DRAWS = 100
"""Number of draws from the area, after its middle [-]."""
CELL, MAX_DISTANCE = 0.05, 2.0
"""Cell size and maximum distance of the nearest navigable position [m]."""


def habitat(room: PlacerRoom, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Propose the middle of the area, then draws from it; or navigable cells, nearest first."""
    if not room.articulated:
        cells = room.cells(room.target[:2], MAX_DISTANCE, CELL)
        cells = cells[room.navigable(cells)]
        near = np.argsort(np.linalg.norm(cells - room.target[:2], axis=1), kind="stable")
        poses = room.facing(cells[near], room.target[:2])
    else:
        frame, area = _area(room)
        drawn = rng.uniform(area[0], area[1], (DRAWS, 2))
        wanted = place_points(frame[None], np.vstack([area.mean(0), drawn]))[0]
        poses = room.facing(_snapped(room, wanted), frame[:2])
        poses = poses[room.within_arm(poses)]
    yield poses[room.stands_clear(poses)]


def _area(room: PlacerRoom) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "2 2"]]:
    """Return the frame of the area and the area's corners in it."""
    if not room.slides:
        return room.object_frame, HINGED
    closing = room.prepared.task.verb == "close"
    return room.handle_frame, CLOSE_DRAWER if closing else OPEN_DRAWER


def _snapped(room: PlacerRoom, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Move positions that are not navigable to the nearest navigable cell."""
    cells = room.cells(xy.mean(0), MAX_DISTANCE, CELL)
    cells = cells[room.navigable(cells)]
    if not len(cells):
        return xy
    away = np.linalg.norm(xy[:, None] - cells[None], axis=-1)
    return np.where(room.navigable(xy)[:, None], xy, cells[away.argmin(1)])
