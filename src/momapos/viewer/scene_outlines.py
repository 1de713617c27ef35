"""A scene from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from momapos.geometry.transforms import apply
from momapos.scene.scene import Scene


def draw_scene(scene: Scene, path: Path) -> None:
    """Draw a scene from above: every hull's outline, the floor, the start."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon
    from scipy.spatial import ConvexHull, QhullError

    figure = Figure(figsize=(8, 8), layout="constrained")
    axes = figure.subplots()
    if scene.floor_polygon is not None:
        axes.add_patch(Polygon(scene.floor_polygon, facecolor="0.95", edgecolor="0.5", zorder=0))
    for index, item in enumerate(scene.objects):
        color = f"C{index % 10}"
        for link, T in item.link_poses().items():
            for hull in item.model.hulls[link]:
                points = apply(T, hull.vertices)
                try:
                    outline = points[ConvexHull(points[:, :2]).vertices, :2]
                except QhullError:
                    continue
                height = float(points[:, 2].max())
                axes.add_patch(
                    Polygon(outline, facecolor=color, alpha=0.35, edgecolor=color, zorder=height)
                )
        low, high = item.bounds
        x, y = (low + high)[:2] / 2
        axes.text(x, y, item.name, ha="center", va="center", size=7, zorder=99)
    if scene.start is not None:
        x, y, yaw = scene.start
        axes.plot(x, y, "ko")
        axes.arrow(x, y, 0.4 * np.cos(yaw), 0.4 * np.sin(yaw), width=0.02, color="k")
    axes.autoscale_view()
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=scene.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, format="png")
