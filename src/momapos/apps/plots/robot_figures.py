"""Figures of a robot: its collision spheres, and slices of its reachability map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import label
from momapos.model.records import ReachScorer
from momapos.model.robots import Robot

from .image_files import save_figure
from .palette import INK, SOFT_INK
from .room_plot import box_corners

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


HEIGHTS = (0.1, 0.4, 0.7, 1.0, 1.3, 1.6)
"""Heights of the slices above the floor [m]."""
COLUMNS = 3
COLORS, PALE, DARK = "viridis", 0.97, 0.08
"""Light for few directions, dark for many."""


def reach_slice(
    reach: ReachScorer,
    T_tool_axes: Float[np.ndarray, "3 3"],
    farthest: float,
    height: float,
    *,
    cell: float = 0.06,
    directions: int = 26,
) -> tuple[Float[np.ndarray, "n n"], float]:
    """Compute the share of directions from which the tool reaches places at a height.

    Args:
        reach: The robot's map.
        T_tool_axes: Columns in the tool frame: approach direction, a unit vector across it, and
            their cross product; see `tool_axes`.
        farthest: Largest distance from the base's origin along x and y [m].
        height: Height above the floor [m].
        cell: Edge of a cell [m].
        directions: Number of approach directions, spread evenly over the sphere [-].

    Returns:
        Shares in [0, 1] over a square around the base, in the base frame, and half its edge [m].
    """
    half = cell * np.ceil(farthest / cell)
    axis = np.arange(-half + cell / 2, half, cell)
    x, y = np.meshgrid(axis, axis)
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], -1)
    rotations = _spread(directions) @ T_tool_axes.T
    Ts = np.tile(np.eye(4), (len(points), len(rotations), 1, 1))
    Ts[..., :3, :3] = rotations
    Ts[..., :3, 3] = points[:, None]
    scores = reach.min_score(np.zeros((1, 3)), np.ascontiguousarray(Ts.reshape(-1, 1, 4, 4)))
    share = (scores.reshape(len(points), len(rotations)) > 0).mean(1)
    return share.reshape(x.shape), float(half)


def tool_axes(
    approach: Float[np.ndarray, "3"], across: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3 3"]:
    """Return the axes for `reach_slice` from two perpendicular unit vectors."""
    return np.stack([approach, across, np.cross(approach, across)], -1)


def _spread(count: int) -> Float[np.ndarray, "r 3 3"]:
    """Return rotations whose first axes are spread evenly over the sphere (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k
    ahead = np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar),
                      np.cos(polar)], -1)  # fmt: skip
    up = np.where(np.abs(ahead[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = np.cross(up, ahead)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return np.stack([ahead, side, np.cross(ahead, side)], -1)


def draw_reach(
    reach: ReachScorer,
    T_tool_axes: Float[np.ndarray, "3 3"],
    farthest: float,
    path: Path,
    *,
    title: str,
    footprint: Float[np.ndarray, "k 2"] | None = None,
) -> None:
    """Draw slices at several heights, seen from above.

    Args:
        reach, T_tool_axes, farthest: As for `reach_slice`.
        path: A file that ends in .png, .svg or .pdf.
        title: Beginning of the title, such as the robot's name.
        footprint: Footprint in the base frame [m]; None where unknown.

    Raises:
        InputError: The file cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    figure.suptitle(
        label(f"{title}: share of directions the tool can come from"), size=11, color=INK
    )
    rows = -(-len(HEIGHTS) // COLUMNS)
    grid = figure.subplots(rows, COLUMNS, sharex=True, sharey=True)
    for axes, height in zip(grid.flat, HEIGHTS, strict=True):
        share, half = reach_slice(reach, T_tool_axes, farthest, height)
        image = _draw_slice(axes, share, half)
        if footprint is not None:
            axes.fill(*footprint.T, facecolor="none", edgecolor=INK, linewidth=1.2)
        axes.plot(0.0, 0.0, "+", color=INK, markersize=6)
        axes.set_title(label(f"{height:.1f} m above the floor"), size=9, color=INK)
    for axes in grid[-1]:
        axes.set_xlabel("x [m], forward", size=8)
    for axes in grid[:, 0]:
        axes.set_ylabel("y [m]", size=8)
    bar = figure.colorbar(image, ax=grid, shrink=0.6, format=lambda v, _: f"{100 * v:.0f} %")
    bar.set_label("of all directions", size=8)
    bar.ax.tick_params(labelsize=8)
    save_figure(figure, path, dpi=110)


def _draw_slice(axes: Any, share: Float[np.ndarray, "n n"], half: float) -> Any:
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    colors = ListedColormap(colormaps[COLORS](np.linspace(PALE, DARK, 64)))
    image = axes.imshow(
        np.where(share > 0, share, np.nan), extent=(-half, half, -half, half), origin="lower",
        interpolation="nearest", cmap=colors, vmin=0.0, vmax=1.0,
    )  # fmt: skip
    axes.tick_params(labelsize=7.5, color=SOFT_INK)
    axes.set_aspect("equal")
    return image
