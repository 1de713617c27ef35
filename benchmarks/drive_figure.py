"""Draw a drive from above: the room, the planned and the driven path, and footprints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from drive_rooms import Question
from momapos.apps.plots import GOOD, INK, SELECTED, SOFT_INK, WAYPOINT, room_bounds
from momapos.apps.plots.room_plot import draw_footprint, draw_room, name_objects
from momapos.core.geometry import place_points, wrap_angle
from momapos.model.scene import Scene
from momapos.planning.navigation import DriveRecord, NavigationMap, plan_path

EVERY = 0.25
"""Path length between two drawn footprints; a radian counts as 0.5 m [m]."""


def draw_drive(
    scene: Scene, nav_map: NavigationMap, question: Question, record: DriveRecord, path: Path
) -> None:
    """Draw a drive into a PNG file."""
    figure = Figure(figsize=(7.2, 5.4), dpi=130, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.09, 0.08, 0.68, 0.85))
    low, high = room_bounds(scene)
    axes.set_aspect("equal")
    axes.set_xlim(low[0] - 0.1, high[0] + 0.1)
    axes.set_ylim(low[1] - 0.1, high[1] + 0.1)
    draw_room(axes, scene)
    poses = record.poses
    step = np.diff(poses, axis=0)
    turn = np.abs(wrap_angle(step[:, 2]))
    gone = np.concatenate([[0], np.cumsum(np.hypot(*step.T[:2]) + 0.5 * turn)])
    some = np.unique(np.searchsorted(gone, np.arange(0, gone[-1], EVERY)))
    outlines = place_points(poses[some], nav_map.prisms.outlines[0])
    blue: dict[str, Any] = {
        "facecolors": (0.16, 0.48, 0.72, 0.05),
        "edgecolors": (0.16, 0.48, 0.72, 0.35),
    }
    axes.add_collection(
        PolyCollection(list(outlines), linewidths=0.7, zorder=8, label="footprint", **blue)
    )
    planned = plan_path(nav_map, question.start, question.goal)
    if planned is not None:
        line: dict[str, Any] = {"color": WAYPOINT, "lw": 1.3, "ls": (0, (4, 2)), "zorder": 14}
        axes.plot(*planned.poses.T[:2], label=f"planned, {planned.length:.2f} m", **line)
    driven = f"driven, {record.length:.2f} m"
    axes.plot(*poses.T[:2], color=SELECTED, lw=1.8, zorder=13, label=driven)
    draw_footprint(axes, nav_map.robot, question.start, dashed=True)
    draw_footprint(axes, nav_map.robot, question.goal)
    for name, pose, color in (("start", question.start, INK), ("goal", question.goal, GOOD)):
        axes.plot(*pose[:2], "o", ms=5, color=color, zorder=16, label=name)
    name_objects(axes, scene)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=8, frameon=False)
    axes.set_xlabel("x [m]", fontsize=8, color=SOFT_INK)
    axes.set_ylabel("y [m]", fontsize=8, color=SOFT_INK)
    axes.tick_params(labelsize=7, colors=SOFT_INK)
    axes.set_title(
        f"{nav_map.robot.name} in {scene.name}: {record.time:.0f} s, nearest to furniture "
        f"{100 * record.clearance:.0f} cm", fontsize=9, color=INK, loc="left",
    )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    canvas.print_png(str(path))
