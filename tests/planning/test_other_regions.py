"""Laws of base poses in other regions, for a next task that is infeasible from here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from tests.rooms import corridor_room

from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.navigation.footprint_map import build_navigation_map
from momapos.planning.navigation.global_path import plan_path
from momapos.planning.navigation.outline_gaps import gaps
from momapos.planning.other_regions import poses_in_other_regions
from momapos.planning.placement.area import BaseStatus, base_pose_status
from momapos.planning.placement.problem import PoseMask
from momapos.planning.task_setup import PreparedTask, prepare

OUTSIDE, DEAD_END = np.array([-0.5, -0.95, -1.3]), np.array([0.5, -0.55, 2.9])
"""Base poses on either side of the open door."""
OPEN = 1.2


@pytest.fixture(scope="module")
def corridor(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return corridor_room(tmp_path_factory.mktemp("corridor"))


@pytest.fixture(scope="module")
def prepared(corridor: Scene, segway: Robot) -> PreparedTask:
    task = make_task(corridor, "open", "cabinet", to=OPEN)
    return prepare(corridor, segway, task, PipelineConfig(), clearance=0.01)


def others(prepared: PreparedTask, to: float, tried: Sequence[np.ndarray]) -> PoseMask | None:
    after = prepared.scene.with_joint("cabinet", "hinge", to)
    return poses_in_other_regions(prepared.geometry, after, tried)


@pytest.mark.parametrize("tried", [OUTSIDE, DEAD_END])
def test_poses_on_the_other_side_of_a_door_that_splits_the_room_remain(
    prepared: PreparedTask, tried: np.ndarray
) -> None:
    kept = others(prepared, OPEN, [tried])
    poses = np.random.default_rng(0).uniform([-2.0, -1.0, -np.pi], [2.0, 0.0, np.pi], (400, 3))
    stands = base_pose_status(prepared.geometry, poses)[0] == BaseStatus.CLEAR
    left = poses[stands][kept(poses[stands])]
    assert len(left) > 3
    room = build_navigation_map(prepared.scene.with_joint("cabinet", "hinge", OPEN), prepared.robot)
    for pose in left[:5]:
        assert plan_path(room, tried, pose) is None
    assert not kept(np.array([tried])).any()


def test_no_pose_remains_after_both_sides_were_tried(prepared: PreparedTask) -> None:
    assert others(prepared, OPEN, [OUTSIDE, DEAD_END]) is None


def test_no_pose_remains_if_the_door_splits_nothing(prepared: PreparedTask) -> None:
    assert others(prepared, 0.2, [OUTSIDE]) is None


def test_base_poses_where_the_arm_cannot_return_home_are_excluded(prepared: PreparedTask) -> None:
    kept = others(prepared, OPEN, [OUTSIDE])
    room = build_navigation_map(prepared.scene.with_joint("cabinet", "hinge", OPEN), prepared.robot)
    beyond = np.random.default_rng(1).uniform([0.55, -0.9, -np.pi], [0.9, 0.0, np.pi], (400, 3))
    collides = gaps(beyond, room.prisms, room.obstacles) <= 0.0
    assert 10 < collides.sum() < 390
    np.testing.assert_array_equal(kept(beyond), ~collides)


def test_a_tried_pose_where_the_arm_cannot_return_home_excludes_no_region(
    prepared: PreparedTask,
) -> None:
    room = build_navigation_map(prepared.scene.with_joint("cabinet", "hinge", OPEN), prepared.robot)
    poses = np.random.default_rng(2).uniform([-1.5, -0.9, -np.pi], [1.0, 0.0, np.pi], (400, 3))
    collides = gaps(poses, room.prisms, room.obstacles) <= 0.0
    assert 10 < collides.sum() < 390
    kept = others(prepared, OPEN, [poses[collides][0]])
    np.testing.assert_array_equal(kept(poses), ~collides)
    again = others(prepared, OPEN, [poses[collides][0], OUTSIDE])
    alone = others(prepared, OPEN, [OUTSIDE])
    np.testing.assert_array_equal(again(poses), alone(poses))
