"""Horizontal slices of a reachability map: from how many directions the tool reaches a place."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import label
from momapos.model.records import ReachScorer

from .image_files import save_figure
from .palette import INK, SOFT_INK

if TYPE_CHECKING:
    from jaxtyping import Float

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
