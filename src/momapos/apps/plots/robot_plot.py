"""A robot from above: its footprint with a heading, and its arm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core.geometry import apply, place_points, pose, pose_planar
from momapos.model.kinematics import chain_arrays, forward, stand_at_origin
from momapos.model.robots import Robot

from .outlines import draw_union, outline
from .palette import ARM, INK

if TYPE_CHECKING:
    from jaxtyping import Float

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
