"""Provide the placement geometry of `rooms.cabinet_room`."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.model.robots.robot import Robot
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.placement.area import PlacementGeometry
from rooms import cabinet_room


@pytest.fixture(scope="module")
def geometry(tmp_path_factory: pytest.TempPathFactory, segway: Robot) -> PlacementGeometry:
    scene = cabinet_room(tmp_path_factory.mktemp("room"))
    motion = task_motion(
        scene, segway, make_task(scene, "open", "cabinet"), PipelineConfig().motion
    )
    Ts = np.ascontiguousarray(motion.Ts_world_tool[:, motion.waypoint_steps])
    return PlacementGeometry(segway, Ts, motion.static, motion.sweep(), scene.floor_polygon, 0.01)
