"""The figure of a robot in its home configuration, with its collision spheres."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import label
from momapos.model.robots import Robot

from .image_files import save_figure
from .outlines import box_corners

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from matplotlib.axes import Axes


def draw_robot(robot: Robot, path: Path, others: Sequence[Robot] = ()) -> None:
    """Draw a robot in its home configuration from above and from the right.

    Args:
        robot: The robot, with one of its arms.
        path: The file.
        others: The same robot with its other arms.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6), layout="constrained")
    above, side = figure.subplots(1, 2)
    corners = np.vstack([robot.footprint, robot.footprint[:1]])
    above.plot(*corners.T, "k--", lw=1)
    front = float(robot.footprint[:, 0].max())
    forward = {"arrowstyle": "-|>", "color": "tab:red"}
    above.annotate("", (front + 0.15, 0), (front, 0), arrowprops=forward)
    side.axhline(0, color="0.5", lw=1)
    for axes, (i, j) in ((above, (0, 1)), (side, (0, 2))):
        _draw_base(robot, axes, i, j)
        for arm in (robot, *others):
            _draw_arm(arm, axes, i, j)
        axes.autoscale_view()
        axes.set(aspect="equal", xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]")
    above.set_title("from above, dashed: footprint, red: forward")
    side.set_title("from the right")
    figure.suptitle(
        label(f"{robot.name} at home; orange: gripper, black: approach, green: across the fingers")
    )
    save_figure(figure, path, dpi=110)


def _draw_base(robot: Robot, axes: Axes, i: int, j: int) -> None:
    """Draw the boxes of the base, projected onto axes i and j of its frame."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Polygon
    from scipy.spatial import ConvexHull

    corners = box_corners(robot.base)[:, :, [i, j]]
    boxes = [Polygon(points[ConvexHull(points).vertices]) for points in corners]
    axes.add_collection(PatchCollection(boxes, facecolor="0.8", edgecolor="0.5", alpha=0.7))


def _draw_arm(robot: Robot, axes: Axes, i: int, j: int) -> None:
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    centers, held = sphere_centers(robot, robot.home)
    circles = [Circle((c[i], c[j]), r) for c, r in zip(centers, robot.spheres.radius, strict=True)]
    colors = np.where(held, "tab:orange", "tab:blue")
    axes.add_collection(PatchCollection(circles, facecolor=colors, edgecolor="none", alpha=0.25))
    T = robot.chain.tool_poses(robot.home[None])[0]
    origin, tip = T[:3, 3], T[:3, 3] + 0.12 * T[:3, :3] @ robot.approach_axis
    axes.annotate("", tip[[i, j]], origin[[i, j]], arrowprops={"arrowstyle": "->", "color": "k"})
    across = 0.05 * T[:3, :3] @ robot.closing_axis
    ends = np.stack([origin - across, origin + across])
    axes.plot(ends[:, i], ends[:, j], color="tab:green", lw=2)


def sphere_centers(
    robot: Robot, q: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "s 3"], Int[np.ndarray, " s"]]:
    """Return the centers of the collision spheres in the base frame [m], and their gripper part."""
    from momapos.model.collision import place_segments
    from momapos.model.kinematics import chain_arrays

    chain, spheres = robot.chain, robot.spheres
    R, p = np.empty((chain.last + 1, 3, 3)), np.empty((chain.last + 1, 3))
    place_segments(np.asarray(q, float), np.zeros(3), chain_arrays(chain), R, p)
    count = np.diff(spheres.start)
    segment = np.repeat(spheres.segment, count)
    centers = np.einsum("sij,sj->si", R[segment], spheres.center) + p[segment]
    return centers, np.repeat(spheres.gripper, count)
