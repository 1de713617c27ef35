"""Choose where a robot starts in a scanned room: on floor that the cameras were carried over."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from momapos.core.geometry import UprightBox, bottom, to_local, top
from momapos.model.records import Frame

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

CELL = 0.05
"""Edge of a cell of the floor [m]."""
MAX_FLOOR = 100.0
"""Larger rooms have no start [m]."""
LOW, HIGH = 0.05, 1.5
"""Boxes between these heights are in the way [m]; hanging cabinets are above counters."""
RADII = (0.45, 0.35, 0.25)
"""Radii of bases that must be able to drive from the start, the first that works is used [m]."""
WALKED = 0.3
"""Cells this close to the path of the camera were walked over [m]."""
MAX_STEP = 1.5
"""Two images farther apart show no path between them [m]."""
ROOMY = 1.0
"""More clearance than this is no advantage [m]; bases and arms at home reach about as far."""

CENTRAL = 0.05
"""Clearance that one meter closer to the middle of the free floor is worth [-]."""


def start_place(
    boxes: Sequence[UprightBox], floor: Sequence[tuple[float, float]], frames: Sequence[Frame]
) -> tuple[float, float, float] | None:
    """Return a free place with much clearance that is connected to most of the room.

    Args:
        boxes: All objects and walls.
        floor: Corners of the scanned rectangle [m].
        frames: With poses in the upright world. If they were carried over no free floor of the
            room, any place is taken.

    Returns:
        x [m], y [m], yaw [rad]: where the nearest camera looked; None if the floor has no room.
    """
    low, high = np.min(floor, axis=0), np.max(floor, axis=0)
    if (high - low).max() > MAX_FLOOR or (high - low).min() < 2 * CELL:
        return None
    steps = [np.arange(a + CELL / 2, b, CELL) for a, b in zip(low, high, strict=True)]
    cells = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1)
    clearance = _clearance(cells, boxes)
    cameras = np.array([frame.T_world_camera[:3, 3] for frame in frames]).reshape(-1, 3)
    walked = _walked(cells, cameras[:, :2])
    for near, radius in product((walked, np.ones_like(walked)), RADII):
        label, count = ndimage.label(clearance > radius)
        area = np.bincount(label.ravel(), minlength=count + 1)
        area = np.where(np.bincount(label[near], minlength=count + 1) > 0, area, 0)[1:]
        if area.any():
            part = label == 1 + int(np.argmax(area))
            away = np.linalg.norm(cells - cells[part].mean(axis=0), axis=-1)
            value = np.minimum(clearance, ROOMY) - CENTRAL * away
            place = cells.reshape(-1, 2)[np.argmax(np.where(part & near, value, -np.inf))]
            return float(place[0]), float(place[1]), _yaw(place, frames)
    return None


def _clearance(
    cells: Float[np.ndarray, "x y 2"], boxes: Sequence[UprightBox]
) -> Float[np.ndarray, "x y"]:
    """Return the distance to the nearest box, or to the end of the floor [m]."""
    points = np.concatenate([cells.reshape(-1, 2), np.zeros((cells[..., 0].size, 1))], axis=1)
    free = np.ones(len(points), bool)
    for box in boxes:
        if bottom(box) < HIGH and top(box) > LOW:
            inside = np.abs(to_local(points, box)[:, :2]) <= box.size[:2] / 2
            free &= ~inside.all(axis=1)
    padded = np.pad(free.reshape(cells.shape[:2]), 1)
    return CELL * ndimage.distance_transform_edt(padded)[1:-1, 1:-1]


def _walked(
    cells: Float[np.ndarray, "x y 2"], path: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, "x y"]:
    """Return the cells near the path of the camera."""
    if not len(path):
        return np.zeros(cells.shape[:2], bool)
    parts = np.linspace(0.0, 1.0, int(MAX_STEP / WALKED) + 1)
    between = path[:-1, None] + parts[:, None] * np.diff(path, axis=0)[:, None]
    short = np.linalg.norm(np.diff(path, axis=0), axis=1) <= MAX_STEP
    places = np.concatenate([path, between[short].reshape(-1, 2)])
    low = cells[0, 0] - CELL / 2
    index = np.floor((places - low) / CELL).astype(int)
    index = index[((index >= 0) & (index < cells.shape[:2])).all(axis=1)]
    away = np.ones(cells.shape[:2], bool)
    away[tuple(index.T)] = False
    if away.all():
        return ~away
    return CELL * ndimage.distance_transform_edt(away) <= WALKED


def _yaw(place: Float[np.ndarray, "2"], frames: Sequence[Frame]) -> float:
    if not frames:
        return 0.0
    nearest = min(frames, key=lambda f: float(np.hypot(*(f.T_world_camera[:2, 3] - place))))
    x, y = nearest.T_world_camera[:2, 2]
    return float(np.arctan2(y, x))
