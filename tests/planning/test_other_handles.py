"""Laws of parts with several handles: the next one counts where the first leads nowhere."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests import optional
from tests.cupboards import furniture_room, wardrobe
from tests.real import DATA, check_independently

from momapos.apps.web.probe import Probe
from momapos.core.stopwatch import Stopwatch
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene_files import load_scene
from momapos.planning.base_pose_check import BasePoseChecks, check_pose, plan_at_pose
from momapos.planning.base_use import plan_moving
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.motion_record import TaskMotion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import check_base_pose, plan_base_placement
from momapos.planning.max_opening import by_samples
from momapos.planning.plan import plan_placement
from momapos.planning.query import PlacementQuery
from momapos.planning.reachability.map_store import load_reach
from momapos.planning.tolerance import tolerance_at, with_tolerance

HIGH, LOW = 2.8, 0.9
"""Heights of bars above the floor, out of reach and within it [m]."""


@pytest.mark.parametrize("bars", [(HIGH, LOW), (LOW, HIGH)])
def test_a_bar_within_reach_is_held_if_another_bar_is_out_of_reach(
    tmp_path: Path, fetch: Robot, bars: tuple[float, float]
) -> None:
    scene = furniture_room(tmp_path, wardrobe(*bars))
    task = make_task(scene, "open", "cupboard", None, "60deg")
    config = by_samples(PipelineConfig())
    answer = plan_base_placement(scene, fetch, task, config=config, clock=time.process_time)
    assert answer.plan.status == "solved", answer.plan.candidates
    motion = answer.plan.motion
    assert motion.Ts_world_tool[0, 2, 3] < 1.2
    tolerance = with_tolerance(answer, samples=10, clock=time.process_time).plan.tolerance
    assert tolerance.radius > 0.0
    base = answer.plan.base_pose
    query = PlacementQuery(
        scene, fetch, task, load_reach(fetch), watch=Stopwatch(time.process_time)
    )
    there = check_base_pose(scene, fetch, task, base, how_far=False)
    assert there.motion is not None
    assert tolerance_at(query, base, samples=10).radius > 0.0
    at_pose = plan_at_pose(query, base)
    grasps = at_pose.prepared.motion
    held = np.abs(grasps.Ts_world_tool[:, grasps.grasp_step, 2, 3] - LOW)
    assert held.max() < 0.5, "the answer describes the handle out of reach"
    shown = Probe(scene, fetch, task, query.reach).at(np.array(base), time.process_time)
    assert shown.feasible


def test_a_moving_base_opens_a_door_by_the_bar_within_reach(tmp_path: Path, fetch: Robot) -> None:
    scene = furniture_room(tmp_path, wardrobe(HIGH, LOW))
    task = make_task(scene, "open", "cupboard", None, "60deg")
    query = PlacementQuery(
        scene, fetch, task, load_reach(fetch), watch=Stopwatch(time.process_time)
    )
    answer = plan_moving(query)
    assert answer.plan.status == "solved", answer.plan.candidates
    motion = answer.plan.motion
    assert motion.base is not None
    assert motion.Ts_world_tool[0, 2, 3] < 1.2


def test_without_a_bar_within_reach_the_answer_is_no(tmp_path: Path, fetch: Robot) -> None:
    scene = furniture_room(tmp_path, wardrobe(HIGH, HIGH - 0.25))
    task = make_task(scene, "open", "cupboard", None, "60deg")
    config = by_samples(PipelineConfig())
    answer = plan_base_placement(scene, fetch, task, config=config)
    assert answer.plan.status == "infeasible"
    (note,) = answer.notes
    assert note.startswith("2 handles were searched; the reasons are those of ")
    name = note.rpartition("those of ")[2]
    query = PlacementQuery.of(scene, fetch, task, config=config)
    direct = plan_placement(replace(query, keep_grasps=partial(holds, name)))
    assert direct.plan.candidates.rejections == answer.plan.candidates.rejections


def holds(name: str, motion: TaskMotion) -> np.ndarray:
    """Return which grasps of a motion hold a handle, by its words."""
    named = [str(handle) == name for handle in motion.grasps.handles]
    return np.array(named, bool)[motion.grasps.handle]


@pytest.mark.parametrize("base", [(-0.1, -0.3, 0.3), (-0.9, 0.0, 0.0)])
def test_the_reason_at_a_base_pose_is_that_of_the_handle_that_came_farthest(
    tmp_path: Path, fetch: Robot, base: tuple[float, float, float]
) -> None:
    scene = furniture_room(tmp_path, wardrobe(HIGH, LOW))
    task = make_task(scene, "open", "cupboard", None, "90deg")
    query = PlacementQuery.of(scene, fetch, task)
    attempt = check_pose(query, base, how_far=False)
    assert attempt.motion is None
    names = [str(one.prepared.motion.handle) for one in BasePoseChecks(query).by_handle()]
    assert len(names) == 2
    alone = [
        check_pose(replace(query, keep_grasps=partial(holds, name)), base, how_far=False)
        for name in names
    ]
    assert str(attempt.outcome) == str(max(alone, key=lambda one: one.outcome.progress).outcome)


@pytest.mark.slow
def test_a_public_dishwasher_is_opened_by_its_next_handle(tmp_path: Path) -> None:
    scene = load_scene(optional.there(DATA / "bestman/Asset/Scene/Scene/Kitchen_1.json"))
    task = make_task(scene, "open", "elementC", "dishwasher_door")
    answer = plan_base_placement(scene, load_robot("mobile_panda"), task, clock=time.process_time)
    assert answer.plan.status == "solved", answer.plan.candidates
    write_plan(answer.plan, tmp_path / "plan.json")
    check_independently(tmp_path / "plan.json")
