"""Laws of answers in which the base moves while the hand holds the part."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos.core.geometry.transforms import local_points
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.plans import Motion, Verb
from momapos.model.robots.robot import Drive, Robot, load_robot
from momapos.model.scene.other_motion import with_assumptions
from momapos.model.scene.scene import Scene
from momapos.planning.base_use import plan_moving
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.moving_base import BaseShift, ShortArmStarts, search_moving
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.query import PlacementQuery
from momapos.planning.reachability.map_store import load_reach
from momapos.planning.result import PlacementResult
from momapos.planning.search_setup import SearchSetup, prepare_search
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.plan_check import verify_files


def moving(scene: Scene, robot: str, item: str, joint: str) -> PlacementResult:
    task = make_task(scene, "open", item, joint)
    query = PlacementQuery.of(scene, load_robot(robot), task, clock=time.process_time)
    return plan_moving(query)


def known(answer: PlacementResult) -> tuple[Motion, np.ndarray]:
    motion = answer.plan.motion
    return motion, motion.base


@pytest.mark.parametrize(
    ("robot", "item", "joint"),
    [
        ("stretch", "microwave", "door_hinge"),
        ("hsr", "cabinet_right", "drawer_top_slide"),
        ("segway_ur5e", "cabinet_right", "drawer_top_slide"),
    ],
)
def test_a_moving_base_opens_the_part_and_the_file_is_valid(
    kitchen: Scene, tmp_path: Path, robot: str, item: str, joint: str
) -> None:
    """Stretch and HSR open neither from one base pose."""
    answer = moving(kitchen, robot, item, joint)
    assert answer.plan.status == "solved"
    motion, base = known(answer)
    assert answer.plan.base_pose == pytest.approx(tuple(base[0]))
    assert np.ptp(base[:, :2], axis=0).max() > 0.05
    np.testing.assert_array_equal(base[:, 2], base[0, 2])
    write_plan(answer.plan, tmp_path / "plan.json")
    np.testing.assert_allclose(known_base(tmp_path / "plan.json"), base)
    report = verify_files(tmp_path / "plan.json")
    assert report.valid, report
    held = motion.grasps[0]
    assert motion.object_q[held.first] == motion.object_q[0]
    assert motion.object_q[held.last] == pytest.approx(answer.plan.task.to)


def known_base(path: Path) -> np.ndarray:
    motion = read_plan(path).motion
    return motion.base


@pytest.mark.parametrize(
    ("robot", "drive", "verb", "item", "joint"),
    [
        ("hsr", "omni", "close", "microwave", "door_hinge"),
        ("hsr", "omni", "open", "dishwasher", "door_hinge"),
        ("hsr", "omni", "close", "cabinet_right", "drawer_top_slide"),
        ("segway_ur5e", "differential", "close", "microwave", "door_hinge"),
        ("stretch", "differential", "close", "dishwasher", "door_hinge"),
        ("segway_ur5e", "differential", "close", "cabinet_right", "drawer_top_slide"),
        ("husky_ur5e", "car", "open", "dishwasher", "door_hinge"),
        ("husky_ur5e", "car", "open", "cabinet_right", "drawer_top_slide"),
        ("husky_ur5e", "car", "close", "cabinet_right", "drawer_top_slide"),
    ],
)
def test_each_drive_moves_doors_flaps_and_drawers_open_or_closed(
    kitchen: Scene, robot: str, drive: Drive, verb: Verb, item: str, joint: str
) -> None:
    """A flap at 45 degrees is out of the way of the hand; it would hit the floor at 90."""
    own = load_robot(robot)
    moves = replace(own, drive=drive, min_turning_radius=1.0 if drive == "car" else 0.0)
    wide = np.pi / 4 if item == "dishwasher" else make_task(kitchen, "open", item, joint).to
    scene = kitchen if verb == "open" else kitchen.with_joint(item, joint, wide)
    task = make_task(scene, verb, item, joint, wide if verb == "open" else None)
    query = PlacementQuery.of(scene, moves, task, load_reach(own), clock=time.process_time)
    plan = plan_moving(query).plan
    assert plan.base_pose is not None, plan.candidates
    verifier = PlanVerifier(with_assumptions(scene, plan), moves, task)
    assert verifier.first_violation(plan.base_pose, plan.motion) is None
    way = local_points(plan.motion.base[0], plan.motion.base[:, :2])
    assert np.ptp(way, axis=0).max() > 0.05
    np.testing.assert_array_equal(plan.motion.base[:, 2], plan.motion.base[0, 2])
    if drive != "omni":
        np.testing.assert_allclose(way[:, 1], 0.0, atol=1e-6)


def test_a_differential_base_moves_along_its_heading(kitchen: Scene) -> None:
    _, base = known(moving(kitchen, "stretch", "microwave", "door_hinge"))
    ahead = np.array([np.cos(base[0, 2]), np.sin(base[0, 2])])
    step = np.diff(base[:, :2], axis=0)
    np.testing.assert_allclose(step - np.outer(step @ ahead, ahead), 0.0, atol=1e-9)


def test_a_base_that_follows_the_part_rests_until_the_grasp(kitchen: Scene, segway: Robot) -> None:
    task = make_task(kitchen, "open", "cabinet_right", "drawer_top_slide")
    motion = task_motion(kitchen, segway, task, PipelineConfig().motion)
    share = np.linspace(0.0, 1.0, len(motion.object_q))
    shift = BaseShift(np.array([0.4, 0.0]), share)
    paths = shift.paths(np.array([[1.0, 2.0, np.pi / 2]]))
    np.testing.assert_allclose(paths[0, 0], [1.0, 2.0, np.pi / 2])
    np.testing.assert_allclose(paths[0, -1], [1.0, 2.4, np.pi / 2])
    answer = moving(kitchen, "segway_ur5e", "cabinet_right", "drawer_top_slide")
    found, base = known(answer)
    first = found.grasps[0].first
    assert (base[: first + 1] == base[0]).all()
    progress = np.linalg.norm(base[:, :2] - base[0, :2], axis=1)
    assert (np.diff(progress) >= 0.0).all()


def test_a_handle_that_is_too_high_has_no_start(kitchen: Scene, stretch: Robot) -> None:
    """Stretch lifts its hand to 1.3 m, and the handle of a wall cabinet is at 1.5 m."""
    task = make_task(kitchen, "open", "wall_cabinet", "door_left_hinge")
    motion = task_motion(kitchen, stretch, task, PipelineConfig().motion)
    starts = ShortArmStarts(stretch, motion)
    assert not starts.possible.any()
    poses = np.array([[1.0, 1.0, 0.3], [2.0, 1.0, -2.0]])
    shifted, grasp = starts(poses)
    np.testing.assert_array_equal(shifted, poses)
    assert (grasp == -1).all()
    plan = moving(kitchen, "stretch", "wall_cabinet", "door_left_hinge").plan
    assert plan.status == "infeasible"
    why = "no grasp is within reach at waypoint 1, wherever the base moves"
    assert dict(plan.candidates.rejections) == {why: 1}


def test_a_refusal_tells_reach_from_load(kitchen: Scene) -> None:
    """The seal of a fridge holds more than a light robot bears, from all base poses in reach."""
    plan = moving(kitchen, "stretch", "fridge", "door_hinge").plan
    assert plan.status == "infeasible"
    counts, nearest = plan.candidates.rejections, plan.candidates.nearest
    assert sum(counts.values()) == plan.candidates.sampled
    assert {"base in collision", "beyond the arm's reach", "stretch would tip over"} <= set(counts)
    assert nearest.reason.startswith("stretch would tip over at waypoint ")


def test_a_base_path_in_collision_is_counted_apart(kitchen: Scene) -> None:
    """A robot of six joints tries base paths, and some lead into furniture."""
    plan = moving(kitchen, "segway_ur5e", "wall_cabinet", "door_left_hinge").plan
    assert plan.feasible
    counts = plan.candidates.rejections
    assert counts["base in collision as it moves with the part"] > 0
    assert counts["base in collision"] > 0


def test_a_base_that_moves_with_a_latch_is_refused_in_words(kitchen: Scene) -> None:
    setup = prepared(kitchen, "segway_ur5e", "cabinet_right", "drawer_top_slide")
    motion = setup.prepared.motion
    latched = replace(motion, latch_q=np.zeros(len(motion.object_q)))
    found = search_moving(
        replace(setup, prepared=replace(setup.prepared, motion=latched)), PlaceConfig()
    )
    assert found.is_no
    why = "a latch is turned and opened from one base pose"
    assert dict(found.candidates().rejections) == {why: 1}


def prepared(scene: Scene, robot: str, item: str, joint: str) -> SearchSetup:
    task = make_task(scene, "open", item, joint)
    query = PlacementQuery.of(scene, load_robot(robot), task, clock=time.process_time)
    motion = task_motion(scene, query.robot, task, query.config.motion)
    return prepare_search(query, scene, motion)


def test_starts_put_the_hand_at_its_grasp(kitchen: Scene, stretch: Robot) -> None:
    task = make_task(kitchen, "open", "microwave", "door_hinge")
    motion = task_motion(kitchen, stretch, task, PipelineConfig().motion)
    starts = ShortArmStarts(stretch, motion)
    yaw = np.linspace(-np.pi, np.pi, 24, endpoint=False)
    position = motion.Ts_world_tool[0, motion.grasp_step, :2, 3]
    poses, grasps = starts(np.column_stack([np.tile(position, (24, 1)), yaw]))
    found = grasps >= 0
    assert found.any()
    np.testing.assert_array_equal(poses[:, 2], yaw)
    q, count = starts._solve(poses[found], grasps[found], motion.grasp_step)
    assert (count > 0).all()
    nearest = np.nanmin(np.hypot(q[..., 0], q[..., 1]), axis=1)
    np.testing.assert_allclose(nearest, 0.0, atol=1e-6)
