"""Figures for notebooks, as the content of PNG files."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from momapos.model.scene import Scene
from momapos.planning import OpeningMap, PlacementResult
from momapos.planning.reachability import ReachMap, load_reach

from .answer_plot import draw_answer
from .opening_plot import draw_opening_map_alone
from .robot_figures import draw_reach, tool_axes
from .room_plot import draw_scene


def scene_png(scene: Scene) -> bytes:
    """Draw a scene from above."""
    return _content(lambda path: draw_scene(scene, path))


def answer_png(answer: PlacementResult) -> bytes:
    """Draw an answer, with the scene as it was prepared for planning."""
    prepared = answer.prepared
    return _content(
        lambda path: draw_answer(prepared.scene, answer, load_reach(prepared.robot), path)
    )


def opening_png(opening: OpeningMap) -> bytes:
    """Draw an opening map."""
    return _content(lambda path: draw_opening_map_alone(opening, path))


def reach_png(reach: ReachMap) -> bytes:
    """Draw slices of a reachability map; the approach direction is the last joint's axis."""
    along = reach.line_tool[0]
    aside = np.eye(3)[np.argmin(np.abs(along))]
    across = np.cross(along, aside) / np.linalg.norm(np.cross(along, aside))
    point = reach.line_tool[1]
    farthest = reach.reach + float(np.linalg.norm(point) + np.linalg.norm(reach.axis_xy))
    axes = tool_axes(along, across)
    return _content(lambda path: draw_reach(reach, axes, farthest, path, title="This map"))


def _content(draw: Callable[[Path], None]) -> bytes:
    with tempfile.TemporaryDirectory(prefix="momapos-") as folder:
        path = Path(folder) / "figure.png"
        draw(path)
        return path.read_bytes()
