"""The figure of a scene from above."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import label
from momapos.core.geometry import apply
from momapos.model.scene import Scene

from .image_files import save_figure
from .outlines import outline

if TYPE_CHECKING:
    from jaxtyping import Float

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
