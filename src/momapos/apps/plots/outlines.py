"""Shapes from above: convex outlines, and the drawing of their union."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from momapos.core.geometry import signed_area
from momapos.model.urdf import Boxes

if TYPE_CHECKING:
    from jaxtyping import Float

_CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T


def box_corners(boxes: Boxes) -> Float[np.ndarray, "b 8 3"]:
    """Return the corners of boxes [m]; the coordinates vary from y (slowest) over x to z."""
    scaled = _CORNERS[None] * boxes.half[:, None]
    return np.einsum("bij,bcj->bci", boxes.rotation, scaled) + boxes.center[:, None]


def outline(points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "k 2"] | None:
    """Return the counterclockwise convex outline of points from above; None without an area."""
    try:
        xy = points[ConvexHull(points[:, :2]).vertices, :2]
    except (QhullError, ValueError):
        return None
    return xy if signed_area(xy) > 0 else xy[::-1]


def box_outlines(boxes: Boxes) -> list[Float[np.ndarray, "_ 2"]]:
    """Return the outline of each box from above [m]."""
    corners, upright = box_corners(boxes), _upright_outlines(boxes)
    found = [
        upright[b] if upright[b] is not None else outline(corners[b]) for b in range(len(boxes))
    ]
    return [xy for xy in found if xy is not None]


def _upright_outlines(boxes: Boxes) -> list[Float[np.ndarray, "4 2"] | None]:
    """Return the rectangles of boxes that stand on a side; None for the others."""
    each = np.arange(len(boxes))
    up = np.abs(boxes.rotation[:, 2]).argmax(1) if len(boxes) else each
    a, b = (
        boxes.rotation[each, :2, (up + k) % 3] * boxes.half[each, (up + k) % 3, None]
        for k in (1, 2)
    )
    b *= np.where(a[:, 0] * b[:, 1] < a[:, 1] * b[:, 0], -1.0, 1.0)[:, None]
    corners = boxes.center[:, None, :2] + np.stack([-a - b, a - b, a + b, b - a], axis=1)
    stands = np.abs(boxes.rotation[each, 2, up]) > 1 - 1e-9
    return [xy if ok else None for xy, ok in zip(corners, stands, strict=True)]


def box_bounds(boxes: Boxes) -> Float[np.ndarray, "n 2"]:
    """Return the lower and then the upper corners of boxes from above [m]."""
    extent = np.einsum("bij,bj->bi", np.abs(boxes.rotation[:, :2]), boxes.half)
    return np.concatenate([boxes.center[:, :2] - extent, boxes.center[:, :2] + extent])


def draw_union(
    axes: Any,
    polygons: Sequence[Float[np.ndarray, "_ 2"]],
    *,
    fill: str,
    edge: str | None = None,
    width: float = 0.8,
    alpha: float = 1.0,
    zorder: float,
) -> None:
    """Fill the union of counterclockwise polygons, and draw its outline if the fill is opaque.

    The limits of the axes do not change.
    """
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    if not len(polygons):
        return
    rings = (Path(np.vstack([p, p[:1]]), closed=True) for p in polygons)
    path = Path.make_compound_path(*rings)
    if edge is not None:
        # The fill covers the inner half of the line.
        rim = {"edgecolor": edge, "linewidth": 2 * width, "joinstyle": "round"}
        axes.add_artist(PathPatch(path, facecolor="none", zorder=zorder, **rim))
    axes.add_artist(PathPatch(path, facecolor=fill, linewidth=0, alpha=alpha, zorder=zorder))
