"""M3: cells of a navigable map in a region, drawn at random, with the noise of its skills' starts.

Source: Gu et al., Multi-skill Mobile Manipulation for Object Rearrangement (ICLR 2023), and its
public code: regions of the navigation skill, `SetArticulatedObjectTask`, `RearrangePickTask`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import local_points

from .placer_room import Room

if TYPE_CHECKING:
    from jaxtyping import Float

CELL, AROUND = 0.05, 2.5
"""Cell of the navigable map, and how far around the target it is looked at [m]."""
HINGED = (np.array([[0.9, -0.5], [1.8, 0.5]]), np.array([[0.8, -1.0], [2.0, 1.0]]))
"""Region in the frame of a fridge, and the one taken where that is too crowded [m]."""
OPEN_DRAWER = (np.array([[0.8, -0.35], [0.95, 0.35]]), np.array([[0.8, -0.6], [1.5, 0.6]]))
"""The same for a drawer that is shut, in the frame of its handle [m]."""
CLOSE_DRAWER = (np.array([[0.3, -0.35], [0.45, 0.35]]), np.array([[0.3, -0.6], [1.0, 0.6]]))
"""The same for a drawer that is open [m]."""
RADII = np.arange(0.8, 2.0 + 1e-9, 0.1)
"""Distances from a rigid target, the first that has a navigable cell [m]."""
NOISE = np.array([0.05, 0.05, 0.15])
"""Standard deviation of x, y [m] and yaw [rad], cut at twice that."""
TRIES, AGAIN = 20, 10
"""Draws of a cell, and of the noise until the place is navigable [-]."""


def m3(room: Room, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Draws from the region; where none stands clear, from the wider one."""
    cells = room.cells(room.target[:2], AROUND, CELL)
    cells = cells[room.navigable(cells)]
    look = room.target[:2]
    regions: list[Float[np.ndarray, "k 2"]] = []
    if room.articulated:
        closing = room.prepared.task.verb == "close"
        drawer = CLOSE_DRAWER if closing else OPEN_DRAWER
        frame = room.handle_frame if room.slides else room.object_frame
        look = frame[:2]
        local = local_points(frame, cells)
        for low, high in drawer if room.slides else HINGED:
            regions.append(cells[((local >= low) & (local <= high)).all(1)])
    else:
        away = np.linalg.norm(cells - look, axis=1)
        radius = next((r for r in RADII if (away <= r).any()), RADII[-1])
        regions.append(cells[away <= radius])
    for region in regions:
        poses = _draws(room, region, look, rng)
        poses = poses[room.stands_clear(poses)]
        if len(poses):
            yield poses
            return


def _draws(
    room: Room,
    region: Float[np.ndarray, "k 2"],
    look: Float[np.ndarray, "2"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "n 3"]:
    """Noisy poses at cells drawn from a region, looking at a point."""
    if not len(region):
        return np.zeros((0, 3))
    chosen = region[rng.integers(len(region), size=TRIES)]
    noise = np.clip(rng.normal(0.0, NOISE, (TRIES, AGAIN, 3)), -2 * NOISE, 2 * NOISE)
    there = chosen[:, None] + noise[..., :2]
    good = room.navigable(there.reshape(-1, 2)).reshape(TRIES, AGAIN)
    first, row = good.argmax(1), np.flatnonzero(good.any(1))
    poses = room.facing(there[row, first[row]], look)
    poses[:, 2] += noise[row, first[row], 2]
    return poses
