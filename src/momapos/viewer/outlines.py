"""Bodies seen from above: convex outlines, and paths that draw many of them as one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from momapos.geometry.polygons import signed_area
from momapos.kinematics.hulls import Boxes

_CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T


def outline(points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "k 2"] | None:
    """The convex outline of points from above, anticlockwise; None where they span no area."""
    try:
        xy = points[ConvexHull(points[:, :2]).vertices, :2]
    except (QhullError, ValueError):
        return None
    return xy if signed_area(xy) > 0 else xy[::-1]


def box_outlines(boxes: Boxes) -> list[Float[np.ndarray, "k 2"]]:
    """The outline of each box [m]."""
    scaled = _CORNERS[None] * boxes.half[:, None]
    corners = np.einsum("bij,bcj->bci", boxes.rotation, scaled) + boxes.center[:, None]
    return [xy for xy in map(outline, corners) if xy is not None]


def union_path(polygons: Iterable[Float[np.ndarray, "k 2"]]) -> Any:
    """One path for polygons of one orientation; filled by winding it shows their union."""
    from matplotlib.path import Path

    return Path.make_compound_path(*(Path(np.vstack([p, p[:1]]), closed=True) for p in polygons))


def draw_union(
    axes: Any,
    polygons: Sequence[Float[np.ndarray, "k 2"]],
    *,
    fill: str,
    edge: str | None = None,
    width: float = 0.8,
    alpha: float = 1.0,
    zorder: float,
) -> None:
    """Fill the union of polygons; only its own outline is drawn, nothing within (opaque fills)."""
    from matplotlib.patches import PathPatch

    if not len(polygons):
        return
    path = union_path(polygons)
    if edge is not None:
        # Half of the line lies within the union, where the fill covers it.
        rim = dict(facecolor="none", edgecolor=edge, linewidth=2 * width, joinstyle="round")
        axes.add_patch(PathPatch(path, zorder=zorder, **rim))
    axes.add_patch(PathPatch(path, facecolor=fill, linewidth=0, alpha=alpha, zorder=zorder))
