"""A room from above: floor, walls, furniture, and names that do not overlap."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import label
from momapos.core.geometry import apply
from momapos.model.scene import Scene, SceneObject

from . import palette
from .outlines import draw_union, outline

if TYPE_CHECKING:
    from jaxtyping import Float

OVERHEAD = 1.2
"""Shapes above this height are drawn as dashed outlines [m]."""
OVERHEAD_DASHES = (0, (4, 2.5))
FLOOR_LAYER, FURNITURE_LAYER, OVERHEAD_LAYER, NAME_LAYER = 0.0, 2.0, 6.0, 20.0
"""Drawing order; the layers of a figure go in between."""
SMALL_SIZE = 0.3
"""Objects smaller than this have their names next to them [m]."""
_MAX_NAMES = 60
"""Maximum number of objects that get a name [-]."""


def draw_room(axes: Any, scene: Scene, *, target: str = "", moving: Collection[str] = ()) -> None:
    """Draw a room from above.

    Args:
        axes: Matplotlib axes in meters.
        scene: The room.
        target: Object in another color.
        moving: Links of the target that the caller draws.
    """
    from matplotlib.patches import Polygon

    if scene.floor_polygon is not None:
        axes.add_patch(Polygon(
            scene.floor_polygon, facecolor=palette.FLOOR, edgecolor=palette.FLOOR_EDGE, lw=0.8,
            zorder=FLOOR_LAYER,
        ))  # fmt: skip
    tallest = max((float(o.bounds[1, 2]) for o in scene.objects), default=1.0) or 1.0
    for item in scene.objects:
        # Objects are drawn over those they stand on: by their bottoms, then by their tops.
        low, high = item.bounds[:, 2] / max(tallest, 1e-3)
        layer = FURNITURE_LAYER + float(np.clip(0.9 * low + 0.09 * high, 0.0, 1.0))
        _object(axes, item, layer, item.name == target, moving if item.name == target else ())


def _object(
    axes: Any, item: SceneObject, layer: float, is_target: bool, left_out: Collection[str]
) -> None:
    from matplotlib.patches import Polygon

    standing, hanging = [], []
    for link, T in item.link_poses().items():
        if link in left_out or not item.model.hulls[link]:
            continue
        bodies = [apply(T, hull.vertices) for hull in item.model.hulls[link]]
        if min(float(points[:, 2].min()) for points in bodies) >= OVERHEAD:
            hanging.append(outline(np.concatenate(bodies)))
        else:
            standing += [outline(points) for points in bodies]
    fill, edge = palette.FURNITURE, palette.FURNITURE_EDGE
    if is_target:
        fill, edge = palette.TARGET, palette.TARGET_EDGE
    elif item.category == "wall":
        fill = edge = palette.WALL
    draw_union(axes, [p for p in standing if p is not None], fill=fill, edge=edge, zorder=layer)
    for polygon in hanging:
        if polygon is not None:
            axes.add_patch(Polygon(
                polygon, fill=False, edgecolor=edge, linewidth=0.7, linestyle=OVERHEAD_DASHES,
                zorder=OVERHEAD_LAYER,
            ))  # fmt: skip


def room_bounds(scene: Scene) -> Float[np.ndarray, "2 2"]:
    """Return the lower and upper corner of the floor and all objects, from above [m]."""
    points = [item.bounds[:, :2] for item in scene.objects]
    if scene.floor_polygon is not None:
        points.append(scene.floor_polygon)
    if not points:
        return np.array([[-1.0, -1.0], [1.0, 1.0]])
    every = np.concatenate(points)
    return np.stack([every.min(0), every.max(0)])


def name_objects(
    axes: Any,
    scene: Scene,
    *,
    target: str = "",
    keep_clear: Collection[Float[np.ndarray, "2 2"]] = (),
    size: float = 6.5,
) -> None:
    """Write the names of objects where they overlap neither each other nor given rectangles.

    Names that do not fit are left out, except the target's.

    Args:
        axes: Axes of the room, with their final size and limits.
        scene: The room.
        target: Object whose name comes first.
        keep_clear: Lower and upper corners of rectangles that names avoid [m].
        size: Font size [pt].
    """
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    view = np.array([[x0, y0], [x1, y1]])
    taken = [np.asarray(r, float) for r in keep_clear]
    for item in _by_rank(scene, view, target)[:_MAX_NAMES]:
        wanted = item.name == target
        text = _text(axes, item.name, size, wanted)
        extent = _extent(axes, text)
        spot = _spot(item, extent, view, taken, must=wanted)
        if spot is None:
            text.remove()
            continue
        text.set_position(tuple(spot))
        taken.append(np.stack([spot - extent / 2, spot + extent / 2]))


def _by_rank(scene: Scene, view: np.ndarray, target: str) -> list[SceneObject]:
    """Return the objects in view without walls: the target, then by decreasing visible area."""

    def seen(item: SceneObject) -> float:
        low = np.maximum(item.bounds[0, :2], view[0])
        high = np.minimum(item.bounds[1, :2], view[1])
        return float(np.prod(np.maximum(high - low, 0.0)))

    items = [o for o in scene.objects if seen(o) > 0 and o.category != "wall"]
    return sorted(items, key=lambda o: (o.name != target, -seen(o)))


def _text(axes: Any, words: str, size: float, bold: bool) -> Any:
    from matplotlib.patheffects import withStroke

    return axes.text(
        0, 0, label(words), ha="center", va="center", size=size, zorder=NAME_LAYER, clip_on=True,
        color=palette.INK if bold else palette.SOFT_INK, weight="bold" if bold else "normal",
        path_effects=[withStroke(linewidth=1.6, foreground="white", alpha=0.75)],
    )  # fmt: skip


def _extent(axes: Any, text: Any) -> Float[np.ndarray, "2"]:
    """Return the size of a text with a small margin [m]."""
    box = text.get_window_extent(axes.figure.canvas.get_renderer())
    corners = axes.transData.inverted().transform([[box.x0, box.y0], [box.x1, box.y1]])
    return (corners[1] - corners[0]) * (1.06, 1.1)


def _spot(
    item: SceneObject, extent: np.ndarray, view: np.ndarray, taken: list[np.ndarray], *, must: bool
) -> Float[np.ndarray, "2"] | None:
    """Return the free place for a name that is closest to the middle of the visible object."""
    low = np.clip(item.bounds[0, :2], *view)
    high = np.clip(item.bounds[1, :2], *view)
    middle = (low + high) / 2
    steps = np.linspace(-1, 1, 13)
    inside = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    slack = np.maximum((high - low - extent) / 2, 0.0)
    spots = middle + inside * slack
    small = (high - low).max() < SMALL_SIZE  # the name would hide it
    if small or must:
        sides = np.array([[0, -1], [0, 1], [1, 0], [-1, 0], [1, -1], [-1, -1], [1, 1], [-1, 1]])
        gaps = np.array([0.01, float(extent[1])])  # the larger one if a marker is at the place
        around = np.concatenate([sides * ((high - low + extent) / 2 + gap) for gap in gaps])
        spots = np.concatenate([np.zeros((0, 2)) if small else spots, middle + around])
    distance = np.linalg.norm((spots - middle) / extent, axis=1)
    for spot in spots[np.argsort(distance, kind="stable")]:
        corners = np.stack([spot - extent / 2, spot + extent / 2])
        outside = (corners[0] < view[0]).any() or (corners[1] > view[1]).any()
        if not outside and not any(_overlap(corners, other) for other in taken):
            return spot
    return np.clip(middle, view[0] + extent / 2, view[1] - extent / 2) if must else None


def _overlap(a: np.ndarray, b: np.ndarray) -> bool:
    return bool((a[0] < b[1]).all() and (b[0] < a[1]).all())
