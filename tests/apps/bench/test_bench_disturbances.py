"""Laws of success under base pose errors."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.apps.bench.bench_records import Job, Settings, SuiteTask
from momapos.apps.bench.job import LEVELS, answer_job, disturbed_poses, works_disturbed
from momapos.apps.bench.methods import method_config
from momapos.core.geometry.transforms import wrap_angle
from momapos.model.records.plans import PlacementPlan
from momapos.model.records.protocols import ReachScorer
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene_files import load_scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_by_method
from momapos.planning.reachability.map_store import load_reach

CONFIG = method_config("ours", 10.0)
SCENE = load_scene("kitchen_small")
CUP = SuiteTask("cup", "pick", "kitchen_small", "segway_ur5e", "pick", "cup")


@pytest.fixture(scope="module")
def machine(segway: Robot) -> tuple[Robot, ReachScorer]:
    return segway, load_reach(segway)


@pytest.fixture(scope="module")
def plan(machine: tuple[Robot, ReachScorer]) -> PlacementPlan:
    robot, reach = machine
    task = make_task(SCENE, "pick", "cup")
    return plan_by_method(SCENE, robot, task, reach, config=CONFIG).plan


@pytest.mark.parametrize("count", [1, 3, 8])
@pytest.mark.parametrize(("off", "turn"), LEVELS)
def test_disturbed_poses_have_the_distance_and_rotation_of_their_level_in_all_directions(
    off: float, turn: float, count: int
) -> None:
    base = np.array([1.0, -2.0, 3.14])
    poses = disturbed_poses(base, off, turn, count, np.random.default_rng(0))
    away = poses[:, :2] - base[:2]
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), off)
    np.testing.assert_allclose(np.abs(wrap_angle(poses[:, 2] - base[2])), turn)
    assert (np.abs(poses[:, 2]) <= np.pi).all()
    around = np.sort(np.arctan2(away[:, 1], away[:, 0]))
    np.testing.assert_allclose(np.diff(around), 2 * np.pi / count)


def test_replanning_succeeds_at_the_planned_pose_and_fails_far_away(
    machine: tuple[Robot, ReachScorer], plan: PlacementPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, reach = machine
    for off, expected in ((0.0, True), (5.0, False)):
        levels = ((off, 0.0), (off, 0.0))
        monkeypatch.setattr("momapos.apps.bench.job.LEVELS", levels)
        found = works_disturbed(plan, SCENE, robot, reach, count=3, config=CONFIG, seed=0)
        assert found.shape == (2, 3)
        assert (found == expected).all()


def test_a_row_has_shares_of_disturbed_poses_only_if_requested() -> None:
    disturbed = answer_job(
        Job("key", "unused", CUP, "ours", Settings(timeout=10.0, disturbances=2))
    )
    assert disturbed.at_2cm in (0.0, 0.5, 1.0)
    assert disturbed.at_5cm in (0.0, 0.5, 1.0)
    plain = answer_job(Job("key", "unused", CUP, "ours", Settings(timeout=10.0)))
    assert (plain.at_2cm, plain.at_5cm) == (None, None)
    assert plain.bases == disturbed.bases
