"""Habitat: an area in front of the furniture, set once for all; else the nearest free place.

Source: habitat-lab, `SetArticulatedObjectTask` (articulated objects) and
`place_robot_at_closest_point` (all else), which MoMa-Pos takes for its baseline Habitat.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import place_points

from .placer_room import Room

if TYPE_CHECKING:
    from jaxtyping import Float

HINGED = np.array([[0.833, -0.6], [1.25, 0.6]])
"""Where to stand for a fridge, in the frame of the object [m]."""
OPEN_DRAWER = np.array([[0.80, -0.35], [0.95, 0.35]])
"""Where to stand for a drawer that is shut, in the frame of its handle [m]."""
CLOSE_DRAWER = np.array([[0.80, -0.35], [0.85, 0.35]])
"""Where to stand for a drawer that is open, in the frame of its handle [m]."""
TRIES = 100
"""Draws from that area after its middle [-]."""
CELL, AROUND = 0.05, 2.0
"""Cell in which the nearest navigable place is looked for, and how far away [m]."""


def habitat(room: Room, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """The middle of the area, then draws from it; or the navigable places, nearest first."""
    if not room.articulated:
        cells = room.cells(room.target[:2], AROUND, CELL)
        cells = cells[room.navigable(cells)]
        near = np.argsort(np.linalg.norm(cells - room.target[:2], axis=1), kind="stable")
        poses = room.facing(cells[near], room.target[:2])
    else:
        frame, area = _area(room)
        drawn = rng.uniform(area[0], area[1], (TRIES, 2))
        wanted = place_points(frame[None], np.vstack([area.mean(0), drawn]))[0]
        poses = room.facing(_snapped(room, wanted), frame[:2])
        poses = poses[room.within_arm(poses)]
    yield poses[room.stands_clear(poses)]


def _area(room: Room) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "2 2"]]:
    """The frame of the area, and its corners in it."""
    if not room.slides:
        return room.object_frame, HINGED
    closing = room.prepared.task.verb == "close"
    return room.handle_frame, CLOSE_DRAWER if closing else OPEN_DRAWER


def _snapped(room: Room, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """The navigable position nearest to each; positions that are navigable stay."""
    cells = room.cells(xy.mean(0), AROUND, CELL)
    cells = cells[room.navigable(cells)]
    if not len(cells):
        return xy
    away = np.linalg.norm(xy[:, None] - cells[None], axis=-1)
    return np.where(room.navigable(xy)[:, None], xy, cells[away.argmin(1)])
