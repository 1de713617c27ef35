"""From the URDF of a car-like robot to an opened drawer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.model.robots.rovers import FRONT, REAR, Axle, at, derived, rover
from tests.rooms import Everywhere

from momapos.apps.export.timeline import PhaseKind, phases_of
from momapos.core.geometry.transforms import wrap_angle
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.records.outcomes import PoseOutcome, PoseStatus
from momapos.model.records.plans import PlacementPlan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.base_pose_check import plan_at_pose
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.query import PlacementQuery
from momapos.verification.path_checks import wheel_checks
from momapos.verification.plan_check import verify_files
from momapos.workflows.run import run_plan

CONFIG = PipelineConfig(place=PlaceConfig(count=256, polish=1), timeout=300.0)
ROVERS: dict[str, list[Axle]] = {
    "front": at(REAR) + at(FRONT, steering=0.46),
    "rear": at(FRONT) + at(REAR, steering=0.5),
}


@pytest.fixture(scope="module", params=ROVERS)
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Return robots that steer two wheels by knuckles, of which one follows the other."""
    text = rover(ROVERS[request.param]).replace('effort="1"', 'effort="100"')
    head, _, tail = text.partition('<joint name="t3"')
    own, _, rest = tail.partition("</joint>")
    text = f'{head}<joint name="t3"{own}<mimic joint="t2"/></joint>{rest}'
    return derived(tmp_path_factory.mktemp(request.param), text)[0]


@pytest.fixture(scope="module")
def plan(kitchen: Scene, robot: Robot) -> PlacementPlan:
    task = make_task(kitchen, "open", "cabinet_right", "drawer_top_slide")
    return plan_base_placement(kitchen, robot, task, Everywhere(), config=CONFIG).plan


def test_the_answer_has_a_path_that_verification_accepts(
    plan: PlacementPlan, robot: Robot, tmp_path: Path
) -> None:
    assert robot.drive == "car"
    assert plan.status == "solved"
    assert (plan.robot_drive, plan.robot_min_turning_radius) == ("car", robot.min_turning_radius)
    write_plan(plan, tmp_path / "drawer.json")
    report = verify_files(tmp_path / "drawer.json")
    assert report.valid
    names = [check.name for check in report.checks]
    assert "base path turns tighter than its drive can" in names
    # The same path is not valid for a base that turns less.
    lazy = replace(plan, robot_min_turning_radius=2 * robot.min_turning_radius)
    write_plan(lazy, tmp_path / "lazy.json")
    assert not verify_files(tmp_path / "lazy.json").valid


def test_the_exported_drive_keeps_radius_and_speed(plan: PlacementPlan, robot: Robot) -> None:
    (drive,) = (phase for phase in phases_of(plan, robot) if phase.kind is PhaseKind.DRIVE)
    step = np.diff(drive.base, axis=0) / np.diff(drive.times)[:, None]
    assert np.hypot(step[:, 0], step[:, 1]).max() <= robot.max_speed + 1e-3
    assert np.abs(wrap_angle(np.diff(drive.base[:, 2]))).max() <= 0.02 * robot.max_yaw_rate + 1e-6
    checks = list(wheel_checks(drive.base, "car", robot.min_turning_radius))
    assert len(checks) == 2
    assert all(check.ok for check in checks)


def test_a_base_pose_without_a_path_is_no_answer(
    plan: PlacementPlan, kitchen: Scene, robot: Robot
) -> None:
    """A base that turns almost not at all cannot turn around where the other one can."""
    x, y, yaw = plan.base_pose
    query = PlacementQuery(
        kitchen, robot, plan.task, Everywhere(), start=np.array([x, y, yaw + 2.0]), config=CONFIG
    )
    assert plan_at_pose(query, plan.base_pose).plan.status == "solved"
    stiff = replace(query, robot=replace(robot, min_turning_radius=30.0))
    answer = plan_at_pose(stiff, plan.base_pose).plan
    assert answer.status == "infeasible"
    assert str(PoseOutcome(PoseStatus.NO_ROUTE_AT_HOME)) in answer.candidates.rejections


@pytest.mark.slow
def test_the_plan_succeeds_in_physics(plan: PlacementPlan, kitchen: Scene, robot: Robot) -> None:
    assert run_plan(plan, kitchen, robot, Everywhere()).success
