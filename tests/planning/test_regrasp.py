"""Laws of doors that no single grasp opens: pulled ajar, then pushed from behind."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.rooms import cabinet_room, without_springs

from momapos.apps.cli.console import summary
from momapos.apps.plots.answer_plot import waypoints_by_grasp
from momapos.core.geometry import invert
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.outcomes import PoseStatus
from momapos.model.records.plans import Motion, PlacementPlan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning import search_setup
from momapos.planning.arm_motion.arm_planner import quick_config
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import GraspConfig, MotionConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import check_base_pose, plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.query import PlacementQuery
from momapos.planning.reachability.map_store import load_reach_map
from momapos.planning.reachability.reach_map import ReachMap
from momapos.planning.regrasp import TwoGrasps, iter_two_grasps
from momapos.planning.result import PlacementResult
from momapos.planning.robust import unit_offsets
from momapos.planning.search_setup import SearchSetup
from momapos.planning.task_setup import PreparedTask, prepare
from momapos.verification import HOLD_CHECK
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.plan_check import verify_files

CONFIG = PipelineConfig()


@pytest.fixture(scope="module")
def reach(segway: Robot, tmp_path_factory: pytest.TempPathFactory) -> ReachMap:
    return load_reach_map(segway, tmp_path_factory.mktemp("maps"))


@pytest.fixture(scope="module")
def kitchen() -> Scene:
    return load_scene("kitchen_island")


@pytest.fixture(scope="module")
def answer(kitchen: Scene, segway: Robot, reach: ReachMap) -> PlacementResult:
    task = make_task(kitchen, "open", "cabinet_back", "door_hinge")
    return plan_base_placement(kitchen, segway, task, reach)


@pytest.fixture(scope="module")
def plan(answer: PlacementResult) -> PlacementPlan:
    return answer.plan


def motion_of(plan: PlacementPlan) -> Motion:
    assert plan.motion is not None, plan.status
    return plan.motion


def ready(kitchen: Scene, robot: Robot, item: str, joint: str) -> PreparedTask:
    task = make_task(kitchen, "open", item, joint)
    return prepare(kitchen, robot, task, CONFIG, clearance=0.0)


def test_a_door_is_pulled_ajar_and_pushed_open_from_one_base_pose(plan: PlacementPlan) -> None:
    motion = motion_of(plan)
    pull, push = motion.holds
    assert (pull.family, push.family) == ("pinch", "push")
    assert pull.first == 0
    assert push.last == len(motion.q) - 1
    between = motion.object_q[pull.last : push.first + 1]
    assert np.ptp(between) == 0.0
    assert 0.0 < between[0] < motion.object_q[-1]


def test_the_hand_retracts_before_it_moves_behind_the_door(plan: PlacementPlan) -> None:
    motion = motion_of(plan)
    pull, push = motion.holds
    tool = motion.Ts_world_tool[pull.last : push.first + 1, :3, 3]
    away = np.linalg.norm(tool - tool[0], axis=1)
    assert away.max() > CONFIG.motion.grasps.pregrasp - 1e-6


def test_both_grasps_pass_the_check_of_files(plan: PlacementPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "plan.json")
    report = verify_files(tmp_path / "plan.json")
    assert not report.violations
    names = {check.name for check in report.checks}
    assert "object moves while nothing holds it" in names
    assert read_plan(tmp_path / "plan.json").motion is not None


def test_the_check_of_a_base_pose_finds_two_grasps(
    plan: PlacementPlan, kitchen: Scene, segway: Robot, reach: ReachMap
) -> None:
    attempt = check_base_pose(kitchen, segway, plan.task, plan.base_pose, reach, how_far=False)
    assert len(attempt.motion.holds) == 2


def test_within_the_tolerance_the_door_also_opens_with_two_grasps(
    answer: PlacementResult, kitchen: Scene, segway: Robot, reach: ReachMap
) -> None:
    found = answer.tolerance
    assert found.radius > 0.0
    size, missed = np.array([found.radius, found.radius, found.turn]), []
    for offset in unit_offsets(10, np.random.default_rng(1)):
        base = np.array(answer.plan.base_pose) + offset * size
        attempt = check_base_pose(kitchen, segway, answer.plan.task, base, reach, how_far=False)
        if attempt.motion is None:
            missed.append(attempt.reason)
        else:
            assert len(attempt.motion.holds) == 2
    assert len(missed) <= 1, missed  # the tolerance is found from samples


def test_a_grasp_in_which_the_hand_misses_the_part_is_refused_once(
    kitchen: Scene, segway: Robot, plan: PlacementPlan
) -> None:
    two = next(iter_two_grasps(ready(kitchen, segway, "cabinet_back", "door_hinge"), CONFIG, 0))
    feasibility, bases = two.first, np.array([plan.base_pose])
    scores = np.ones((1, len(feasibility.motion.Ts_world_tool)))
    reaches = [one.grasp for one in feasibility.screen(bases, scores, None) if one.q is not None]
    assert reaches
    miss = f"{HOLD_CHECK}: it is not behind it"
    for grasp in set(reaches):
        assert feasibility.refused(grasp, miss).status is PoseStatus.EXACT_CHECK
    assert not feasibility.arm_paths(bases[0], np.array(reaches))
    again = feasibility.screen(bases, scores, None)
    assert not {one.grasp for one in again if one.q is not None} & set(reaches)
    for grasp in range(scores.shape[1]):
        feasibility.refused(grasp, miss)
    assert all(one.q is None for one in feasibility.screen(bases, scores, None))


@pytest.mark.slow
def test_base_poses_without_a_quick_way_between_the_grasps_are_tried_again(
    kitchen: Scene, segway: Robot, reach: ReachMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick, search = quick_config(CONFIG.arm_planner), TwoGrasps._between

    def without_quick_ways(two: TwoGrasps, *where: Any) -> np.ndarray | None:
        return None if where[-1] == quick else search(two, *where)

    monkeypatch.setattr(TwoGrasps, "_between", without_quick_ways)
    task = make_task(kitchen, "open", "cabinet_back", "door_hinge")
    slow = plan_base_placement(kitchen, segway, task, reach, clock=time.process_time)
    assert [hold.family for hold in motion_of(slow.plan).holds] == ["pinch", "push"]


def test_a_door_that_would_fall_is_not_released(kitchen: Scene, segway: Robot) -> None:
    weighed = without_springs(kitchen, "dishwasher")
    assert not list(iter_two_grasps(ready(weighed, segway, "dishwasher", "door_hinge"), CONFIG, 0))


def test_a_drawer_is_not_pushed_from_behind(kitchen: Scene, segway: Robot) -> None:
    prepared = ready(kitchen, segway, "cabinet_left", "drawer_top_slide")
    assert not list(iter_two_grasps(prepared, CONFIG, 0))


def test_a_small_opening_needs_no_second_grasp(kitchen: Scene, segway: Robot) -> None:
    task = make_task(kitchen, "open", "cabinet_back", "door_hinge", "25deg")
    prepared = prepare(kitchen, segway, task, CONFIG, clearance=0.0)
    assert not list(iter_two_grasps(prepared, CONFIG, 0))


def test_a_door_next_to_a_wall_is_pushed_if_no_grasp_is_free_to_pull_it(
    segway: Robot, reach: ReachMap, tmp_path: Path
) -> None:
    wall = (
        ', {"name": "wall", "category": "wall", "box": [0.1, 0.4, 1.1],'
        ' "pose": {"xyz": [0.41, -0.6, 0.85], "wxyz": [1, 0, 0, 0]}}'
    )
    scene = cabinet_room(tmp_path, extra=wall)
    task = make_task(scene, "open", "cabinet", to=np.pi / 2)
    prepared = prepare(scene, segway, task, CONFIG, clearance=0.0)
    assert "wall" in prepared.no_grasp
    assert prepared.blocked == ""
    found = plan_base_placement(scene, segway, task, reach).plan
    assert [hold.family for hold in motion_of(found).holds] == ["pinch", "push"]
    assert found.base_pose is not None
    assert check_base_pose(scene, segway, task, found.base_pose, reach).motion is not None


def test_after_a_push_the_arm_returns_home_if_configured(
    kitchen: Scene, segway: Robot, reach: ReachMap
) -> None:
    task = make_task(kitchen, "open", "cabinet_back", "door_hinge")
    config = PipelineConfig(motion=MotionConfig(home_again=True))
    plan = plan_base_placement(kitchen, segway, task, reach, config=config).plan
    motion = motion_of(plan)
    assert len(motion.holds) == 2
    np.testing.assert_allclose(motion.home[-1], segway.chain.joint_values(segway.home))
    assert PlanVerifier(kitchen, segway, task).check(plan.base_pose, motion).valid


def test_both_grasps_are_printed_and_drawn(answer: PlacementResult, tmp_path: Path) -> None:
    motion = motion_of(answer.plan)
    words = summary(answer, None)
    assert "  grasp       pinch of bar 'door_handle', by its name;" in words
    assert "  regrasp     from 40 deg: push at the face of 'door'" in words
    write_plan(answer.plan, tmp_path / "plan.json")
    assert motion_of(read_plan(tmp_path / "plan.json")).holds == motion.holds
    drawn = waypoints_by_grasp(answer)
    assert len(drawn) == len(motion.holds)
    for points, hold in zip(drawn, motion.holds, strict=True):
        held = motion.Ts_world_tool[hold.first : hold.last + 1, :3, 3]
        np.testing.assert_array_equal(points[[0, -1]], held[[0, -1]])
        assert len(points) == 1 + np.ceil((len(held) - 1) / 4)
    feasible = [
        o for outcomes in answer.search.outcomes for o in outcomes if o.status.value == "feasible"
    ]
    assert len(feasible) == 1


def test_every_push_holds_the_tool_as_near_to_the_part_as_the_exact_check_wants(
    kitchen: Scene, segway: Robot
) -> None:
    prepared = ready(kitchen, segway, "cabinet_back", "door_hinge")
    part = prepared.verifier.part
    for two in iter_two_grasps(prepared, CONFIG, 0):
        push = two.second.motion
        step = push.grasp_step
        body = invert(part.poses(push.object_q[step : step + 1]))[0]
        points = (body @ push.Ts_world_tool[:, step][:, None])[..., :3, 3]
        assert max(min(part.distance(p, b) for b, p in enumerate(row)) for row in points) <= 0.06


@pytest.mark.parametrize(
    ("in_reach", "ends", "prepared"),
    [
        ((True, True), "aaa", [0, 1, 2]),
        ((False, True), "aaa", []),
        ((False, False), "aaa", []),
        ((True, False), "aba", [0, 1]),
    ],
    ids=["in reach", "not both", "not even ends", "ends that are added"],
)
def test_two_grasps_are_prepared_where_some_base_pose_reaches_both(
    kitchen: Scene,
    segway: Robot,
    monkeypatch: pytest.MonkeyPatch,
    in_reach: tuple[bool, bool],
    ends: str,
    prepared: list[int],
) -> None:
    doors = [
        SimpleNamespace(
            ends=frozenset({end.encode()}),
            is_within_reach=lambda *_: in_reach,
            prepared=lambda *_, value=value: value,
        )
        for value, end in enumerate(ends)
    ]
    monkeypatch.setattr(search_setup, "ajar_doors", lambda *_: iter(doors))
    query = PlacementQuery.of(kitchen, segway, make_task(kitchen, "open", "fridge", "door_hinge"))
    setup = SimpleNamespace(query=query, prepared=None, problem=None)
    assert list(SearchSetup._two_grasps(setup, PlaceConfig())) == prepared  # type: ignore[arg-type]


def test_without_pushing_there_is_no_second_grasp_and_no_other_family(
    kitchen: Scene, segway: Robot
) -> None:
    grasps = GraspConfig(families=("pinch",), turning=False)
    config = PipelineConfig(motion=MotionConfig(grasps=grasps))
    task = make_task(kitchen, "open", "cabinet_back", "door_hinge")
    prepared = prepare(kitchen, segway, task, config, clearance=0.0)
    assert set(prepared.motion.grasps.family) == {"pinch"}
    assert not len(prepared.motion.turning.groups)
    assert not list(iter_two_grasps(prepared, config, 0))
    hooks = PipelineConfig(motion=MotionConfig(grasps=GraspConfig(families=("suction",))))
    refused = prepare(kitchen, segway, task, hooks, clearance=0.0)
    assert "by other grasps than those allowed" in refused.no_grasp
