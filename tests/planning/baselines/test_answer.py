"""Test that the plans of every method are valid, repeatable and named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from tests.rooms import Everywhere, cabinet_room

from momapos.core.errors import InputError
from momapos.model.plan_files.plan_format import plan_to_dict
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.arm_motion import arm_planner as planner
from momapos.planning.arm_motion.arm_planner import plan_motion
from momapos.planning.baselines.by_method import PLACERS
from momapos.planning.config import RANKERS, PaperConfig, PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement, plan_by_method
from momapos.planning.placement.config import OURS, Method, PlaceConfig
from momapos.planning.result import PlacementResult
from momapos.verification.exact_check import PlanVerifier


def ask(scene: Scene, robot: Robot, method: Method, *, seed: int = 0) -> PlacementResult:
    place = PlaceConfig(method=method, count=256, polish=1, grid_cell=0.2, grid_turn=90.0)
    config = PipelineConfig(place=place, timeout=120.0)
    task = make_task(scene, "open", "cabinet", to=0.8)
    return plan_by_method(scene, robot, task, Everywhere(), config=config, seed=seed)


def test_every_method_name_has_a_placer() -> None:
    assert set(get_args(Method)) == {*OURS, *PLACERS, *RANKERS}


@pytest.mark.parametrize("method", get_args(Method))
def test_every_method_returns_a_valid_and_repeatable_plan(
    method: Method, tmp_path: Path, segway: Robot
) -> None:
    scene = cabinet_room(tmp_path)
    first, second = ask(scene, segway, method), ask(scene, segway, method)
    plan = first.plan
    assert plan.status == "solved", plan.candidates
    assert plan.method == method
    assert PlanVerifier(scene, segway, plan.task).check(plan.base_pose, plan.motion).valid
    records = [plan_to_dict(replace(one.plan, timing={})) for one in (first, second)]
    assert records[0] == records[1]


@pytest.mark.parametrize("method", [*PLACERS, *RANKERS])
def test_no_method_reaches_a_handle_that_is_too_high(
    method: Method, tmp_path: Path, segway: Robot
) -> None:
    scene = cabinet_room(tmp_path)
    cabinet = scene.object("cabinet")
    T = cabinet.T_world_object.copy()
    T[2, 3] = 2.5
    plan = ask(replace(scene, objects=(replace(cabinet, T_world_object=T),)), segway, method).plan
    assert plan.status == "infeasible"
    assert any("reach" in reason for reason in plan.candidates.rejections)


def test_the_pipeline_rejects_the_name_of_a_baseline(tmp_path: Path, fetch: Robot) -> None:
    scene = cabinet_room(tmp_path)
    config = PipelineConfig(place=PlaceConfig(method="habitat"))
    task = make_task(scene, "open", "cabinet")
    with pytest.raises(InputError, match="'habitat'; plan_by_method"):
        plan_base_placement(scene, fetch, task, Everywhere(), config=config)


def test_a_baseline_respects_keep_poses(tmp_path: Path, segway: Robot) -> None:
    scene = cabinet_room(tmp_path)
    config = PipelineConfig(place=PlaceConfig(method="rm4d"))
    task = make_task(scene, "open", "cabinet", to=0.8)
    free = plan_by_method(scene, segway, task, Everywhere(), config=config).plan
    taken = np.array(free.base_pose[:2])

    def away(poses: np.ndarray) -> np.ndarray:
        return np.linalg.norm(poses[:, :2] - taken, axis=1) >= 0.1

    plan = plan_by_method(scene, segway, task, Everywhere(), config=config, keep_poses=away).plan
    assert np.linalg.norm(np.array(plan.base_pose[:2]) - taken) >= 0.1


def test_the_paper_selects_objects_by_deepwalk_and_plans_with_rrt_star(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, segway: Robot
) -> None:
    planners = []

    def note(*args: Any, **kwargs: Any) -> Any:
        planners.append(kwargs["config"].planner)
        return plan_motion(*args, **kwargs)

    monkeypatch.setattr(planner, "plan_motion", note)
    extra = (
        ', {"name": "pile", "category": "pile", "pose": {"xyz": [3, 2, 0.2],'
        ' "wxyz": [1, 0, 0, 0]}, "box": [0.4, 0.4, 0.4]}'
    )
    scene = cabinet_room(tmp_path, extra=extra)
    plan = ask(scene, segway, "paper").plan
    assert plan.key_objects.scorer == "deepwalk"
    assert 0.0 < plan.timing["potential"] < plan.timing["total"]
    assert set(planners) == {"RRTstar"}


def test_the_paper_lowers_alpha_until_all_objects_are_modeled(
    tmp_path: Path, segway: Robot
) -> None:
    extra = (
        ', {"name": "pile", "category": "pile", "pose": {"xyz": [0, -1.2, 0.2],'
        ' "wxyz": [1, 0, 0, 0]}, "box": [6, 1.4, 0.4]}'
    )
    scene = cabinet_room(tmp_path, extra=extra)
    config = PipelineConfig(
        place=PlaceConfig(method="paper"), paper=PaperConfig(samples=8, batches=1)
    )
    task = make_task(scene, "open", "cabinet", to=0.8)
    answer = plan_by_method(scene, segway, task, Everywhere(), config=config)
    assert answer.plan.status == "infeasible"
    assert set(answer.plan.key_objects.names) == {"cabinet", "pile"}


def test_a_baseline_is_called_where_only_a_regrasp_works(segway: Robot) -> None:
    scene = load_scene("kitchen_island")
    task = make_task(scene, "open", "sink", "door_left_hinge")
    config = PipelineConfig(place=PlaceConfig(method="habitat"))
    plan = plan_by_method(scene, segway, task, Everywhere(), config=config).plan
    assert plan.motion is not None, plan.candidates
    assert len(plan.motion.holds) == 2


def test_a_baseline_opens_a_part_as_far_as_possible_and_is_named(
    tmp_path: Path, segway: Robot
) -> None:
    scene = cabinet_room(tmp_path)
    task = make_task(scene, "open", "cabinet", to="max")
    config = PipelineConfig(place=PlaceConfig(method="habitat"), timeout=60.0)
    plan = plan_by_method(scene, segway, task, Everywhere(), config=config).plan
    assert plan.status == "solved"
    assert plan.method == "habitat"
    assert plan.task.to > 0.8
