"""Rooms and robots from above."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from momapos.core import label
from momapos.core.geometry import apply, place_points, pose, pose_planar, signed_area
from momapos.model.kinematics import chain_arrays, forward, stand_at_origin
from momapos.model.robots import Robot
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Boxes

from . import palette
from .image_files import save_figure
from .palette import ARM, INK

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


FOOTPRINT_LAYER, ARM_LAYER = 9.0, 13.0


def draw_footprint(
    axes: Any,
    robot: Robot,
    base: Float[np.ndarray, "3"],
    *,
    dashed: bool = False,
    filled: bool = True,
) -> None:
    """Draw the footprint of the base with an arrow for its heading."""
    from matplotlib.patches import Polygon

    xy = place_points(np.asarray(base, float)[None], robot.footprint)[0]
    opacity, width, dashes = (0.55, 1.0, (0, (3.5, 2))) if dashed else (0.72, 1.6, "solid")
    shape = Polygon(
        xy, facecolor=(1, 1, 1, opacity if filled else 0.0), edgecolor=INK, linewidth=width,
        linestyle=dashes, zorder=FOOTPRINT_LAYER,
    )  # fmt: skip
    axes.add_patch(shape)
    front = robot.footprint[:, 0].max()
    heading = np.array([np.cos(base[2]), np.sin(base[2])])
    tail, tip = base[:2] - 0.3 * front * heading, base[:2] + 0.85 * front * heading
    arrow = {"arrowstyle": "-|>", "mutation_scale": 9, "shrinkA": 0, "shrinkB": 0}
    arrow |= {"color": INK, "linewidth": 0.95 * width}
    axes.annotate("", tip, tail, arrowprops=arrow, zorder=FOOTPRINT_LAYER + 0.5)


def draw_arm(
    axes: Any,
    robot: Robot,
    base: Float[np.ndarray, "3"],
    q: Float[np.ndarray, " n"],
    *,
    faint: bool = False,
) -> None:
    """Draw the silhouette of the arm's links, and a line through its joints."""
    poses, line = arm_frames(robot, base, q)
    bodies = [
        outline(apply(T, hull.vertices))
        for link, T in poses.items()
        for hull in robot.model.hulls[link]
    ]
    silhouette = [xy for xy in bodies if xy is not None]
    layer = ARM_LAYER - (1.0 if faint else 0.0)
    draw_union(axes, silhouette, fill=ARM, alpha=0.13 if faint else 0.32, zorder=layer)
    if not faint:
        axes.plot(
            *line.T, color=ARM, linewidth=1.6, marker="o", markersize=2.6, markerfacecolor="white",
            markeredgewidth=0.8, solid_capstyle="round", zorder=layer + 0.5,
        )  # fmt: skip


def arm_frames(
    robot: Robot, base: Float[np.ndarray, "3"], q: Float[np.ndarray, " n"]
) -> tuple[dict[str, Float[np.ndarray, "4 4"]], Float[np.ndarray, "k 2"]]:
    """Return the world poses of the arm's links, and the line through its joints and tool [m]."""
    chain, segments = robot.chain, robot.segments
    R, p = np.empty((chain.last + 1, 3, 3)), np.empty((chain.last + 1, 3))
    stand_at_origin(R, p)
    forward(np.ascontiguousarray(q, float), chain_arrays(chain), R, p)
    T_world_base = pose_planar(np.asarray(base, float))
    poses = {
        link: T_world_base @ pose(p[s], R[s]) @ segments.T_segment_link[link]
        for link, s in segments.of_link.items()
        if s > 0
    }
    tool = p[-1] + R[-1] @ chain.tool_offset
    return poses, apply(T_world_base, np.vstack([p[1:], tool]))[:, :2]


MAX_NAMED_OBJECTS = 300
"""Scenes with more objects have no names, which would overlap and take minutes to draw [-]."""


def draw_scene(scene: Scene, path: Path) -> None:
    """Draw a scene from above: the outlines of all hulls, the floor, the start."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon

    figure = Figure(figsize=(8, 8), layout="constrained")
    axes = figure.subplots()
    if scene.floor_polygon is not None:
        axes.add_patch(Polygon(scene.floor_polygon, facecolor="0.95", edgecolor="0.5", zorder=0))
    shapes: list[tuple[float, Float[np.ndarray, "k 2"], str]] = []
    for index, item in enumerate(scene.objects):
        for link, T in item.link_poses().items():
            for hull in item.model.hulls[link]:
                points = apply(T, hull.vertices)
                if (xy := outline(points)) is not None:
                    shapes.append((float(points[:, 2].max()), xy, f"C{index % 10}"))
        if len(scene.objects) <= MAX_NAMED_OBJECTS:
            x, y = item.bounds.mean(0)[:2]
            axes.text(x, y, label(item.name), ha="center", va="center", size=7, zorder=99)
    shapes.sort(key=lambda shape: shape[0])  # higher shapes are drawn over lower ones
    colors = [color for _, _, color in shapes]
    axes.add_collection(
        PolyCollection(
            [xy for _, xy, _ in shapes],
            facecolors=[(color, 0.35) for color in colors],
            edgecolors=[(color, 0.35) for color in colors],
        )
    )
    if scene.start is not None:
        x, y, yaw = scene.start
        axes.plot(x, y, "ko")
        axes.arrow(x, y, 0.4 * np.cos(yaw), 0.4 * np.sin(yaw), width=0.02, color="k")
    axes.autoscale_view()
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=label(scene.name))
    save_figure(figure, path, dpi=110)
