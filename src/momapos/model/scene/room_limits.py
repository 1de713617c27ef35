"""Limits of the size of a room."""

from __future__ import annotations

import numpy as np

from momapos.core import SceneError

from .scene import Scene
from .usual_sizes import FLOOR_EDGE, size_hint, usual_edge

MAX_ROOM = (50.0, 50.0, 10.0)
"""Maximum size of a room with its floor [m]: clearance uses a grid of 10 cm, driving one of
5 cm."""
MAX_FILLED_VOLUME = 50_000.0
"""Maximum volume of all collision elements, each with `FILL_MARGIN` around it [m^3]; a grid lists
them."""
FILL_MARGIN = 0.3


def check_room_size(scene: Scene) -> None:
    """Refuse rooms that are too large for the planner's grids.

    Raises:
        SceneError: The room is larger than `MAX_ROOM`, or its elements fill more than
            `MAX_FILLED_VOLUME`; the message names the farthest object.
        UrdfError: A mesh of an object is invalid.
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
        raise SceneError(
            f"{scene.path}: the room measures {' x '.join(f'{v:.4g}' for v in size)} m; at most "
            f"{' x '.join(f'{v:g}' for v in MAX_ROOM)} m are supported; check "
            + _suspect(scene, worst)
        )
    elements = np.array([sum(map(len, item.model.hulls.values())) for item in scene.objects])
    filled = float(elements @ np.prod(np.ptp(bounds, axis=1) + 2 * FILL_MARGIN, axis=1))
    if filled > MAX_FILLED_VOLUME:
        raise SceneError(
            f"{scene.path}: its {elements.sum()} collision elements fill {filled:.3g} m^3 with "
            f"{FILL_MARGIN:g} m around each; at most {MAX_FILLED_VOLUME:g} m^3 are supported; use "
            "fewer elements"
        )


def _suspect(scene: Scene, index: int) -> str:
    """Return the object at an index, or the floor, with a hint at the unit of its size."""
    if index < len(scene.objects):
        item = scene.objects[index]
        name, size = repr(item.name), np.ptp(item.bounds, axis=0)
        usual = usual_edge(item.category, item.name, jointed=bool(item.model.joints))
    else:
        assert scene.floor_polygon is not None
        name, size, usual = "the floor", np.ptp(scene.floor_polygon, axis=0), FLOOR_EDGE
    hint = size_hint(size.tolist(), usual)
    measures = " x ".join(f"{v:.4g}" for v in size)
    return f"{name}, which measures {measures} m; {hint}" if hint else name
