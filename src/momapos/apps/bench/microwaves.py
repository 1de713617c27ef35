"""Put a microwave with a left-hinged door on a countertop of a generated kitchen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from momapos.model.scene.library import (
    Box,
    FurniturePart,
    JointMotion,
    Piece,
    Vec,
    bar_handle,
    hits,
    obstacles,
    solid,
    vec,
)

MICROWAVE = "microwave"
MIN_SIZE, MAX_SIZE = (0.46, 0.36, 0.27), (0.54, 0.42, 0.32)
"""Width, depth and height of household microwaves [m]."""
WALL, DOOR, PANEL, GAP = 0.02, 0.03, 0.1, 0.0015
"""Thickness of the walls and of the door, width of the control panel on the right, and the gap
around the door [m]."""
HANDLE_EDGE = 0.04
"""Distance of the handle's middle from the free edge of the door [m]."""
BACK_DISTANCE = 0.03
"""Distance from the back of the countertop [m]."""
OPENING = 1.9
"""Upper joint limit [rad]; the tasks open doors by 90 degrees."""
MAX_DRAWS = 60


def microwave_on(
    tops: Sequence[tuple[Piece, Box]], pieces: Sequence[Piece], rng: np.random.Generator
) -> tuple[Piece, Piece] | None:
    """Draw a microwave at the back of a countertop, with clearance for its door.

    Args:
        tops: Countertops, each with its upper box.
        pieces: The furniture of the room.
        rng: Source of randomness.

    Returns:
        The microwave, and the box in front of it that the door needs; None if no draw fits.
    """
    others = obstacles(pieces)
    for _ in range(MAX_DRAWS if tops else 0):
        holder, top = tops[int(rng.integers(len(tops)))]
        size = vec(rng.uniform(MIN_SIZE, MAX_SIZE).round(2))
        (x0, y0, _), (x1, y1, z) = top.low, top.high
        room = (x1 - x0 - size[0]) / 2
        if room < 0.0 or y1 - y0 < size[1] + BACK_DISTANCE:
            continue
        x = (x0 + x1) / 2 + rng.uniform(-room, room)
        y = y1 - BACK_DISTANCE - size[1] / 2
        c, s = np.cos(holder.yaw), np.sin(holder.yaw)
        at = np.add(holder.xyz, [c * x - s * y, s * x + c * y, z + 0.001])
        oven = microwave(size, vec(at), holder.yaw)
        values = np.linspace(0.0, OPENING, 61)
        if not any(hits(oven, part, values, others).any() for part in oven.parts):
            return oven, _swing(size, vec(at), holder.yaw)
    return None


def microwave(size: Vec, xyz: Vec, yaw: float) -> Piece:
    """Build a microwave: an open shell, a control panel on the right, a door hinged on the left.

    Args:
        size: Width, depth with the door, height [m].
        xyz: Middle of its bottom [m].
        yaw: Rotation about z; it faces its own -y [rad].
    """
    half, front, height = size[0] / 2, -size[1] / 2, size[2]
    back, face, right = -front, front + DOOR, half - PANEL
    body = (
        Box("bottom", vec((-half, face, 0.0)), vec((half, back, WALL))),
        Box("top", vec((-half, face, height - WALL)), vec((half, back, height))),
        Box("left", vec((-half, face, WALL)), vec((-half + WALL, back, height - WALL))),
        Box("panel", vec((right, front, WALL)), vec((half, back, height - WALL))),
        Box("back", vec((-half, back - WALL, WALL)), vec((half, back, height - WALL))),
    )
    edge = right - GAP
    door = Box("front", vec((-half, front, WALL)), vec((edge, face - GAP, height - WALL)))
    handle = bar_handle(
        "door", edge - HANDLE_EDGE, height / 2, height - 6 * WALL, upright=True, front=front
    )
    swing = JointMotion("revolute", vec((-half, front, 0.0)), (0.0, 0.0, -1.0), OPENING)
    parts = (FurniturePart("body", body), FurniturePart("door", (door,), swing, handle))
    return Piece(MICROWAVE, MICROWAVE, xyz, yaw, parts)


def _swing(size: Vec, xyz: Vec, yaw: float) -> Piece:
    """Return the box in front of a microwave that its door passes."""
    reach = size[0] - PANEL
    c, s = np.cos(yaw), np.sin(yaw)
    y = -(size[1] + reach) / 2
    center = np.add(xyz, [-s * y, c * y, size[2] / 2])
    return solid("", "", vec((size[0] + 2 * WALL, reach, size[2])), vec(center), yaw)
