"""Figures of a reach study: how well poses are reached, and from where how many are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import label
from momapos.core.geometry import place_points
from momapos.model.records import ToolPose
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning import PoseMap, ReachStudy
from momapos.planning.grasps import surface_links

from .answer_plot import DPI, new_figure
from .image_files import check_figure_path, save_figure
from .opening_plot import BAR, CELL_LAYER, COLORS, DOT, MAP, SIZE, new_map
from .palette import BAD, FURNITURE, INK, SOFT_INK, WAYPOINT
from .room_plot import draw_footprint, draw_room, name_objects

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_pose_map(
    scene: Scene,
    robot: Robot,
    poses: Sequence[ToolPose],
    found: PoseMap,
    bases: Sequence[Sequence[float]],
    path: Path,
) -> None:
    """Draw how many poses each base position serves, into a PNG, SVG or PDF file.

    Args:
        scene: The room.
        robot: The robot.
        poses: The poses, drawn as dots.
        found: The map.
        bases: Base poses to draw, such as those of an answer.
        path: The file, which is written completely or not at all.

    Raises:
        InputError: The file cannot be written, or its format is not supported.
    """
    check_figure_path(path)
    points = np.array([pose.xyz[:2] for pose in poses])
    colored = found.corners(found.served > 0)
    figure, axes = new_map(scene, np.concatenate([points, *colored]))
    draw_room(axes, scene)
    most = int(np.nanmax(found.served, initial=1.0))
    shown = np.where(found.served > 0, found.served, np.nan)
    if shown.size:
        image = axes.imshow(
            shown, extent=found.extent, origin="lower", interpolation="nearest", zorder=CELL_LAYER,
            aspect="equal", cmap=f"{COLORS}_r", vmin=1, vmax=max(most, 2),
        )  # fmt: skip
        _bar(figure, image, "poses")
    axes.plot(*points.T, ".", color=WAYPOINT, markersize=4, zorder=DOT)
    for base in bases:
        draw_footprint(axes, robot, np.asarray(base, float), filled=False)
    name_objects(axes, scene, keep_clear=[np.stack([points.min(0), points.max(0)]), *colored])
    title = f"How many of {found.poses} poses {robot.title} reaches, by base position"
    figure.text(MAP[0], 0.94, label(title), size=10, weight="bold", color=INK)
    words = (
        f"cell: position of\n{robot.base_link},\nbest yaw\n\ndots: the poses\n\n"
        "outlines: base poses\nof the answer"
    )
    figure.text(BAR[0], 0.27, label(words), size=7.5, color=SOFT_INK, va="top")
    save_figure(figure, path, dpi=DPI)


def draw_study(
    scene: Scene,
    robot: Robot,
    surface: str,
    poses: Sequence[ToolPose],
    study: ReachStudy,
    path: Path,
) -> None:
    """Draw a surface with its points, colored by how well the arm reaches each.

    Args:
        scene: The room.
        robot: The robot.
        surface: The object, or a part of it as OBJECT/PART.
        poses: Tool poses at its points.
        study: How well each is reached.
        path: A PNG, SVG or PDF file, which is written completely or not at all.

    Raises:
        InputError: The file cannot be written, or its format is not supported.
    """
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    check_figure_path(path)
    figure = new_figure(SIZE)
    axes: Any = figure.add_axes(MAP, projection="3d")
    axes.computed_zorder = False
    name, _, part = surface.partition("/")
    item = scene.object(name)
    links = surface_links(item, part)
    poses_of = item.link_poses()
    hulls = [
        hull.vertices[hull.faces] @ poses_of[link][:3, :3].T + poses_of[link][:3, 3]
        for link in links
        for hull in item.model.hulls[link]
    ]
    if hulls:
        axes.add_collection3d(Poly3DCollection(
            np.concatenate(hulls), facecolor=FURNITURE, edgecolor="none", alpha=0.35,
            zorder=CELL_LAYER,
        ))  # fmt: skip
    points = np.array([pose.xyz for pose in poses])
    off, on = points[~study.reached], points[study.reached]
    axes.scatter(*off.T, s=9, color=BAD, marker="x", linewidth=0.8, depthshade=False, zorder=DOT)
    if len(on):
        values = study.dexterity[study.reached]
        dots = axes.scatter(
            *on.T, s=20, c=values, cmap=f"{COLORS}_r", vmin=0.0, vmax=float(values.max()),
            depthshade=False, zorder=DOT,
        )  # fmt: skip
        _bar(figure, dots, "dexterity")
    if study.base_pose is not None:
        x, y, yaw = study.base_pose
        outline = place_points(np.array([[x, y, yaw]]), robot.footprint)[0]
        closed = np.concatenate([outline, outline[:1]])
        away = np.array([x, y]) - points[:, :2].mean(0)
        axes.view_init(elev=22.0, azim=float(np.degrees(np.arctan2(away[1], away[0]))) + 25.0)
        axes.plot(*closed.T, np.zeros(len(closed)), color=INK, linewidth=1.2)
        points = np.concatenate([points, np.column_stack([closed, np.zeros(len(closed))])])
    low, high = points.min(0), points.max(0)
    axes.set_box_aspect(np.maximum(high - low, 0.1))
    axes.set_xlabel("x [m]", size=8, color=SOFT_INK)
    axes.set_ylabel("y [m]", size=8, color=SOFT_INK)
    axes.set_zlabel("z [m]", size=8, color=SOFT_INK)
    axes.tick_params(labelsize=7, colors=SOFT_INK)
    axes.grid(visible=False)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(4))
    count = f"{int(study.reached.sum())} of {len(poses)}"
    title = f"{robot.title} reaches {count} points of {surface} from one base pose"
    figure.text(MAP[0], 0.94, label(title), size=10, weight="bold", color=INK)
    words = (
        "color: how evenly the arm\nmoves the tool there, in all\ndirections\n\n"
        "cross: not reached\n\noutline: the base"
    )
    figure.text(BAR[0] - 0.02, 0.27, label(words), size=7.5, color=SOFT_INK, va="top")
    save_figure(figure, path, dpi=DPI)


def _bar(figure: Figure, colored: Any, title: str) -> None:
    bar = figure.colorbar(colored, cax=figure.add_axes(BAR))
    bar.ax.tick_params(labelsize=7.5, color=SOFT_INK, labelcolor=INK, length=2.5, pad=3)
    bar.ax.set_title(label(title), size=8, color=INK, loc="left", pad=6)
    bar.outline.set(edgecolor=SOFT_INK, linewidth=0.6)
