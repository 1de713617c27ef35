"""M3*: random navigable cells of a region; for rigid targets the nearest navigable cell.

Source: Gu et al., Multi-skill Mobile Manipulation for Object Rearrangement (ICLR 2023), and its
public code: regions of the navigation skill, `SetArticulatedObjectTask`; for rigid targets
MoMa-Pos's baseline M3*.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import local_points

from .placer_room import PlacerRoom

if TYPE_CHECKING:
    from jaxtyping import Float

CELL, MAX_DISTANCE = 0.05, 2.5
"""Cell size of the navigable map and its half size around the target [m]."""
HINGED = (np.array([[0.9, -0.5], [1.8, 0.5]]), np.array([[0.8, -1.0], [2.0, 1.0]]))
"""Region for a fridge and its wider alternative, corners in the object frame [m]."""
OPEN_DRAWER = (np.array([[0.8, -0.35], [0.95, 0.35]]), np.array([[0.8, -0.6], [1.5, 0.6]]))
"""Regions to open a drawer, corners in the handle frame [m]."""
CLOSE_DRAWER = (np.array([[0.3, -0.35], [0.45, 0.35]]), np.array([[0.3, -0.6], [1.0, 0.6]]))
"""Regions to close a drawer, corners in the handle frame [m]."""
NOISE = np.array([0.05, 0.05, 0.15])
"""Standard deviation of x, y [m] and yaw [rad], truncated at two sigma."""
ROUNDING = 6
"""Decimals of a distance [m]; symmetric cells are equally near [-]."""
DRAWS, NOISE_DRAWS = 20, 10
"""Number of draws of a cell, and of the noise until the position is navigable [-]."""


def m3(room: PlacerRoom, rng: np.random.Generator) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Propose draws from the region; if none stands clear, from the wider one.

    For rigid targets propose the cells, nearest first and of equally near ones the shorter drive.
    """
    cells = room.cells(room.target[:2], MAX_DISTANCE, CELL)
    cells = cells[room.navigable(cells)]
    if not room.articulated:
        away = np.linalg.norm(cells - room.target[:2], axis=1).round(ROUNDING)
        near = np.lexsort((room.travel_cost(cells), away))
        poses = room.facing(cells[near], room.target[:2])
        yield poses[room.stands_clear(poses)]
        return
    closing = room.prepared.task.verb == "close"
    drawer = CLOSE_DRAWER if closing else OPEN_DRAWER
    frame = room.handle_frame if room.slides else room.object_frame
    local = local_points(frame, cells)
    for low, high in drawer if room.slides else HINGED:
        region = cells[((local >= low) & (local <= high)).all(1)]
        poses = _draws(room, region, frame[:2], rng)
        poses = poses[room.stands_clear(poses)]
        if len(poses):
            yield poses
            return


def _draws(
    room: PlacerRoom,
    region: Float[np.ndarray, "k 2"],
    look: Float[np.ndarray, "2"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "n 3"]:
    """Draw noisy poses at cells of a region, facing a point."""
    if not len(region):
        return np.zeros((0, 3))
    chosen = region[rng.integers(len(region), size=DRAWS)]
    noise = np.clip(rng.normal(0.0, NOISE, (DRAWS, NOISE_DRAWS, 3)), -2 * NOISE, 2 * NOISE)
    xy = chosen[:, None] + noise[..., :2]
    good = room.navigable(xy.reshape(-1, 2)).reshape(DRAWS, NOISE_DRAWS)
    first, row = good.argmax(1), np.flatnonzero(good.any(1))
    poses = room.facing(xy[row, first[row]], look)
    poses[:, 2] += noise[row, first[row], 2]
    return poses
