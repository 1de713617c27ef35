"""The figure of an opening map: how far a part can be moved from each base position."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import label
from momapos.core.geometry import place_points
from momapos.model.scene import Scene
from momapos.planning import YAWS, OpeningMap, PlacementResult
from momapos.planning.grasps import slides

from .answer_plot import DPI, moving_links, new_figure, reached_value, set_view, shown_base, widen
from .image_files import check_figure_path, save_figure
from .palette import INK, PART, PART_BEFORE, PART_EDGE, SOFT_INK
from .room_plot import (
    box_bounds,
    box_outlines,
    draw_footprint,
    draw_room,
    draw_union,
    name_objects,
    room_bounds,
)

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.figure import Figure

SIZE = (8.0, 5.6)
"""Size of the figure [in]."""
COLORS = "viridis"
"""A colormap for all kinds of color vision, and for grayscale."""
MAX_LABELS = 13
"""Maximum number of values next to the color bar [-]."""
VIEW_MARGIN = 0.3
"""Margin of the view around the part, the colored cells and the base [m]."""
MAP = (0.06, 0.075, 0.735, 0.82)
BAR = (0.825, 0.3, 0.028, 0.545)
"""Where the map and its color bar are: left, bottom, width and height as shares of the figure."""
_MAX_TITLE_WIDTH = 0.92
"""Maximum width of the title, as a share of the figure [-]."""
CELL_LAYER, _PART_LAYER, DOT = 1.0, 7.0, 12.0


def draw_opening_map(
    scene: Scene, answer: PlacementResult, opening: OpeningMap, path: Path
) -> None:
    """Draw an opening map into a PNG, SVG or PDF file, which is written completely or not at all.

    Args:
        scene: The room.
        answer: The answer of the pipeline, whose base pose is drawn.
        opening: The map.
        path: The file.

    Raises:
        InputError: The file cannot be written, or its format is not supported.
    """
    check_figure_path(path)
    save_figure(_figure(scene, answer, opening), path, dpi=DPI)


def draw_opening_map_alone(opening: OpeningMap, path: Path) -> None:
    """Draw an opening map without an answer; otherwise like `draw_opening_map`."""
    check_figure_path(path)
    save_figure(_figure_alone(opening), path, dpi=DPI)


def _figure_alone(opening: OpeningMap) -> Figure:
    scene, task = opening.scene, opening.task
    content = np.concatenate([scene.object(task.object).bounds[:, :2], *_colored(opening)])
    figure, axes = new_map(scene, content)
    draw_room(axes, scene, target=task.object)
    _draw_cells(figure, axes, opening, slides=slides(scene, task))
    name_objects(axes, scene, target=task.object, keep_clear=_colored(opening))
    _write(figure, f"How far a robot can {task.verb} {task.object}/{task.joint}", ["the base"])
    return figure


def new_map(scene: Scene, content: Float[np.ndarray, "n 2"]) -> tuple[Figure, Any]:
    """Return a figure and its axes in meters, whose view contains points of the floor [m]."""
    figure = new_figure(SIZE)
    axes = figure.add_axes(MAP)
    bounds = room_bounds(scene) + np.array([[-0.1], [0.1]])
    ratio = MAP[2] * SIZE[0] / (MAP[3] * SIZE[1])
    view = np.stack([content.min(0) - VIEW_MARGIN, content.max(0) + VIEW_MARGIN])
    set_view(axes, widen(view, ratio, bounds))
    return figure, axes


def _figure(scene: Scene, answer: PlacementResult, opening: OpeningMap) -> Figure:
    chosen = shown_base(answer)
    figure, axes = new_map(scene, _content(scene, answer, opening, chosen))
    target = opening.task.object
    draw_room(axes, scene, target=target, moving=moving_links(scene, answer))
    _draw_cells(figure, axes, opening, slides=answer.slides)
    clear = [np.stack([xy.min(0), xy.max(0)]) for xy in _draw_part(axes, answer)]
    if chosen is not None:
        draw_footprint(axes, answer.prepared.robot, chosen, filled=False)
        axes.plot(*chosen[:2], "o", color=INK, markersize=4, markeredgecolor="white", zorder=DOT)
        xy = place_points(chosen[None], answer.prepared.robot.footprint)[0]
        clear.append(np.stack([xy.min(0), xy.max(0)]))
    name_objects(axes, scene, target=target, keep_clear=[*clear, *_colored(opening)])
    task, robot = opening.task, answer.prepared.robot
    lines = [robot.base_link]
    if chosen is not None:
        reached = reached_value(answer)
        to = "" if reached is None else f", {_value(reached, answer.slides)}"
        lines.append(f"dot: the answer{to}")
    title = f"How far {answer.plan.robot_name} can {task.verb} {task.object}/{task.joint}"
    _write(figure, title, lines)
    return figure


def _content(
    scene: Scene,
    answer: PlacementResult,
    opening: OpeningMap,
    chosen: Float[np.ndarray, "3"] | None,
) -> Float[np.ndarray, "n 2"]:
    """Return corners of the part, the colored cells and the base, which the view contains [m]."""
    motion = answer.prepared.motion
    points = [scene.object(opening.task.object).bounds[:, :2], box_bounds(motion.sweep())]
    points += _colored(opening)
    if chosen is not None:
        points.append(place_points(chosen[None], answer.prepared.robot.footprint)[0])
    return np.concatenate(points)


def _colored(opening: OpeningMap) -> list[Float[np.ndarray, "2 2"]]:
    return opening.corners(np.isfinite(opening.farthest))


def _draw_cells(figure: Figure, axes: Any, opening: OpeningMap, *, slides: bool) -> None:
    """Color the cells, with one color for each value, and draw the color bar."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    values, count = opening.values, len(opening.values)
    # Dark for the largest values, which stand out most on a light floor.
    colors = ListedColormap(colormaps[COLORS](np.linspace(0.97, 0.08, count)))
    order = np.argsort(np.abs(values[None] - opening.farthest.reshape(-1, 1)), axis=1)[:, 0]
    index = np.where(np.isnan(opening.farthest), np.nan, order.reshape(opening.farthest.shape))
    limits: dict[str, Any] = {"vmin": -0.5, "vmax": count - 0.5, "cmap": colors}
    if index.size:
        axes.imshow(
            index, extent=opening.extent, origin="lower", interpolation="nearest",
            zorder=CELL_LAYER, aspect="equal", **limits,
        )  # fmt: skip
    bar = figure.add_axes(BAR)
    bar.imshow(
        np.arange(count)[:, None], extent=(0, 1, -0.5, count - 0.5), origin="lower",
        interpolation="nearest", aspect="auto", **limits,
    )  # fmt: skip
    every = -(-count // MAX_LABELS)
    ticks = np.arange(count - 1, -1, -every)
    bar.set_yticks(ticks, [_value(values[k], slides) for k in ticks])
    bar.set_xticks([])
    bar.yaxis.tick_right()
    bar.tick_params(labelsize=7.5, color=SOFT_INK, labelcolor=INK, length=2.5, pad=3)
    for spine in bar.spines.values():
        spine.set(color=SOFT_INK, linewidth=0.6)
    bar.set_title("opens to", size=8, color=INK, loc="left", pad=6)


def _value(value: float, slides: bool) -> str:
    return f"{100 * value:.0f} cm" if slides else f"{np.degrees(value):.4g}°"


def _draw_part(axes: Any, answer: PlacementResult) -> list[Float[np.ndarray, "c 2"]]:
    """Draw the part before and after the answer's motion; return its outlines.

    The latter is transparent, as the base may stand under a lid or where the door is later.
    """
    motion = answer.prepared.motion
    before = box_outlines(motion.moving.at(0))
    draw_union(axes, before, fill=PART_BEFORE, edge=PART_EDGE, width=0.6, zorder=_PART_LAYER)
    reached = reached_value(answer)
    if reached is None:
        return before
    step = int(np.argmin(np.abs(motion.object_q - reached)))
    after = box_outlines(motion.moving.at(int(motion.value[step])))
    draw_union(axes, after, fill=PART, alpha=0.35, zorder=_PART_LAYER + 1)
    draw_union(axes, after, fill="none", edge=PART_EDGE, width=1.0, zorder=_PART_LAYER + 1)
    return before + after


def _write(figure: Any, what: str, lines: Sequence[str]) -> None:
    """Write the title, and at the right what a cell means.

    Args:
        figure: The figure.
        what: Beginning of the title.
        lines: The frame that stands in a cell, and what else is drawn.
    """
    title = figure.text(MAP[0], 0.94, label(f"{what}, by base position"), size=11, weight="bold")
    width = title.get_window_extent(figure.canvas.get_renderer()).width
    title.set(color=INK, size=11 * min(1.0, _MAX_TITLE_WIDTH * SIZE[0] * DPI / width))
    base, *further = lines
    text = ["cell: position of", f"{base},", f"best of {YAWS} yaws", "", "no color: the part",
            "cannot be moved"]  # fmt: skip
    for line in further:
        text += ["", line]
    figure.text(BAR[0], 0.27, label("\n".join(text)), size=7.5, color=SOFT_INK, va="top")
