"""Laws of what lies flat on the floor: planner, drive, exact check and physics go over it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import cabinet_room

from momapos.model.plan_files.plan_format import write_plan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import MAX_STEP_HEIGHT, SceneObject
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.simulation.exact_run import run_exactly
from momapos.verification.plan_check import verify_files


@pytest.mark.parametrize(
    ("height", "status"), [(0.001, "solved"), (MAX_STEP_HEIGHT, "solved"), (0.006, "infeasible")]
)
def test_a_base_stands_on_and_drives_over_what_is_at_most_5_mm_high(
    tmp_path: Path, segway: Robot, height: float, status: str
) -> None:
    room = cabinet_room(tmp_path)
    # The rug lies all around the cabinet; the robot starts away from it.
    rug = SceneObject.box("rug", (8.0, 7.0, height), (0.0, 0.0, height / 2))
    scene = replace(room, objects=(*room.objects, rug), start=np.array([0.0, -5.0, 1.57]))
    save_scene(scene, tmp_path / "room.json")
    scene = load_scene(tmp_path / "room.json")
    answer = plan_base_placement(scene, segway, make_task(scene, "open", "cabinet"))
    assert answer.plan.status == status
    if answer.plan.feasible:
        write_plan(answer.plan, tmp_path / "plan.json")
        assert verify_files(tmp_path / "plan.json").valid
        done = run_exactly(answer.plan, scene, segway).execution
        assert done is not None
        assert done.success, done.reason
