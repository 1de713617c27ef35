"""The figure of a reconstructed object: the chosen image, the detected parts, the fit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from momapos.core import label
from momapos.core.geometry import apply, invert
from momapos.model.records import Cloud, Detection, Frame, Part
from momapos.model.scene import SceneObject
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
            _outline(axes, model, T_face_world, columns)
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


def _outline(
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
