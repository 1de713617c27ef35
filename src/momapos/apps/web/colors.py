"""The colors of the page: each one has one meaning, in all layers and in the legend."""

from __future__ import annotations

from momapos.apps import plots

PART, TARGET = plots.PART, plots.TARGET
"""The part that the task moves; the object it belongs to."""
FEASIBLE, PARTLY, INFEASIBLE = plots.GOOD, "#f2d600", plots.BAD
"""A base pose from which the task is feasible, and the tolerance around it; feasible in part;
infeasible, and what is in the way."""
UNKNOWN = "#9fc0dc"
"""A base pose that is not checked."""
DRIVE = "#0f3a8c"
"""The start and the path of the base."""
TOOL = plots.HANDLE
"""The path of the tool, and the grasps."""
FORCE = "#e0115f"
"""The force of the hand."""
SPHERES = "#2bb3c0"
"""Collision spheres of the robot."""
FREE = "#b9a6e6"
"""The free area; the opacity is the share of yaws."""
IMPORTANCE = ("#b4bdc6", "#5a3a00")
"""Importance from 0 to 1."""
COMPARED = {"blue": "#0072b2", "brown": "#8c510a", "pink": "#cc79a7", "green": "#7fbc41"}
"""Robots of compared answers."""
VERDICTS = {"": UNKNOWN, "feasible": FEASIBLE, "partly": PARTLY, "infeasible": INFEASIBLE}
"""Colors of the footprint by the verdict on the base pose."""

Color = tuple[int, int, int]


def rgb(color: str) -> Color:
    """Convert a color "#rrggbb" to three numbers up to 255."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
