"""Laws of the belief of a robot between two tries of a run."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.core.stopwatch import Stopwatch
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.navigation.driving import DriveRecord
from momapos.planning.navigation.footprint_map import build_navigation_map
from momapos.planning.reachability.map_store import load_reach_map
from momapos.planning.result import PlacementResult
from momapos.simulation.config import ComplianceConfig
from momapos.workflows.joint_belief import JointBeliefs
from momapos.workflows.replanning import Replanner


@pytest.fixture(scope="module")
def replanner(tmp_path_factory: pytest.TempPathFactory, kitchen: Scene, segway: Robot) -> Replanner:
    reach = load_reach_map(segway, tmp_path_factory.mktemp("maps"))
    task = make_task(kitchen, "open", "microwave", "door_hinge")
    result: PlacementResult = plan_base_placement(kitchen, segway, task, reach)

    def drive(*_: object) -> DriveRecord:
        raise AssertionError("no drive is expected")

    return Replanner(
        build_navigation_map(kitchen, segway), kitchen, result.plan, reach, drive, PipelineConfig(),
        lambda *_: None, Stopwatch(lambda: 0.0), np.random.default_rng(0),
        initial=kitchen, beliefs=JointBeliefs((), ComplianceConfig()),
    )  # fmt: skip


def test_a_measured_joint_is_dropped_if_no_base_pose_works_for_it(
    replanner: Replanner, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, task = replanner.scene, replanner.plan.task
    measured = scene.with_joint("microwave", "door_hinge", 0.3)
    replanner.unmeasured, replanner.alternative = (scene, scene, task), measured
    replanner.initial = replanner.scene = measured
    seen: list[object] = []
    monkeypatch.setattr(Replanner, "_next", lambda self, *_: seen.append(self.scene))
    here, motion = replanner.retry(np.zeros(3), 1, leave=False)
    assert motion is None
    assert here.tolist() == [0.0, 0.0, 0.0]
    assert seen == [measured, scene]
    assert (replanner.initial, replanner.scene) == (scene, scene)
    assert replanner.alternative is None
    assert replanner.unmeasured is None
