"""A "no" of a redundant arm is looked at with inverse kinematics that overlooks less."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.model.kinematics.ik import build_ik
from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene_files import load_scene
from momapos.planning.base_paths import WaysOn
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.tasks import make_task
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.placement.problem import Search
from momapos.planning.plan import plan_base_placement
from momapos.planning.search_setup import ReadySearch

COARSE = PlaceConfig(rounds=1, count=128, grid_cell=0.1, grid_turn=20.0)


def test_the_finer_arm_is_the_same_but_for_the_joints_that_are_locked() -> None:
    robot = load_robot("fetch")
    spheres = robot.spheres
    assert robot.finer.chain is robot.chain
    assert robot.finer.spheres is spheres
    assert len(robot.finer.ik.samples) > 4 * len(robot.ik.samples)
    assert not robot.ik.complete
    assert load_robot("segway_ur5e").ik.complete


def test_what_coarse_inverse_kinematics_overlooks_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, scene = load_robot("fetch"), load_scene("kitchen_small")
    vars(robot)["ik"] = build_ik(robot.chain, samples_per_joint=1)
    looked: list[Search] = []
    finely = ReadySearch.finely

    def spied(self: ReadySearch, found: Search, place: PlaceConfig) -> Search:
        assert found.is_no
        looked.append(finely(self, found, place))
        return looked[-1]

    monkeypatch.setattr(ReadySearch, "finely", spied)
    asked: list[bytes] = []
    leads = WaysOn.__call__

    def asks(self: WaysOn, base: np.ndarray) -> bool:
        asked.append(base.tobytes())
        return leads(self, base)

    monkeypatch.setattr(WaysOn, "__call__", asks)
    task = make_task(scene, "open", "fridge", "door_hinge")
    plan = plan_base_placement(scene, robot, task, config=PipelineConfig(place=COARSE)).plan
    assert len(looked) == 1
    assert plan.status == "solved"
    assert looked[0].base is not None
    assert plan.base_pose == tuple(looked[0].base.tolist())
    assert looked[0].base.tobytes() in asked
