"""What a robot believes from one try of a run to the next."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.core.stopwatch import Stopwatch
from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene_files import load_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.tasks import make_task
from momapos.planning.navigation.drive_record import DriveRecord
from momapos.planning.navigation.footprint_map import build_navigation_map
from momapos.planning.plan import plan_base_placement
from momapos.planning.reachability.map_store import load_reach_map
from momapos.planning.result import PlacementResult
from momapos.simulation.config import ComplianceConfig
from momapos.workflows.joint_belief import JointBeliefs
from momapos.workflows.replanning import Trip


@pytest.fixture(scope="module")
def trip(tmp_path_factory: pytest.TempPathFactory) -> Trip:
    scene, robot = load_scene("kitchen_small"), load_robot("segway_ur5e")
    reach = load_reach_map(robot, tmp_path_factory.mktemp("maps"))
    task = make_task(scene, "open", "microwave", "door_hinge")
    result: PlacementResult = plan_base_placement(scene, robot, task, reach)

    def drive(*_: object) -> DriveRecord:
        raise AssertionError("nobody drives here")

    return Trip(
        build_navigation_map(scene, robot), scene, result.plan, reach, drive, PipelineConfig(),
        lambda *_: None, Stopwatch(lambda: 0.0), np.random.default_rng(0),
        whole=scene, beliefs=JointBeliefs((), ComplianceConfig()),
    )  # fmt: skip


def test_what_was_felt_is_forgotten_where_no_base_pose_serves_it(
    trip: Trip, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, task = trip.scene, trip.plan.task
    felt = scene.with_joint("microwave", "door_hinge", 0.3)
    trip.before, trip.otherwise = (scene, scene, task), felt
    trip.whole = trip.scene = felt
    seen: list[object] = []
    monkeypatch.setattr(Trip, "_next", lambda self, *_: seen.append(self.scene))
    here, motion = trip.try_anew(np.zeros(3), 1, elsewhere=False)
    assert motion is None
    assert here.tolist() == [0.0, 0.0, 0.0]
    assert seen == [felt, scene]  # as felt, then as given
    assert (trip.whole, trip.scene) == (scene, scene)
    assert trip.otherwise is None
    assert trip.before is None
