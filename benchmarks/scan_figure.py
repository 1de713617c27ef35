"""Draw what momapos finds in a scan of a real kitchen: from above, and on its images.

    python benchmarks/scan_figure.py FOLDER [--out docs/images/redkitchen.png]

FOLDER is a scan, such as 7-Scenes RedKitchen. Large objects are drawn with their names from above.
On the images that show most doors and drawers, these and their handles are drawn. They are also
printed as rows of a table.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Polygon

from momapos.core.geometry import UprightBox, apply, box_axes
from momapos.model.records import Detection, Frame, Part
from momapos.perception import Decision, Modeled
from momapos.perception.recordings import read_scan
from momapos.perception.views import Face
from momapos.workflows import scan_to_scene

COLORS = ("#0072b2", "#d55e00", "#009e73", "#aa3377", "#7a5c00", "#4b4bc8")
MIN_VOLUME = 0.04
"""Smaller boxes are not drawn [m^3]."""
UNNAMED = ("object", "wall")
"""Labels that say nothing."""
NARROW = 0.45
"""Boxes that are narrower get an upright name [m]."""
CEILING = 2.1
"""Points above are not drawn from above [m]."""
MARGIN = 0.02
"""A part is in an image if all corners are within it by this share of its size [-]."""
IMAGES = 2
"""Largest number of images [-]."""


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


def draw_above(axes: Axes, modeled: Modeled) -> int:
    """Draw points, boxes and names from above; return the number of boxes."""
    points, colors = modeled.cloud.points, modeled.cloud.colors / 255.0
    shown = points[:, 2] < CEILING
    order = np.argsort(points[shown][:, 2])
    flat = points[shown][order][:, :2]
    axes.scatter(flat[:, 0], flat[:, 1], s=3.5, c=colors[shown][order], linewidths=0)
    objects = drawn(modeled)
    for k, one in enumerate(objects):
        outline, color = corners(one.box, (0, 1)), COLORS[k % len(COLORS)]
        axes.add_patch(Polygon(outline, fill=False, edgecolor=color, linewidth=3.5))
        upright = np.ptp(outline[:, 0]) < NARROW
        x, y = outline.mean(0).tolist()
        write(axes, (x, y), one.label, color, 90 * upright)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=15)
    axes.set_xlabel("x [m]", fontsize=17)
    axes.set_ylabel("y [m]", fontsize=17)
    return len(objects)


def write(axes: Axes, at: tuple[float, float], text: str, color: str, turn: float = 0.0) -> None:
    """Write words on a light ground."""
    axes.text(
        *at, text, color=color, fontsize=15, rotation=turn, weight="bold", ha="center",
        va="center", bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 2.5},
    )  # fmt: skip


def on_face(face: Face, box: Sequence[float]) -> np.ndarray:
    """Return the corners of a rectangle on a face, in the world [m]."""
    left, top, right, bottom = box
    x = (np.array([left, right, right, left]) - 0.5) * face.width
    y = (0.5 - np.array([top, top, bottom, bottom])) * face.height
    return apply(face.T_world_face, np.column_stack([x, y, np.zeros(4)]))


def pixels(frame: Frame, points: np.ndarray) -> np.ndarray | None:
    """Project points; None if one is outside of the image."""
    seen = apply(np.linalg.inv(frame.T_world_camera), points) @ frame.intrinsics.T
    if (seen[:, 2] <= 0).any():
        return None
    at, size = seen[:, :2] / seen[:, 2:], np.array(frame.color.shape[1::-1])
    inside = (at > MARGIN * size).all() and (at < (1 - MARGIN) * size).all()
    return at if inside else None


def best_images(modeled: Modeled) -> list[Frame]:
    """Return the images that show the parts, each the most of those that the others do not."""
    left, chosen = parts(modeled), list[Frame]()
    while left and len(chosen) < IMAGES:

        def shown(frame: Frame, left: list[tuple[Decision, Part]] = left) -> float:
            return sum(area(frame, *one) for one in left)

        frame = max(modeled.frames, key=shown)
        chosen.append(frame)
        left = [one for one in left if area(frame, *one) == 0.0]
    return chosen


def parts(modeled: Modeled) -> list[tuple[Decision, Part]]:
    """Return all parts with their objects."""
    return [(one, part) for one in modeled.decisions if one.view for part in one.parts]


def area(frame: Frame, decision: Decision, part: Part) -> float:
    """Return the area of a part in an image, as its root [px]; 0 if it is not all inside."""
    assert decision.view is not None
    at = pixels(frame, on_face(decision.view.face, part.box))
    if (
        at is None
        or decision.view.face.outward
        @ (frame.T_world_camera[:3, 3] - decision.view.face.T_world_face[:3, 3])
        <= 0.0
    ):
        return 0.0
    x, y = at.T
    return float(np.sqrt(abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / 2))


def draw_image(axes: Axes, frame: Frame, modeled: Modeled) -> None:
    """Draw an image, and the parts that it shows."""
    axes.imshow(frame.color)
    for k, (decision, part) in enumerate(parts(modeled)):
        if area(frame, decision, part) == 0.0 or decision.view is None:
            continue
        face, color = decision.view.face, COLORS[k % len(COLORS)]
        outline = pixels(frame, on_face(face, part.box))
        assert outline is not None
        axes.add_patch(Polygon(outline, fill=False, edgecolor=color, linewidth=4))
        handle = None if part.handle is None else pixels(frame, on_face(face, part.handle))
        if handle is not None:
            axes.add_patch(Polygon(handle, fill=False, edgecolor="white", linewidth=3))
        x, y = outline.mean(0).tolist()
        kind = part.kind.replace("_", "\n")
        write(axes, (x, y), f"{k + 1} {decision.detection.label}\n{kind}", color)
    axes.set_axis_off()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/images/redkitchen.png"))
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = scan_to_scene(read_scan(args.folder), Path(folder) / "scene.json")
    frames = best_images(result)
    layout = ConstrainedLayoutEngine(h_pad=0.15)  # less would cut a title
    figure = Figure(figsize=(19.2, 6.8), dpi=100, layout=layout)
    above, *images = figure.subplots(1, 1 + len(frames), width_ratios=[1.15] + [1.0] * len(frames))
    count = draw_above(above, result)
    above.set_title("from above", fontsize=22)
    for axes, frame in zip(images, frames, strict=True):
        draw_image(axes, frame, result)
        axes.set_title(f"image {frame.name}", fontsize=22)
    FigureCanvasAgg(figure).print_png(str(args.out))
    print(f"{args.out}: {count} of {len(result.decisions)} objects drawn")
    for k, (decision, part) in enumerate(parts(result)):
        x, y, z = on_face(decision.view.face, part.box).mean(0) if decision.view else (0, 0, 0)
        print(f"| {k + 1} | {decision.detection.label} at ({x:.2f}, {y:.2f}, {z:.2f}) | "
              f"{part.kind} | {part.score:.2f} | {'yes' if part.handle else 'no'} |")  # fmt: skip
