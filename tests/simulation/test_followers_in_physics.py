"""Parts with mimic joints open in physics as in the plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import FOLLOWERS, furniture_room

from momapos.model.robots.robot import Robot
from momapos.model.scene.scene_files import save_scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.simulation.execute import attempt
from momapos.simulation.execution_run import Stage
from momapos.simulation.simulation import Simulation


@pytest.mark.parametrize(
    "kind",
    [
        "rails behind the tray", "a folding door",
        pytest.param("a chain of rails", marks=pytest.mark.slow),
        pytest.param("a door that lags behind by an offset", marks=pytest.mark.slow),
        pytest.param("a lid that turns as its drawer slides", marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_a_part_and_its_followers_open_in_physics(tmp_path: Path, kind: str, fetch: Robot) -> None:
    parts, follower, leader = FOLLOWERS[kind]
    scene = save_scene(furniture_room(tmp_path, parts), tmp_path / "s.json")
    task = make_task(scene, "open", "cupboard", leader)
    plan = plan_base_placement(scene, fetch, task).plan
    item = scene.object("cupboard")
    mimic = item.joint(follower).mimic
    apart: list[float] = []

    def watch(world: Simulation, *_: float | Stage) -> None:
        names = {world.model.joint(k).name for k in range(world.model.njnt)}
        value = {name: float(world.data.joint(name).qpos[0]) for name in names if "part" in name}
        apart.append(abs(mimic.at(value["part"]) - value[f"part/{follower}"]))

    outcome = attempt(scene, fetch, plan.base_pose, plan.motion, task, watch=watch)
    assert outcome.execution.success, outcome.execution.reason
    assert np.max(apart) < 0.02
