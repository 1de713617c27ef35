"""Laws of base-pose robustness."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of

from momapos.apps.cli.main import main
from momapos.core.stopwatch import Stopwatch
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.records.outcomes import PoseStatus
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.base_pose_check import BasePoseChecks
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.query import PlacementQuery
from momapos.planning.reachability.map_store import load_reach
from momapos.planning.robust import RobustChecks, unit_offsets, works_around

WORDS = ["place", "open", "kitchen_small", "cabinet_right/drawer_middle_slide"]
SEGWAY = [*WORDS, "--robot", "segway_ur5e"]


def test_replanning_succeeds_within_the_required_offsets(
    tmp_path: Path, kitchen: Scene, segway: Robot
) -> None:
    file = tmp_path / "plan.json"
    assert main([*SEGWAY, "--robust", "3cm,2deg", "--out", str(file)]) == 0
    plan = read_plan(file)
    assert plan.tolerance.radius == pytest.approx(0.03)
    assert plan.tolerance.turn == pytest.approx(np.radians(2.0))
    task = make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide")
    query = PlacementQuery(
        kitchen, segway, task, load_reach(segway, None), watch=Stopwatch(lambda: 0.0)
    )  # fmt: skip
    checks, rng = BasePoseChecks(query), np.random.default_rng(5)
    assert plan.base_pose is not None
    for angle in rng.uniform(-np.pi, np.pi, 12):
        off = [0.03 * np.cos(angle), 0.03 * np.sin(angle), rng.choice([-1, 1]) * np.radians(2.0)]
        assert checks(np.array(plan.base_pose) + off).motion is not None


@pytest.mark.slow
def test_without_a_robust_base_pose_the_task_is_infeasible_with_the_reason(
    monkeypatch: pytest.MonkeyPatch, kitchen: Scene, segway: Robot
) -> None:
    monkeypatch.setattr("momapos.planning.robust.works_around", lambda *_: False)
    task = make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide")
    place = PlaceConfig(robust_radius=0.05, robust_turn=3.0, rounds=1, grid=False)
    config = replace(PipelineConfig(), place=place)
    result = plan_base_placement(kitchen, segway, task, config=config)
    assert result.plan.status == "infeasible"
    assert result.plan.tolerance is None
    reasons = result.plan.candidates.rejections
    assert reasons[PoseStatus.LITTLE_ROOM.value.format(detail="+-5 cm, +-3 deg")] > 0


def test_no_arm_path_is_searched_if_the_base_alone_is_not_robust(tmp_path: Path) -> None:
    file = tmp_path / "no.json"
    assert main([*SEGWAY, "--robust", "80cm,30deg", "--out", str(file)]) == 3
    counts = read_plan(file).candidates
    assert counts.checked == 0
    assert counts.rejections[PoseStatus.LITTLE_ROOM.value.format(detail="+-80 cm, +-30 deg")] > 0


def test_replanning_fails_around_every_pose_that_the_base_rule_excludes(
    kitchen: Scene, segway: Robot
) -> None:
    task = make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide")
    config = PipelineConfig(place=PlaceConfig(robust_radius=0.1, robust_turn=5.0))
    query = PlacementQuery(
        kitchen, segway, task, load_reach(segway, None), config=config, watch=Stopwatch(lambda: 0.0)
    )
    checks, robust = BasePoseChecks(query), RobustChecks(query)
    poses = np.array([1.95, -1.35, 0.6]) + np.random.default_rng(1).uniform(-0.4, 0.4, (60, 3))
    kept = robust.rule(checks.prepared.geometry).keeps(poses, np.zeros(len(poses)))
    assert 0 < kept.sum() < len(poses)
    offsets = unit_offsets(150, np.random.default_rng(0)) * [0.1, 0.1, np.radians(5.0)]
    order = np.argsort(-np.abs(offsets[:, 2]) / np.radians(5.0) - np.hypot(*offsets.T[:2]) / 0.1)
    for pose in poses[~kept]:
        assert not works_around(checks, pose, offsets[order])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--robust", "5cm"], "write it as 0.05m,3deg"),
        (["--robust", "3deg,5cm"], "--robust: length"),
        (["--robust=-5cm,3deg"], "of at least 0"),
        (["--robust", "5cm,3deg", "--at", "1,-1,0"], "leave out --robust"),
    ],
)
def test_an_unusable_offset_is_a_one_line_error(words: list[str], message: str) -> None:
    assert message in error_of(*SEGWAY, *words)
