"""Bodies seen from above: convex outlines, and paths that draw many of them as one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from momapos.core.geometry import signed_area
from momapos.model.urdf import Boxes

if TYPE_CHECKING:
    from jaxtyping import Float

_CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T


def outline(points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "k 2"] | None:
    """The convex outline of points from above, counterclockwise; None where they span no area."""
    try:
        xy = points[ConvexHull(points[:, :2]).vertices, :2]
    except (QhullError, ValueError):
        return None
    return xy if signed_area(xy) > 0 else xy[::-1]


def box_outlines(boxes: Boxes) -> list[Float[np.ndarray, "_ 2"]]:
    """The outline of each box [m]."""
    scaled = _CORNERS[None] * boxes.half[:, None]
    corners = np.einsum("bij,bcj->bci", boxes.rotation, scaled) + boxes.center[:, None]
    upright = _upright_outlines(boxes)
    found = [
        upright[b] if upright[b] is not None else outline(corners[b]) for b in range(len(boxes))
    ]
    return [xy for xy in found if xy is not None]


def _upright_outlines(boxes: Boxes) -> list[Float[np.ndarray, "4 2"] | None]:
    """The rectangles of the boxes that stand on a side; None for the others."""
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
    """Lower and upper corners of the boxes from above [m]."""
    extent = np.einsum("bij,bj->bi", np.abs(boxes.rotation[:, :2]), boxes.half)
    return np.concatenate([boxes.center[:, :2] - extent, boxes.center[:, :2] + extent])


def union_path(polygons: Iterable[Float[np.ndarray, "_ 2"]]) -> Any:
    """One path for polygons of one orientation; filled by winding it shows their union."""
    from matplotlib.path import Path

    return Path.make_compound_path(*(Path(np.vstack([p, p[:1]]), closed=True) for p in polygons))


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
    """Fill the union of polygons; only its own outline is drawn, nothing within (opaque fills).

    The limits of the axes stay as they are.
    """
    from matplotlib.patches import PathPatch

    if not len(polygons):
        return
    path = union_path(polygons)
    if edge is not None:
        # Half of the line lies within the union, where the fill covers it.
        rim = {"edgecolor": edge, "linewidth": 2 * width, "joinstyle": "round"}
        axes.add_artist(PathPatch(path, facecolor="none", zorder=zorder, **rim))
    axes.add_artist(PathPatch(path, facecolor=fill, linewidth=0, alpha=alpha, zorder=zorder))
