"""Test that a redundant arm's "no" is rechecked with denser inverse kinematics."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.model.kinematics.ik import build_ik
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.planning.base_paths import OnwardPaths
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.placement.problem import Search
from momapos.planning.search_setup import SearchSetup

COARSE = PlaceConfig(rounds=1, count=128, grid_cell=0.1, grid_turn=20.0)


def test_the_finer_arm_differs_only_in_its_locked_joint_samples(
    fetch: Robot, segway: Robot
) -> None:
    spheres = fetch.spheres
    assert fetch.finer.chain is fetch.chain
    assert fetch.finer.spheres is spheres
    assert len(fetch.finer.ik.samples) > 4 * len(fetch.ik.samples)
    assert not fetch.ik.complete
    assert segway.ik.complete


def test_the_recheck_finds_what_coarse_inverse_kinematics_misses(
    monkeypatch: pytest.MonkeyPatch, kitchen: Scene
) -> None:
    fetch = load_robot("fetch")
    vars(fetch)["ik"] = build_ik(fetch.chain, samples_per_joint=1)
    rechecks: list[Search] = []
    refine = SearchSetup.refine

    def spied_recheck(self: SearchSetup, found: Search, place: PlaceConfig) -> Search:
        assert found.is_no
        rechecks.append(refine(self, found, place))
        return rechecks[-1]

    monkeypatch.setattr(SearchSetup, "refine", spied_recheck)
    departures: list[bytes] = []
    check = OnwardPaths.__call__

    def spied_departure(self: OnwardPaths, base: np.ndarray) -> bool:
        departures.append(base.tobytes())
        return check(self, base)

    monkeypatch.setattr(OnwardPaths, "__call__", spied_departure)
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    plan = plan_base_placement(kitchen, fetch, task, config=PipelineConfig(place=COARSE)).plan
    assert len(rechecks) == 1
    assert plan.status == "solved"
    assert plan.base_pose == tuple(rechecks[0].base.tolist())
    assert rechecks[0].base.tobytes() in departures
