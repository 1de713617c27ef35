"""Hands that do not come fully open do their tasks in physics."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cupboards import between_posts, furniture_room, niche

from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene_files import save_scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.reachability.map_store import load_reach_map
from momapos.simulation.execution_run import Stage
from momapos.simulation.simulation import Simulation
from momapos.workflows.run import run_plan


@pytest.mark.parametrize(
    ("kind", "name", "to"),
    [pytest.param("posts", "tiago", "30cm", marks=pytest.mark.slow), ("niche", "fetch", "30cm")],
)
def test_a_hand_opens_to_the_width_of_its_plan_and_no_farther(
    tmp_path: Path, kind: str, name: str, to: str
) -> None:
    parts = {"posts": lambda: between_posts(0.1), "niche": lambda: niche(0.09)}[kind]()
    scene = save_scene(furniture_room(tmp_path, parts), tmp_path / "s.json")
    (joint,) = scene.object("cupboard").model.joints
    task, whole = make_task(scene, "open", "cupboard", joint, to), load_robot(name)
    plan = plan_base_placement(scene, whole, task).plan
    fingers = {k: v for k, v in plan.robot_rest.items() if whole.model.rest.get(k) != v}
    assert len(fingers) == 2
    widest = dict.fromkeys(fingers, 1.0)

    def watch(world: Simulation, *_: float | Stage) -> None:
        for finger in fingers:
            widest[finger] = min(widest[finger], float(world.data.joint(finger).qpos[0]))

    record = run_plan(plan, scene, whole, load_reach_map(whole), watch=watch)
    assert record.execution.success, record.execution.reason
    assert record.execution.hold == "contact"
    # Fingers stand at zero when they are fully open.
    assert widest == pytest.approx(fingers, abs=2e-3)
