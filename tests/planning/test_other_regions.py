"""Laws of other base poses, for a robot that cannot do the next task from where it stands."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from tests.rooms import corridor_room

from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.tasks import make_task
from momapos.planning.navigation.footprint_map import build_navigation_map
from momapos.planning.navigation.global_path import plan_path
from momapos.planning.navigation.outline_gaps import gaps
from momapos.planning.other_regions import base_poses_elsewhere
from momapos.planning.placement.area import BaseStatus, base_pose_status
from momapos.planning.placement.problem import PoseFilter
from momapos.planning.task_setup import PreparedTask, prepare

OUTSIDE, DEAD_END = np.array([-0.5, -0.95, -1.3]), np.array([0.5, -0.55, 2.9])
"""Base poses on either side of the open door."""
OPEN = 1.2


@pytest.fixture(scope="module")
def corridor(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return corridor_room(tmp_path_factory.mktemp("corridor"))


@pytest.fixture(scope="module")
def prepared(corridor: Scene, robots: Callable[[str], Robot]) -> PreparedTask:
    task = make_task(corridor, "open", "cabinet", to=OPEN)
    return prepare(corridor, robots("segway_ur5e"), task, PipelineConfig(), clearance=0.01)


def elsewhere(prepared: PreparedTask, to: float, tried: Sequence[np.ndarray]) -> PoseFilter | None:
    after = prepared.scene.with_joint("cabinet", "hinge", to)
    return base_poses_elsewhere(prepared.geometry, after, tried)


@pytest.mark.parametrize("tried", [OUTSIDE, DEAD_END])
def test_where_the_open_door_parts_the_room_the_other_side_is_left(
    prepared: PreparedTask, tried: np.ndarray
) -> None:
    out = elsewhere(prepared, OPEN, [tried])
    assert out is not None
    poses = np.random.default_rng(0).uniform([-2.0, -1.0, -np.pi], [2.0, 0.0, np.pi], (400, 3))
    stands = base_pose_status(prepared.geometry, poses)[0] == BaseStatus.CLEAR
    left = poses[stands][~out(poses[stands])]
    assert len(left) > 3
    room = build_navigation_map(prepared.scene.with_joint("cabinet", "hinge", OPEN), prepared.robot)
    for pose in left[:5]:
        assert plan_path(room, tried, pose) is None
    assert out(np.array([tried])).all()


def test_nothing_is_left_where_both_sides_were_tried(prepared: PreparedTask) -> None:
    assert elsewhere(prepared, OPEN, [OUTSIDE, DEAD_END]) is None


def test_nothing_is_left_where_the_door_parts_nothing(prepared: PreparedTask) -> None:
    assert elsewhere(prepared, 0.2, [OUTSIDE]) is None


def test_a_base_pose_is_left_out_where_the_arm_cannot_come_home(prepared: PreparedTask) -> None:
    out = elsewhere(prepared, OPEN, [OUTSIDE])
    assert out is not None
    room = build_navigation_map(prepared.scene.with_joint("cabinet", "hinge", OPEN), prepared.robot)
    beyond = np.random.default_rng(1).uniform([0.55, -0.9, -np.pi], [0.9, 0.0, np.pi], (400, 3))
    touches = gaps(beyond, room.prisms, room.obstacles) <= 0.0
    assert 10 < touches.sum() < 390
    np.testing.assert_array_equal(out(beyond), touches)


def test_of_a_base_pose_where_the_arm_cannot_come_home_others_beside_it_are_left(
    prepared: PreparedTask,
) -> None:
    room = build_navigation_map(prepared.scene.with_joint("cabinet", "hinge", OPEN), prepared.robot)
    poses = np.random.default_rng(2).uniform([-1.5, -0.9, -np.pi], [1.0, 0.0, np.pi], (400, 3))
    touches = gaps(poses, room.prisms, room.obstacles) <= 0.0
    assert 10 < touches.sum() < 390
    out = elsewhere(prepared, OPEN, [poses[touches][0]])
    assert out is not None
    np.testing.assert_array_equal(out(poses), touches)
    again = elsewhere(prepared, OPEN, [poses[touches][0], OUTSIDE])
    alone = elsewhere(prepared, OPEN, [OUTSIDE])
    assert again is not None
    assert alone is not None
    np.testing.assert_array_equal(again(poses), alone(poses))
