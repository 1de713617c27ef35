"""Figures of a scanned room and of its reconstructed objects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from momapos.core import label
from momapos.core.geometry import apply, invert
from momapos.model.records import UNKNOWN, Cloud, Detection, Frame, Part
from momapos.model.scene import SceneObject
from momapos.perception import Decision, Modeled
from momapos.perception.detection import visible_points
from momapos.perception.views import Face, FrontView, corners

from .image_files import save_figure

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.axes import Axes


_EDGES = ((0, 1), (0, 2), (0, 4), (1, 3), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 6), (5, 7),
          (6, 7))  # fmt: skip
COLORS = {
    "door_left": "#e07b39", "door_right": "#2a9d8f", "door_down": "#b5179e", "door_up": "#7209b7",
    "drawer": "#3a86ff",
}  # fmt: skip
HANDLE = "#ffd166"
SIZE, RESOLUTION = (18.0, 6.6), 100.0
"""Size [in] and resolution [1/in]: readable on a slide."""
CAPTION, TITLE, LABEL, TICKS = 22.0, 18.0, 16.0, 13.0
"""Sizes of the texts [pt]."""
LABEL_MARGIN = 0.025
"""Height of a label above the lower edge of its part, as a share of the front [-]."""
MAX_POINTS = 20_000
"""Approximate number of points drawn [-]."""


def draw_modeled(
    detection: Detection,
    view: FrontView | None,
    frames: Sequence[Frame],
    cloud: Cloud,
    model: SceneObject | None,
    caption: str,
    path: Path,
) -> None:
    """Draw the decision about one object, and the data it is based on.

    Args:
        detection: The object.
        view: Its front; None where none was found.
        frames: All images.
        cloud: The points of the room.
        model: The object in the scene.
        caption: Title of the figure.
        path: The file.
    """
    figure = Figure(figsize=SIZE, layout="constrained")
    image, face, front, side = figure.subplots(1, 4, width_ratios=(1.45, 1.0, 1.0, 1.0))
    figure.suptitle(label(caption), fontsize=CAPTION, fontweight="bold")
    if view is not None:
        _frame(image, frames[view.frame], detection, np.degrees(view.angle))
        _face(face, view)
        axis = view.face
    else:
        for axes, text in ((image, "no image shows a front"), (face, "no parts")):
            axes.set_axis_off()
            axes.set_title(label(text), fontsize=TITLE)
        axis = None
    _fit(front, side, detection, axis, cloud, model)
    save_figure(figure, path, dpi=RESOLUTION)


def _frame(axes: Axes, frame: Frame, detection: Detection, angle: float) -> None:
    axes.imshow(frame.color)
    points = apply(invert(frame.T_world_camera), corners(detection.box))
    visible = points[:, 2] > 0.1
    pixels = points @ frame.intrinsics.T
    pixels = pixels[:, :2] / np.maximum(pixels[:, 2:], 1e-6)
    for a, b in _EDGES:
        if visible[a] and visible[b]:
            axes.plot(*pixels[[a, b]].T, color="#ff3366", linewidth=3.0)
    height, width = frame.color.shape[:2]
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    axes.set_title(label(f"image, {angle:.0f}° off the normal"), fontsize=TITLE)


def _face(axes: Axes, view: FrontView) -> None:
    """Draw the rectified front with its parts and their hinges."""
    width, height = view.image.width, view.image.height
    axes.imshow(view.image.color, extent=(0, width, 0, height))
    for part in view.front.parts:
        left, top, right, bottom = part.box
        color = COLORS[part.kind]
        corner = (left * width, (1 - bottom) * height)
        size = ((right - left) * width, (bottom - top) * height)
        axes.add_patch(Rectangle(corner, *size, fill=False, edgecolor=color, linewidth=4))
        axes.plot(*_hinge(part, width, height), color=color, linewidth=9, alpha=0.6)
        words = f"{part.kind.replace('_', ' ')} {part.score:.2f}"
        low = (corner[0] + size[0] / 2, corner[1] + LABEL_MARGIN * height)
        axes.text(
            *low, label(words), color=color, fontsize=LABEL, weight="bold", ha="center",
            va="bottom",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 3.0},
        )  # fmt: skip
        if part.handle is not None:
            left, top, right, bottom = part.handle
            corner = (left * width, (1 - bottom) * height)
            size = ((right - left) * width, (bottom - top) * height)
            axes.add_patch(Rectangle(corner, *size, fill=False, edgecolor=HANDLE, linewidth=3.0))
    axes.set(xlim=(-0.05, width + 0.05), ylim=(-0.05, height + 0.05))
    axes.tick_params(labelsize=TICKS)
    axes.set_title(label(f"front, probability {view.front.score:.2f}"), fontsize=TITLE)


def _hinge(part: Part, width: float, height: float) -> tuple[list[float], list[float]]:
    """Return the edge of a door's hinge; empty for a drawer."""
    left, top, right, bottom = part.box
    x0, x1, z0, z1 = left * width, right * width, (1 - bottom) * height, (1 - top) * height
    return {
        "door_left": ([x0, x0], [z0, z1]),
        "door_right": ([x1, x1], [z0, z1]),
        "door_down": ([x0, x1], [z0, z0]),
        "door_up": ([x0, x1], [z1, z1]),
        "drawer": ([], []),
    }[part.kind]


def _fit(
    front: Axes,
    side: Axes,
    detection: Detection,
    face: Face | None,
    cloud: Cloud,
    model: SceneObject | None,
) -> None:
    """Draw the model over the points, from the front and from the side."""
    T_face_world = _face_frame(detection, face)
    step = max(1, len(detection.members) // MAX_POINTS)
    members = detection.members[::step]
    points = apply(T_face_world, cloud.points[members])
    colors = cloud.colors[members] / 255.0
    for axes, columns, side_name in ((front, (0, 1), "front"), (side, (2, 1), "side")):
        axes.scatter(points[:, columns[0]], points[:, columns[1]], s=4.0, c=colors, linewidths=0)
        if model is not None:
            _model_outline(axes, model, T_face_world, columns)
        axes.set_aspect("equal")
        axes.tick_params(labelsize=TICKS)
        axes.set_title(label(f"model, from the {side_name}"), fontsize=TITLE)


def _face_frame(detection: Detection, face: Face | None) -> Float[np.ndarray, "4 4"]:
    """Return T_face_world with x right, y up, z outward; without a face, of the box's -y side."""
    if face is not None:
        return invert(face.T_world_face)
    c, s = np.cos(detection.box.yaw), np.sin(detection.box.yaw)
    T = np.eye(4)
    T[:3, :3] = np.array([[c, 0, s], [s, 0, -c], [0, 1, 0.0]])
    T[:3, 3] = detection.box.center
    return invert(T)


def _model_outline(
    axes: Axes, model: SceneObject, T_face_world: Float[np.ndarray, "4 4"], columns: tuple[int, int]
) -> None:
    from scipy.spatial import ConvexHull, QhullError

    for link, T in model.link_poses().items():
        for hull in model.model.hulls[link]:
            flat = apply(T_face_world @ T, hull.vertices)[:, columns]
            try:
                ring = flat[ConvexHull(flat).vertices]
            except QhullError:
                continue  # edge-on
            color = "0.3" if link == model.model.urdf.root else "#d00000"
            axes.add_patch(Polygon(ring, fill=False, edgecolor=color, linewidth=1.8))


MAX_FIGURES = 4
"""Number of images that are drawn [-]."""
MIN_VISIBLE = 0.3
"""An image shows an object if it shows this share of its points [-]."""
MIN_FRONT_VISIBLE = 0.5
"""The same for the corners and the middle of a front whose parts are drawn [-]."""
MIN_PIXELS = 24
"""Minimum size of an object in the image [px]."""
SAMPLED = 300
"""Number of points of an object that are projected [-]."""
MODELED_WEIGHT = 4.0
"""An object with joints counts this much more than a box in the choice of images [-]."""
BOX, PLAIN = "#ffe14d", "#9ad1ff"
"""Colors of objects with joints, and of boxes."""


def draw_overviews(result: Modeled, folder: Path) -> list[Path]:
    """Draw the images that together show most objects, see `overview_1.png` and so on.

    Args:
        result: The modeled room; without images, nothing is drawn.
        folder: Where to write them.

    Returns:
        The files.
    """
    objects = [one for one in result.decisions if one.detection.label != "wall"]
    shown = np.array([[_share(frame, one, result) for one in objects] for frame in result.frames])
    files = []
    weight = np.array([MODELED_WEIGHT if one.model is not None else 1.0 for one in objects])
    best = np.zeros(len(objects))
    for number in range(1, MAX_FIGURES + 1):
        if not shown.size:
            break
        gain = (np.maximum(shown - best, 0.0) * weight).sum(axis=1)
        k = int(np.argmax(gain))
        if gain[k] < 0.5:
            break
        best = np.maximum(best, shown[k])
        visible = [one for one, share in zip(objects, shown[k], strict=True) if share > 0.0]
        files.append(folder / f"overview_{number}.png")
        _draw(result.frames[k], visible, files[-1])
    return files


def _share(frame: Frame, one: Decision, result: Modeled) -> float:
    """Return the share of an object that an image shows; 0 if it shows too little."""
    box = _project(frame, corners(one.detection.box))
    if box is None or np.ptp(box, axis=0).min() < MIN_PIXELS:
        return 0.0
    members = one.detection.members
    if not len(members):
        return 1.0 if one.view is not None else 0.0
    points = result.cloud.points[members[:: -(-len(members) // SAMPLED)]]
    share = float(visible_points(frame, points, 0.05)[1].mean())
    return share if share >= MIN_VISIBLE else 0.0


def _draw(frame: Frame, objects: Sequence[Decision], path: Path) -> None:
    height, width = frame.color.shape[:2]
    figure = Figure(figsize=(12, 12 * height / width), layout="constrained")
    axes = figure.subplots()
    axes.imshow(frame.color)
    # Nearer objects are drawn later, over those behind them.
    place = frame.T_world_camera[:3, 3]
    for one in sorted(objects, key=lambda d: -np.linalg.norm(d.detection.box.center - place)):
        _box_outline(axes, frame, one)
        if one.view is not None and one.model is not None and _shows_front(frame, one):
            for part in one.parts:
                _part(axes, frame, one, part)
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    figure.suptitle(label(f"{frame.name}: yellow opens, blue is a box"))
    save_figure(figure, path, dpi=100)


def _box_outline(axes: Axes, frame: Frame, one: Decision) -> None:
    from scipy.spatial import ConvexHull

    pixels = _project(frame, corners(one.detection.box))
    if pixels is None:
        return
    is_known = one.model is not None or one.detection.label != UNKNOWN[0]
    color = PLAIN if one.model is None else BOX
    ring = pixels[ConvexHull(pixels).vertices]
    width = 2.0 if is_known else 0.8
    axes.add_patch(Polygon(ring, fill=False, edgecolor=color, linewidth=width))
    if not is_known:
        return
    last = np.array(frame.color.shape[1::-1]) - (80, 4)
    x, y = np.clip(ring[np.argmin(ring @ [0.3, 1.0])], (4, 14), last)
    text = one.detection.name if one.model is None else f"{one.detection.name}: {_kinds(one)}"
    axes.text(
        x, y, label(text), fontsize=10, color="black", va="bottom",
        bbox={"facecolor": color, "edgecolor": "none", "pad": 1.5, "alpha": 0.9},
    )  # fmt: skip


def _kinds(one: Decision) -> str:
    kinds = ["drawer" if part.kind == "drawer" else "door" for part in one.parts]
    counted = [f"{kinds.count(k)} {k}{'s' * (kinds.count(k) > 1)}" for k in dict.fromkeys(kinds)]
    return ", ".join(counted) or "given model"


def _shows_front(frame: Frame, one: Decision) -> bool:
    """Tell whether an image shows the front of an object from the outside, and not hidden."""
    assert one.view is not None
    face = one.view.face
    T = face.T_world_face
    if (frame.T_world_camera[:3, 3] - T[:3, 3]) @ face.outward <= 0.1:
        return False
    steps = np.linspace(-0.45, 0.45, 5)
    x, y = (side * grid.ravel() for side, grid in
            zip((face.width, face.height), np.meshgrid(steps, steps), strict=True))  # fmt: skip
    points = apply(T, np.stack([x, y, np.zeros_like(x)], axis=1))
    return bool(visible_points(frame, points, 0.08)[1].mean() >= MIN_FRONT_VISIBLE)


def _part(axes: Axes, frame: Frame, one: Decision, part: Part) -> None:
    color = COLORS[part.kind]
    pixels = _on_front(frame, one, part.box)
    if pixels is None:
        return
    axes.add_patch(Polygon(pixels, facecolor=color, edgecolor=color, linewidth=2.5, alpha=0.3))
    axes.add_patch(Polygon(pixels, fill=False, edgecolor=color, linewidth=2.5))
    x, y = pixels.mean(axis=0).tolist()
    axes.text(
        x, y, label(f"{part.kind.replace('_', ' ')}\n{part.score:.2f}"), fontsize=9, color="white",
        ha="center", va="center", clip_on=True,
        bbox={"facecolor": color, "edgecolor": "none", "pad": 1.0, "alpha": 0.75},
    )  # fmt: skip
    handle = None if part.handle is None else _on_front(frame, one, part.handle)
    if handle is not None:
        axes.add_patch(Polygon(handle, fill=False, edgecolor=HANDLE, linewidth=2))


def _on_front(
    frame: Frame, one: Decision, box: tuple[float, float, float, float]
) -> Float[np.ndarray, "4 2"] | None:
    """Return the corners of a rectangle on a front in an image [px]."""
    assert one.view is not None
    face = one.view.face
    left, top, right, bottom = box
    ring = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    local = np.zeros((4, 3))
    local[:, 0], local[:, 1] = (ring[:, 0] - 0.5) * face.width, (0.5 - ring[:, 1]) * face.height
    return _project(frame, apply(face.T_world_face, local))


def _project(frame: Frame, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"] | None:
    """Return the pixels of points; None if one is behind the camera, or none is in the image."""
    local = apply(invert(frame.T_world_camera), points)
    if (local[:, 2] < 0.1).any():
        return None
    pixels = (local @ frame.intrinsics.T)[:, :2] / local[:, 2:]
    height, width = frame.color.shape[:2]
    inside = ((pixels > 0) & (pixels < [width, height])).all(axis=1)
    return pixels if inside.any() else None
