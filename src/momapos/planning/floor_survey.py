"""Survey where a robot can drive in a scene, before any task is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError
from momapos.core.geometry import inscribed_radius
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.grasps import in_front_of_parts, scene_boxes
from momapos.planning.navigation import (
    CELL,
    CostMap,
    base_height,
    build_cost_map,
    build_navigation_map,
    check_arm_at_home,
    floor_plan,
)

from .task_setup import roomy_place

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class FloorSurvey:
    """Where the base of a robot can drive from its start, by its inscribed circle.

    The circle is smaller than the base, so the robot may get less far, but never farther.
    """

    start: Float[np.ndarray, "3"] | None
    """The scene's start, else a chosen one: x [m], y [m], yaw [rad]; None if there is no place."""
    problem: str
    """Why the robot cannot start; "" if it can."""
    free: float
    """Area in which the circle fits [m^2]."""
    reachable: float
    """Part of this area that the circle reaches from the start [m^2]."""
    cells: Float[np.ndarray, "n 2"]
    """Centers of the reachable cells [m]."""

    def nearest(self, points: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, " m"]:
        """Return the distance of points to the nearest reachable position [m]."""
        from scipy.spatial import cKDTree

        if not len(self.cells):
            return np.full(len(points), np.inf)
        return np.asarray(cKDTree(self.cells).query(points)[0])


def survey_floor(scene: Scene, robot: Robot) -> FloorSurvey:
    """Survey where a robot can drive.

    Args:
        scene: The scene; its start is checked. Without one, a start is chosen as for a task.
        robot: The robot, with its arm at home.
    """
    start, problem = None, ""
    try:
        nav_map = build_navigation_map(scene, robot)
        if scene.start is None:
            start = roomy_place(scene, nav_map, in_front_of_parts(scene))
        else:
            start = np.asarray(scene.start, float)
            check_arm_at_home(nav_map, start)
    except SceneError as error:
        problem = str(error)
    if start is None:
        return FloorSurvey(None, problem, 0.0, 0.0, np.zeros((0, 2)))
    plan = floor_plan(
        scene_boxes(scene), height=base_height(robot), floor_polygon=scene.floor_polygon,
        start=start[:2],
    )  # fmt: skip
    costs = build_cost_map(plan, start[:2], radius=inscribed_radius(robot.footprint))
    cells = _reachable_cells(costs)
    free = float(costs.free.sum()) * CELL**2
    return FloorSurvey(start, problem, free, len(cells) * CELL**2, cells)


def _reachable_cells(costs: CostMap) -> Float[np.ndarray, "n 2"]:
    i, j = np.nonzero(np.isfinite(costs.distance))
    return np.asarray(costs.origin + (np.column_stack([j, i]) + 0.5) * CELL)
