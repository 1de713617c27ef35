"""Draw what momapos finds in a scan of a real kitchen: from above, and one wall from the front.

    python benchmarks/scan_figure.py FOLDER [--out docs/images/redkitchen.png]

FOLDER is a scan, such as 7-Scenes RedKitchen. Large objects are drawn with their names.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from momapos.core.geometry.upright_boxes import UprightBox, box_axes
from momapos.model.records.scans import Detection
from momapos.perception.recordings.scan_reader import read_scan
from momapos.perception.records import Modeled
from momapos.workflows.scan import scan_to_scene

COLORS = ("#0072b2", "#d55e00", "#009e73", "#aa3377", "#7a5c00", "#4b4bc8")
MIN_VOLUME = 0.04
"""Smaller boxes are not drawn [m^3]."""
UNNAMED = ("object", "wall")
"""Labels that say nothing."""
NARROW = 0.45
"""Boxes that are narrower get an upright name [m]."""
CEILING = 2.1
"""Points above are not drawn from above [m]."""
DEPTH = 0.8
"""Depth of the wall that is drawn from the front [m]."""


def drawn(modeled: Modeled) -> list[Detection]:
    """Return the large objects, the largest first."""
    found = [one.detection for one in modeled.decisions]
    large = [
        one for one in found if np.prod(one.box.size) >= MIN_VOLUME and one.label not in UNNAMED
    ]
    return sorted(large, key=lambda one: -float(np.prod(one.box.size)))


def corners(box: UprightBox, columns: tuple[int, int]) -> np.ndarray:
    """Return the outline of a box from above, or from the front [m]."""
    half = np.asarray(box.size) / 2
    axes = np.eye(3)
    axes[:2, :2] = box_axes(box.yaw)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    points = np.asarray(box.center) + (signs * half) @ axes
    if columns == (0, 1):
        return points[[0, 2, 6, 4]][:, :2]
    low, high = points[:, list(columns)].min(0), points[:, list(columns)].max(0)
    return np.array([low, [high[0], low[1]], high, [low[0], high[1]]])


def draw(axes: Axes, modeled: Modeled, objects: list[Detection], columns: tuple[int, int]) -> None:
    """Draw points, boxes and names."""
    points, colors = modeled.cloud.points, modeled.cloud.colors / 255.0
    back = points[:, 1].max()
    shown = points[:, 2] < CEILING if columns == (0, 1) else points[:, 1] > back - DEPTH
    order = np.argsort(points[shown][:, 2 if columns == (0, 1) else 1])
    order = order if columns == (0, 1) else order[::-1]
    flat = points[shown][order][:, list(columns)]
    axes.scatter(flat[:, 0], flat[:, 1], s=3.5, c=colors[shown][order], linewidths=0)
    for k, one in enumerate(objects):
        if columns == (0, 2) and one.box.center[1] < back - DEPTH:
            continue
        outline, color = corners(one.box, columns), COLORS[k % len(COLORS)]
        axes.add_patch(Polygon(outline, fill=False, edgecolor=color, linewidth=3.5))
        upright = np.ptp(outline[:, 0]) < NARROW
        x, y = outline.mean(0).tolist()
        axes.text(
            x, y, one.label, color=color, fontsize=15, rotation=90 * upright,
            weight="bold", ha="center", va="center",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 2.5},
        )  # fmt: skip
    axes.set_aspect("equal")
    axes.tick_params(labelsize=15)
    axes.set_xlabel("x [m]", fontsize=17)
    axes.set_ylabel("y [m]" if columns == (0, 1) else "height [m]", fontsize=17)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/images/redkitchen.png"))
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = scan_to_scene(read_scan(args.folder), Path(folder) / "scene.json")
    figure = Figure(figsize=(19.2, 6.2), dpi=100, layout="constrained")
    above, front = figure.subplots(1, 2)
    large = drawn(result)
    draw(above, result, large, (0, 1))
    draw(front, result, large, (0, 2))
    above.set_title("from above", fontsize=22)
    front.set_title("the back wall, from the front", fontsize=22)
    FigureCanvasAgg(figure).print_png(str(args.out))
    print(f"{args.out}: {len(large)} of {len(result.decisions)} objects drawn")
