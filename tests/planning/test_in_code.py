"""Laws of scenes built in code, checks of one base pose, and timed motions."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos import (
    PlacementPlan,
    Robot,
    Scene,
    SceneObject,
    SpeedConfig,
    Task,
    check_base_pose,
    load_reach_map,
    load_scene,
    make_task,
    plan_base_placement,
    save_scene,
    time_plan,
)
from momapos.core.errors import InputError, UnknownNameError
from momapos.core.geometry.transforms import pose_planar
from momapos.model.trajectory import with_times

CUPBOARD = Path(__file__).parents[2] / "examples" / "cupboard.urdf"


@pytest.fixture(scope="module")
def task(kitchen: Scene) -> Task:
    return make_task(kitchen, "open", "fridge", "door_hinge")


@pytest.fixture(scope="module")
def plan(kitchen: Scene, segway: Robot, task: Task) -> PlacementPlan:
    return plan_base_placement(kitchen, segway, task).plan


def test_a_box_is_at_its_given_pose() -> None:
    box = SceneObject.box("table", (2.0, 1.0, 0.5), (1.0, -2.0, 0.25), yaw=np.pi / 2)
    np.testing.assert_allclose(box.bounds, [[0.5, -3.0, 0.0], [1.5, -1.0, 0.5]], atol=1e-12)


@pytest.mark.parametrize("size", [(0.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, float("nan"))])
def test_a_box_without_an_extent_is_refused(size: tuple[float, float, float]) -> None:
    with pytest.raises(InputError, match="size of box 'table'"):
        SceneObject.box("table", size, (0.0, 0.0, 0.0))


def test_a_urdf_object_is_at_its_given_pose_and_joint_values() -> None:
    closed = SceneObject.from_urdf("cupboard", CUPBOARD, (1.0, 2.0, 0.0), yaw=np.pi)
    ajar = SceneObject.from_urdf("cupboard", CUPBOARD, (1.0, 2.0, 0.0), joints={"hinge": 0.5})
    np.testing.assert_allclose(closed.T_world_object[:2, 3], [1.0, 2.0])
    assert closed.values()["hinge"] == 0.0
    assert ajar.values()["hinge"] == 0.5
    with pytest.raises(UnknownNameError, match="hinge"):
        SceneObject.from_urdf("cupboard", CUPBOARD, (0.0, 0.0, 0.0), joints={"door": 0.5})


def test_a_saved_scene_knows_its_file(tmp_path: Path) -> None:
    room = Scene("room", (SceneObject.box("table", (1, 1, 1), (0, 0, 0.5)),))
    saved = save_scene(room, tmp_path / "room.json")
    assert saved.path == tmp_path / "room.json"
    assert load_scene(saved.path).object("table").name == "table"


def test_the_base_pose_of_an_answer_is_feasible_and_a_blocked_one_has_a_reason(
    kitchen: Scene, segway: Robot, task: Task, plan: PlacementPlan
) -> None:
    assert plan.base_pose is not None
    assert check_base_pose(kitchen, segway, task, plan.base_pose).motion is not None
    blocked = check_base_pose(kitchen, segway, task, (0.6, -0.3, np.pi / 2))
    assert blocked.motion is None
    assert blocked.reason == "base in collision"


def test_the_score_of_a_base_pose_is_that_of_the_tool_pose_in_its_frame(segway: Robot) -> None:
    reach = load_reach_map(segway)
    T = np.eye(4)
    T[:3, 3] = 0.4, 0.2, 1.1
    poses = np.random.default_rng(0).uniform([-1, -1, -3], [1, 1, 3], (200, 3))
    one_by_one = reach.score(np.linalg.inv(pose_planar(poses)) @ T)
    np.testing.assert_allclose(reach.score_base_poses(poses, T), one_by_one, atol=1e-3)
    assert (one_by_one > 0).any()


def test_a_timed_plan_passes_through_its_states(segway: Robot, plan: PlacementPlan) -> None:
    timed = time_plan(plan, segway)
    assert (np.diff(timed.times) > 0).all()
    np.testing.assert_allclose(timed.positions[0], plan.motion.approach[0], atol=1e-9)
    np.testing.assert_allclose(timed.positions[timed.grasp_index], plan.motion.q[0], atol=1e-9)
    np.testing.assert_allclose(timed.positions[-1], plan.motion.q[-1], atol=1e-9)
    np.testing.assert_allclose(timed.velocities[[0, timed.grasp_index, -1]], 0.0, atol=1e-2)


def test_a_plan_with_times_is_as_fast_as_its_trajectory(segway: Robot, plan: PlacementPlan) -> None:
    motion = with_times(plan, segway).motion
    assert len(motion.approach_times) == len(motion.approach)
    assert len(motion.times) == len(motion.q)
    whole = motion.approach_times[-1] + motion.times[-1]
    assert whole == pytest.approx(time_plan(plan, segway).times[-1], rel=0.1)


def test_a_slower_plan_takes_longer(segway: Robot, plan: PlacementPlan) -> None:
    slow = SpeedConfig(approach_speed=0.1, manipulation_speed=0.1)
    assert time_plan(plan, segway, slow).times[-1] > 1.5 * time_plan(plan, segway).times[-1]


def test_a_trajectory_is_written_as_csv(segway: Robot, plan: PlacementPlan, tmp_path: Path) -> None:
    timed = time_plan(plan, segway)
    timed.write_csv(tmp_path / "out.csv")
    head, *rows = csv.reader((tmp_path / "out.csv").read_text().splitlines())
    assert head[: 1 + len(timed.joints)] == ["time", *timed.joints]
    columns = np.array(rows, float).T
    np.testing.assert_allclose(columns[0], timed.times, atol=1e-6)
    np.testing.assert_allclose(columns[1 : 1 + len(timed.joints)].T, timed.positions, atol=1e-6)


def test_a_plan_without_an_answer_has_no_trajectory(segway: Robot, plan: PlacementPlan) -> None:
    with pytest.raises(InputError, match="infeasible"):
        time_plan(replace(plan, status="infeasible", motion=None, base_pose=None), segway)
