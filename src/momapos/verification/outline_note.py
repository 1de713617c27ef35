"""Report how far a motion leaves the outline of the floor, where the scene states no walls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply
from momapos.model.scene import Scene

from .exact_shapes import Shapes
from .polygon import outside

if TYPE_CHECKING:
    from jaxtyping import Float

MIN_OUTSIDE = 0.01
"""Smaller distances outside the outline are not reported [m]."""
MAX_STATES = 100
"""Number of states that are looked at, evenly spaced; more change the distance by millimeters."""
_SHARES = (0.25, 0.5, 0.75, 1.0)
"""Points between the middle of a shape and its corners; a long link may span a notch."""
_CORNERS = np.stack(np.meshgrid(*3 * [(-1.0, 1.0)]), -1).reshape(-1, 3)


def outside_note(
    scene: Scene, moving: Sequence[tuple[Shapes, Float[np.ndarray, "_ _ 4 4"]]]
) -> str | None:
    """Return where and how far shapes leave the floor's outline; None if they stay inside.

    Points above or in the footprint of an object do not count, since no wall can be there. A scene
    with walls has solid ones, so nothing is reported.

    Args:
        scene: The scene.
        moving: Shapes and their world poses, such as those of the arm.
    """
    if scene.floor_polygon is None or scene.walls:
        return None
    spots = [_farthest(scene, *group) for group in moving]
    name, distance, point = max(spots, key=lambda spot: spot[1], default=("", 0.0, np.zeros(2)))
    if distance < MIN_OUTSIDE:
        return None
    return (
        f"{name} is up to {100 * distance:.0f} cm outside the floor's outline at "
        f'({point[0]:.2f}, {point[1]:.2f}); if there are walls, set walls = "floor" in the scene'
    )


def _farthest(
    scene: Scene, shapes: Shapes, Ts: Float[np.ndarray, "s k 4 4"]
) -> tuple[str, float, Float[np.ndarray, "2"]]:
    """Return the shape that is farthest outside, its distance [m] and its farthest point."""
    assert scene.floor_polygon is not None
    Ts = Ts[np.linspace(0, len(Ts) - 1, min(len(Ts), MAX_STATES)).round().astype(int)]
    middle = outside(scene.floor_polygon, Ts[..., :2, 3].reshape(-1, 2)).reshape(Ts.shape[:2])
    near = middle + np.linalg.norm(shapes.half, axis=1) > MIN_OUTSIDE
    worst: tuple[str, float, np.ndarray] = ("", 0.0, np.zeros(2))
    for index in np.flatnonzero(near.any(0)).tolist():
        T = Ts[near[:, index], index]
        rough = _distances(scene, T, _CORNERS * shapes.half[index])[0].max(1)
        state = int(rough.argmax())
        distance, points = _distances(scene, T[state : state + 1], shapes.outline(index))
        at = int(distance[0].argmax())
        far = float(distance[0, at]) + float(shapes.ball[index])
        if far > worst[1]:
            worst = shapes.names[index], far, points[0, at]
    return worst


def _distances(
    scene: Scene, Ts: Float[np.ndarray, "s 4 4"], corners: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "s m"], Float[np.ndarray, "s m 2"]]:
    """Return the distances of points of a shape from the outline [m], and the points.

    Args:
        scene: The scene.
        Ts: World poses of the shape.
        corners: Points whose hull it is, around the origin [m].
    """
    assert scene.floor_polygon is not None
    local = (np.array(_SHARES)[:, None, None] * corners).reshape(-1, 3)
    points = np.asarray(apply(Ts, local))[..., :2]
    flat = points.reshape(-1, 2)
    distance = outside(scene.floor_polygon, flat)
    for item in scene.objects:
        low, high = item.bounds[:, :2]
        distance[((low <= flat) & (flat <= high)).all(1)] = -np.inf
    return distance.reshape(points.shape[:2]), points
