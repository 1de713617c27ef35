"""Laws of the belief of a robot between two tries of a run."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.core.stopwatch import Stopwatch
from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene_files import load_scene
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
def replanner(tmp_path_factory: pytest.TempPathFactory) -> Replanner:
    scene, robot = load_scene("kitchen_small"), load_robot("segway_ur5e")
    reach = load_reach_map(robot, tmp_path_factory.mktemp("maps"))
    task = make_task(scene, "open", "microwave", "door_hinge")
    result: PlacementResult = plan_base_placement(scene, robot, task, reach)

    def drive(*_: object) -> DriveRecord:
        raise AssertionError("no drive is expected")

    return Replanner(
        build_navigation_map(scene, robot), scene, result.plan, reach, drive, PipelineConfig(),
        lambda *_: None, Stopwatch(lambda: 0.0), np.random.default_rng(0),
        initial=scene, beliefs=JointBeliefs((), ComplianceConfig()),
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
