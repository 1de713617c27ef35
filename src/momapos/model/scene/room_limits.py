"""How large a room may be."""

from __future__ import annotations

import numpy as np

from momapos.core import SceneError

from .scene import Scene

MAX_ROOM = (50.0, 50.0, 10.0)
"""Size of what stands in a room, and of its floor [m]: the arm is kept from it on a grid of
10 cm, and driving lengths are measured on one of 5 cm."""
MAX_FILLED = 50_000.0
"""Space that all collision elements take, with `AROUND` around each [m^3]; the grid lists them."""
AROUND = 0.3


def refuse_vast(scene: Scene) -> None:
    """Refuse rooms that no grid of a planner could hold.

    Raises:
        SceneError: The room is larger than `MAX_ROOM`, or its elements take more than
            `MAX_FILLED`; the message names what lies farthest off.
        UrdfError: A mesh of an object cannot be used.
    """
    bounds = np.array([item.bounds for item in scene.objects]).reshape(-1, 2, 3)
    corners = bounds.reshape(-1, 3)
    if scene.floor_polygon is not None:
        corners = np.vstack([corners, np.pad(scene.floor_polygon, ((0, 0), (0, 1)))])
    if not len(corners):
        return
    size = np.ptp(corners, axis=0)
    if (size > MAX_ROOM).any():
        far = corners - np.median(corners, axis=0)
        worst = int(np.abs(far / MAX_ROOM).max(1).argmax()) // 2
        name = repr(scene.objects[worst].name) if worst < len(bounds) else "the floor"
        raise SceneError(
            f"{scene.path}: the room measures {' x '.join(f'{v:.4g}' for v in size)} m; at most "
            f"{' x '.join(f'{v:g}' for v in MAX_ROOM)} m are supported; look at {name}"
        )
    elements = np.array([sum(map(len, item.model.hulls.values())) for item in scene.objects])
    filled = float(elements @ np.prod(np.ptp(bounds, axis=1) + 2 * AROUND, axis=1))
    if filled > MAX_FILLED:
        raise SceneError(
            f"{scene.path}: its {elements.sum()} collision elements take {filled:.3g} m^3 with "
            f"{AROUND:g} m around each; at most {MAX_FILLED:g} m^3 are supported; use fewer"
        )
