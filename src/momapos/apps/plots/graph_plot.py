"""The scene graph over the room: the importance of objects for a task, and their relations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from momapos.core import label
from momapos.model.scene import Scene
from momapos.planning.importance import KINDS, Importance

from .answer_plot import COLUMN, DPI, MAP, SIZE, TextColumn, new_figure, set_view, widen
from .image_files import check_figure_path, save_figure
from .palette import FAINT, INK, RELATIONS, SELECTED, SELECTED_BAR, SOFT_INK, UNSELECTED, WAYPOINT
from .room_plot import draw_room, name_objects, room_bounds

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from matplotlib.figure import Figure

MAX_ROWS = 24
"""Maximum number of objects listed [-]."""
NODE_RADIUS = 0.068
"""Radius of a node [in]."""
MAX_NUMBERED = 60
"""Maximum number of nodes with a number; the others are dots [-]."""
_EDGE_LAYER, _LEADER_LAYER, _NODE_LAYER = 12.0, 11.0, 14.0


def draw_importance(scene: Scene, result: Importance, path: Path) -> None:
    """Draw the scene graph into a PNG, SVG or PDF file, which is written completely or not at all.

    Args:
        scene: The room.
        result: The ranking of its objects.
        path: The file.

    Raises:
        InputError: The file cannot be written, or its format is not supported.
    """
    check_figure_path(path)
    save_figure(_figure(scene, result), path, dpi=DPI)


def _figure(scene: Scene, result: Importance) -> Figure:
    figure = new_figure()
    axes = figure.add_axes(MAP)
    size = np.array([MAP[2] * SIZE[0], MAP[3] * SIZE[1]])
    view = _view(scene, result, size[0] / size[1])
    set_view(axes, view)
    draw_room(axes, scene, target=result.target)
    inch = float((view[1] - view[0])[0] / size[0])
    centers = result.graph.upright.center[:, :2]
    numbered, nodes = _ranks(result) < MAX_NUMBERED, centers.copy()
    moved = spread(centers[numbered], 3.2 * NODE_RADIUS * inch)
    nodes[numbered] = np.clip(moved, view[0] + NODE_RADIUS * inch, view[1] - NODE_RADIUS * inch)
    _draw_edges(axes, result, nodes)
    _draw_nodes(axes, result, centers, nodes)
    half = 1.1 * NODE_RADIUS * inch
    clear = [np.stack([xy - half, xy + half]) for xy in nodes[numbered]]
    name_objects(axes, scene, target=result.target, keep_clear=clear)
    column = figure.add_axes(COLUMN)
    _draw_panel(column, COLUMN[2] * SIZE[0], COLUMN[3] * SIZE[1], scene, result)
    return figure


def _view(scene: Scene, result: Importance, ratio: float) -> Float[np.ndarray, "2 2"]:
    """Return the corners of the view: the whole room, or only the objects with a number [m]."""
    whole = bounds = room_bounds(scene)
    if len(result.names) > MAX_NUMBERED:
        corners = np.array([item.bounds[:, :2] for item in result.graph.scene.objects])
        numbered = corners[_ranks(result) < MAX_NUMBERED]
        bounds = np.stack([numbered[:, 0].min(0), numbered[:, 1].max(0)])
    return widen(bounds + np.array([[-0.3], [0.3]]), ratio, whole)


def spread(points: Float[np.ndarray, "n 2"], apart: float) -> Float[np.ndarray, "n 2"]:
    """Push points apart until their distance is nearly `apart` [m]; distant points do not move."""
    # Coincident points move along different rays, by the golden angle.
    angle = 2.4 * np.arange(len(points))
    moved = points + 1e-3 * apart * np.stack([np.cos(angle), np.sin(angle)], -1)
    for _ in range(60):
        pairs = cKDTree(moved).query_pairs(apart, output_type="ndarray")
        if not len(pairs):
            break
        i, j = pairs.T
        offset = moved[i] - moved[j]
        length = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-9)
        push = 0.5 * (apart - length) * offset / length
        step = np.zeros_like(moved)
        np.add.at(step, i, push)
        np.add.at(step, j, -push)
        neighbors = np.maximum(np.bincount(pairs.ravel(), minlength=len(moved)), 1)
        moved += step / np.sqrt(neighbors)[:, None]
    return moved


# ---------------------------------------------------------------------------------------- the graph


def _chosen(result: Importance) -> Bool[np.ndarray, " n"]:
    """Return whether each object is in S, in the order of the scene."""
    chosen = set(result.selected())
    return np.array([name in chosen for name in result.graph.names])


def _ranks(result: Importance) -> Int[np.ndarray, " n"]:
    """Return the rank of each object, in the order of the scene."""
    rank = {name: k for k, name in enumerate(result.names)}
    return np.array([rank[name] for name in result.graph.names])


def _draw_edges(axes: Any, result: Importance, nodes: Float[np.ndarray, "n 2"]) -> None:
    """Draw lines by kind of relation; arrows point to the object that supports or contains."""
    from matplotlib.collections import LineCollection

    graph = result.graph
    for index, kind in enumerate(KINDS):
        look = RELATIONS[kind]
        mine = graph.kind == index
        lines = np.stack([nodes[graph.child[mine]], nodes[graph.parent[mine]]], axis=1)
        axes.add_collection(
            LineCollection(
                list(lines), colors=look.color, linewidths=look.width, linestyles=[look.dashes],
                alpha=look.alpha, zorder=_EDGE_LAYER + (kind != "near"),
            ),
            autolim=False,
        )  # fmt: skip
        if kind == "near":
            continue
        for a, b in lines:
            middle = a + 0.62 * (b - a)
            axes.annotate(
                "", xy=middle, xytext=middle - 0.02 * (b - a), zorder=_EDGE_LAYER + 1,
                arrowprops={
                    "arrowstyle": "-|>", "color": look.color, "lw": 0, "mutation_scale": 7,
                    "shrinkA": 0, "shrinkB": 0,
                },
            )  # fmt: skip


def _draw_nodes(
    axes: Any, result: Importance, centers: Float[np.ndarray, "n 2"], nodes: np.ndarray
) -> None:
    """Draw numbered circles, filled for S; a thin line connects a moved one to its object."""
    chosen, ranks = _chosen(result), _ranks(result)
    for mine, color in ((chosen, SELECTED), (~chosen, SOFT_INK)):
        dots = nodes[mine & (ranks >= MAX_NUMBERED)]
        axes.plot(*dots.T, "o", color=color, markersize=3, mew=0, zorder=_NODE_LAYER)
    for i in np.flatnonzero(ranks < MAX_NUMBERED):
        if np.linalg.norm(nodes[i] - centers[i]) > 0.02:
            leader = np.stack([centers[i], nodes[i]])
            axes.plot(*leader.T, color=SOFT_INK, lw=0.5, zorder=_LEADER_LAYER)
        draw_node(
            axes, nodes[i], str(ranks[i] + 1), chosen=bool(chosen[i]), target=bool(ranks[i] == 0),
            zorder=_NODE_LAYER + (len(ranks) - ranks[i]) * 1e-4,
        )  # fmt: skip


def draw_node(
    axes: Any, xy: np.ndarray, words: str, *, chosen: bool, target: bool, zorder: float = 1.0
) -> None:
    """Draw a node with its number."""
    axes.plot(
        *xy, marker="o", markersize=2 * 72 * NODE_RADIUS, color=SELECTED if chosen else UNSELECTED,
        markeredgecolor=WAYPOINT if target else SELECTED if chosen else SOFT_INK,
        markeredgewidth=1.8 if target else 0.7, linestyle="none", zorder=zorder, clip_on=False,
    )  # fmt: skip
    axes.text(
        *xy, label(words), ha="center", va="center_baseline", size=5.2, weight="bold",
        color="white" if chosen else INK, zorder=zorder + 5e-5, clip_on=True,
    )  # fmt: skip


# --------------------------------------------------------------------------------------- the column


def _draw_panel(axes: Any, width: float, height: float, scene: Scene, result: Importance) -> None:
    column = TextColumn(axes, width, height)
    column.text("importance for", size=9, down=0.19)
    column.text(result.target, size=11, weight="bold", fit=width, down=0.2)
    column.text(f"in {scene.name}", color=SOFT_INK, fit=width, down=0.16)
    column.text(
        f"{result.scorer}, {len(result.selected())} of {len(result.names)} in S "
        f"(alpha {result.alpha:g})", color=SOFT_INK, fit=width, down=0.24,
    )  # fmt: skip
    column.heading("Score")
    _write_scores(column, result, floor=1.12)
    _write_legend(column)


def _write_scores(column: TextColumn, result: Importance, *, floor: float) -> None:
    """Write a row with a bar for each object, most important first, and a line at alpha."""
    shown = min(MAX_ROWS, len(result.names))
    step = min(0.2, (column.y - floor) / (shown + (shown < len(result.names))))
    left, full = 0.2, column.width - 0.5
    top, limit = column.y + 0.11, left + full * result.alpha
    count = len(result.selected())
    for k in range(shown):
        name, score = result.names[k], float(result.scores[k])
        chosen = k < count
        column.axes.barh(
            column.y + 0.03, full * score, left=left, height=0.78 * step, zorder=0,
            color=SELECTED_BAR if chosen else FAINT,
        )  # fmt: skip
        draw_node(
            column.axes, np.array([0.09, column.y + 0.03]), str(k + 1), chosen=chosen,
            target=name == result.target,
        )  # fmt: skip
        column.text(
            name, x=left + 0.05, size=7, weight="bold" if chosen else "normal", fit=full, zorder=4
        )
        column.text(f"{score:.2f}", x=column.width, size=7, ha="right", down=step)
    column.axes.plot([limit] * 2, [top, column.y + step - 0.06], color=SOFT_INK, lw=0.7, zorder=1)
    column.axes.text(limit, top + 0.02, "alpha", size=6, color=SOFT_INK, ha="center")
    if shown < len(result.names):
        column.text(f"and {len(result.names) - shown} more", x=left + 0.05, size=7, color=SOFT_INK)


def _write_legend(column: TextColumn) -> None:
    column.y = 0.76
    column.heading("Legend")
    words = {"on": "on", "near": "near", "in": "in (open)", "inside": "inside (closed)"}
    right = 0.42 * column.width
    for k, kind in enumerate(words):
        look, x, y = RELATIONS[kind], right * (k % 2), column.y + 0.035
        column.axes.plot(
            [x, x + 0.24], [y, y], color=look.color, lw=look.width, ls=look.dashes,
            alpha=look.alpha,
        )  # fmt: skip
        if kind != "near":
            column.axes.plot(x + 0.16, y, marker=">", color=look.color, markersize=3.5, mew=0)
        column.text(words[kind], x=x + 0.32, size=7)
        column.y -= 0.18 * (k % 2)
    meanings = (("target", True, True), ("in S", True, False), ("not in S", False, False))
    for x, (meaning, chosen, target) in zip((0.09, 0.76, 1.26), meanings, strict=True):
        draw_node(column.axes, np.array([x, column.y + 0.035]), " ", chosen=chosen, target=target)
        column.text(meaning, x=x + 0.13, size=7)
