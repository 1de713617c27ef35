"""Survey where a robot can start and drive in a scene, before any task is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.grasps import in_front_of_parts
from momapos.planning.navigation import (
    DrivableFloor,
    build_navigation_map,
    check_arm_at_home,
    drivable_floor,
)

from .task_setup import roomy_place

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class FloorSurvey:
    """Where a robot can start and drive."""

    start: Float[np.ndarray, "3"] | None
    """The scene's start, else a chosen one: x [m], y [m], yaw [rad]; None if it fits nowhere."""
    problem: str
    """Why the robot cannot start; "" if it can."""
    floor: DrivableFloor | None
    """None without a start."""

    def distances(self, points: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, " m"]:
        """Return the distance of points to the nearest position that the base reaches [m]."""
        from scipy.spatial import cKDTree

        if self.floor is None:
            return np.full(len(points), np.inf)
        return np.asarray(cKDTree(self.floor.cells).query(points)[0])


def survey_floor(scene: Scene, robot: Robot) -> FloorSurvey:
    """Survey where a robot can start and drive.

    Args:
        scene: The scene; its start is checked. Without one, a start is chosen as for a task.
        robot: The robot, with its arm at home.
    """
    start, problem = scene.start, ""
    try:
        nav_map = build_navigation_map(scene, robot)
        if start is None:
            start = roomy_place(scene, nav_map, in_front_of_parts(scene))
        else:
            check_arm_at_home(nav_map, start)
    except SceneError as error:
        problem = str(error)
    if start is None:
        return FloorSurvey(None, problem, None)
    return FloorSurvey(start, problem, drivable_floor(scene, robot, start))
