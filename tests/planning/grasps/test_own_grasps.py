"""Grasps of the user's own: used like the planner's where they hold, and refused where wrong."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from momapos.core.errors import InputError
from momapos.core.geometry import invert
from momapos.model.records.plans import Task
from momapos.model.robots.robot import Grip, Robot
from momapos.model.scene.scene import Scene
from momapos.planning.answer_notes import notes_on
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import MotionConfig
from momapos.planning.grasps.motion_record import TaskMotion
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig

QUICK = PipelineConfig(place=PlaceConfig(count=256, polish=1), timeout=300.0)
NONE = np.zeros((0, 4, 4))


@pytest.fixture(scope="module", params=["part", "object"])
def task(request: pytest.FixtureRequest, kitchen: Scene) -> Task:
    if request.param == "part":
        return make_task(kitchen, "open", "fridge", "door_hinge")
    return make_task(kitchen, "pick", "cup")


def in_link(scene: Scene, motion: TaskMotion) -> np.ndarray:
    """Return the grasps of a motion in the frame in which a source returns its own."""
    target, joint = scene.object(motion.task.object), motion.task.joint
    link = target.model.urdf.root if joint is None else target.joint(joint).child
    return invert(target.link_poses()[link]) @ motion.Ts_world_tool[:, motion.grasp_step]


def rolled(Ts: np.ndarray, robot: Robot, angle: float) -> np.ndarray:
    """Return hands that are turned about their approach."""
    x, y, z = robot.approach_axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out = Ts.copy()
    out[:, :3, :3] = Ts[:, :3, :3] @ (np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)
    return out


def rotations(Ts: np.ndarray) -> set[bytes]:
    return {(np.round(T[:3, :3], 5) + 0.0).tobytes() for T in Ts}


def test_own_grasps_are_added_and_found_by_their_turn(
    kitchen: Scene, segway: Robot, task: Task
) -> None:
    usual = task_motion(kitchen, segway, task, MotionConfig())
    own = rolled(in_link(kitchen, usual), segway, np.radians(4.0))
    motion = task_motion(kitchen, segway.with_grasps(lambda *_: own), task, MotionConfig())
    found = rotations(in_link(kitchen, motion))
    assert found >= rotations(in_link(kitchen, usual))
    assert len(found & rotations(own)) > 5
    need, capacity = motion.grasps.need, motion.grasps.capacity
    assert (capacity >= need).all()


def test_an_answer_may_hold_by_own_grasps_only(kitchen: Scene, segway: Robot, task: Task) -> None:
    usual = task_motion(kitchen, segway, task, MotionConfig())
    own = rolled(in_link(kitchen, usual), segway, np.radians(4.0))
    requests: list[tuple[str, str | None]] = []

    def source(name: str, joint: str | None) -> np.ndarray:
        requests.append((name, joint))
        return own

    def is_own(motion: TaskMotion) -> np.ndarray:
        mine = rotations(own)
        return np.array([bool(rotations(T[None]) & mine) for T in in_link(kitchen, motion)], bool)

    answer = plan_base_placement(
        kitchen, segway.with_grasps(source), task, keep_grasps=is_own, config=QUICK
    )
    assert answer.plan.status == "solved"
    assert requests == [(task.object, task.joint)]


def test_what_cannot_be_used_changes_nothing_and_is_stated(
    kitchen: Scene, segway: Robot, task: Task
) -> None:
    usual = task_motion(kitchen, segway, task, MotionConfig())
    far = in_link(kitchen, usual)[:3]
    far[:, :3, 3] += 5.0
    with_far = segway.with_grasps(lambda *_: far)
    motion = task_motion(kitchen, with_far, task, MotionConfig())
    np.testing.assert_array_equal(usual.Ts_world_tool, motion.Ts_world_tool)
    answer = plan_base_placement(kitchen, with_far, task, config=QUICK)
    notes = notes_on(answer.plan, answer.prepared)
    assert any(note.startswith("0 of 3 grasps of your own can be used") for note in notes)
    without = plan_base_placement(
        kitchen, with_far.with_grasps(lambda *_: NONE), task, config=QUICK
    )
    assert not any("of your own" in note for note in notes_on(without.plan, without.prepared))
    assert without.plan.base_pose == answer.plan.base_pose


def test_a_hand_that_does_not_close_uses_no_own_grasps(kitchen: Scene, segway: Robot) -> None:
    hook = replace(segway, grips=Grip.HOOK)
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    usual = task_motion(kitchen, hook, task, MotionConfig())
    own = in_link(kitchen, task_motion(kitchen, segway, task, MotionConfig()))
    motion = task_motion(kitchen, hook.with_grasps(lambda *_: own), task, MotionConfig())
    np.testing.assert_array_equal(usual.Ts_world_tool, motion.Ts_world_tool)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (np.eye(4), r"must be poses of shape \(g, 4, 4\), not an array of float64"),
        (np.zeros((2, 3, 4)), r"of shape \(2, 3, 4\)"),
        ([["a"]], r"must be poses of shape"),
        (np.full((2, 4, 4), np.nan), "must be finite; pose 0 is not"),
        (np.stack([np.eye(4), 2 * np.eye(4)]), "pose 1 is no pose of a hand"),
        (np.diag([1.0, 1.0, -1.0, 1.0])[None], "pose 0 is no pose of a hand"),
        (np.zeros((100_001, 4, 4)), "at most 100,000, not 100,001"),
    ],
)
def test_a_source_that_returns_no_poses_is_named(
    kitchen: Scene, segway: Robot, wrong: Any, words: str
) -> None:
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    with pytest.raises(InputError, match=f"the grasps of your own for fridge/door_hinge.*{words}"):
        plan_base_placement(kitchen, segway.with_grasps(lambda *_: wrong), task)
