"""Laws of the arm's path home after a task."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos.apps.export.timeline import PhaseKind, phases_of
from momapos.core.errors import FileFormatError
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.plans import Motion, PlacementPlan, Task
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import MotionConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.verification.exact_check import PlanVerifier

CONFIG = PipelineConfig(motion=MotionConfig(home_again=True))
TARGETS = {
    "open": ("cabinet_right", "drawer_middle_slide"),
    "pick": ("bottle", None),
    "place": ("cup", None),
}


@pytest.fixture(scope="module")
def kitchen() -> Scene:
    return load_scene("kitchen_small")


@pytest.fixture(scope="module")
def segway() -> Robot:
    return load_robot("segway_ur5e")


@pytest.fixture(scope="module", params=list(TARGETS))
def solved(
    request: pytest.FixtureRequest, kitchen: Scene, segway: Robot
) -> tuple[PlacementPlan, Task]:
    task = make_task(kitchen, request.param, *TARGETS[request.param])
    return plan_base_placement(kitchen, segway, task, config=CONFIG).plan, task


def check(scene: Scene, robot: Robot, plan: PlacementPlan, motion: Motion | None) -> list[str]:
    assert plan.base_pose is not None
    assert motion is not None
    report = PlanVerifier(scene, robot, plan.task).check(plan.base_pose, motion)
    return [check.name for check in report.violations]


def test_the_exact_check_accepts_the_path_home(
    kitchen: Scene, segway: Robot, solved: tuple[PlacementPlan, Task]
) -> None:
    plan, _ = solved
    motion = plan.motion
    assert motion is not None
    assert motion.home is not None
    np.testing.assert_allclose(motion.home[-1], segway.home)
    steps = np.abs(np.diff(np.vstack([motion.q[-1:], motion.home]), axis=0))
    assert steps.max() < 0.1
    assert check(kitchen, segway, plan, motion) == []
    if plan.task.verb == "open":
        (hold,) = motion.holds
        assert hold.last < len(motion.q) - 1  # it retreats first


def test_a_path_home_that_collides_or_ends_elsewhere_is_rejected(
    kitchen: Scene, segway: Robot, solved: tuple[PlacementPlan, Task]
) -> None:
    plan, _ = solved
    motion = plan.motion
    assert motion is not None
    assert motion.home is not None
    short = replace(motion, home=motion.home[:-3])
    # An object is carried in a state of its own.
    elsewhere = "path home ends where the approach starts" in check(kitchen, segway, plan, short)
    assert elsewhere == (plan.task.verb == "open")
    down = motion.home[-1].copy()
    down[1] += np.pi / 2 + 0.6  # the upper arm into the base or the floor
    dips = np.linspace(motion.home[-1], down, 60)
    low = replace(motion, home=np.concatenate([motion.home, dips, dips[::-1]]))
    assert {
        "robot self-collision",
        "arm collision with the scene",
        "arm below the floor",
        "base collision with the scene",
    } & set(check(kitchen, segway, plan, low))
    jump = replace(motion, home=motion.home[-1:])
    named = check(kitchen, segway, plan, jump)
    assert "largest step of the manipulation" in named


def test_the_path_home_round_trips_through_a_file(
    solved: tuple[PlacementPlan, Task], tmp_path: Path, segway: Robot
) -> None:
    plan, _ = solved
    write_plan(plan, tmp_path / "plan.json")
    again = read_plan(tmp_path / "plan.json").motion
    assert again is not None
    assert plan.motion is not None
    np.testing.assert_array_equal(again.home, plan.motion.home)
    phases = phases_of(plan, segway)
    assert phases[-1].kind == PhaseKind.ARM
    np.testing.assert_allclose(phases[-1].positions[-1], segway.home, atol=1e-6)
    text = (tmp_path / "plan.json").read_text()
    (tmp_path / "bad.json").write_text(text.replace('"home": [[', '"home": [[0.5], ['))
    with pytest.raises(FileFormatError, match="home has rows"):
        read_plan(tmp_path / "bad.json")


def test_by_default_the_arm_stays(kitchen: Scene, segway: Robot) -> None:
    task = make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide")
    motion = plan_base_placement(kitchen, segway, task).plan.motion
    assert motion is not None
    assert motion.home is None
