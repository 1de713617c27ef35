"""Test the grasps of rigid objects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos.core.geometry.transforms import invert, pose
from momapos.model.records.plans import Family
from momapos.model.robots.robot import Grip, Robot
from momapos.model.scene.resistance_config import ResistanceConfig
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import box_urdf
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import GraspConfig, MotionConfig
from momapos.planning.grasps.hand_boxes import hand_of
from momapos.planning.grasps.part_grasps import HELD_CLEARANCE_SHARE, Contact, lifting_capacity
from momapos.planning.grasps.task_motions import TaskMotion, task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.reachability.map_store import load_reach_map

DEFAULT = MotionConfig()
OBJECTS = ("cup", "apple", "bottle", "cereal_box")
NONE = 1e-9


def in_object(motion: TaskMotion, scene: Scene) -> np.ndarray:
    """Return the tool poses at the grasp in the object frame."""
    T = scene.object(motion.task.object).T_world_object
    return invert(T) @ motion.Ts_world_tool[:, motion.grasp_step]


def box_of(scene: Scene, name: str) -> np.ndarray:
    """Return the half size of an object that is one box about its origin."""
    (hulls,) = scene.object(name).model.hulls.values()
    return hulls[0].vertices.max(0)


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("verb", ["pick", "place"])
def test_the_pads_close_on_the_faces_of_a_box(
    robot: Robot, kitchen: Scene, verb: str, name: str
) -> None:
    motion = task_motion(kitchen, robot, make_task(kitchen, verb, name), DEFAULT)
    assert not motion.refusal
    hand, half = hand_of(robot), box_of(kitchen, name)
    Ts = in_object(motion, kitchen)
    closing = Ts[:, :3, :3] @ hand.closing
    np.testing.assert_allclose(np.abs(closing).max(1), 1.0, atol=1e-6)  # perpendicular to two faces
    np.testing.assert_allclose(motion.grasps.width, 2 * np.abs(closing) @ half, atol=1e-3)
    low, high = hand.inner(1)[1]
    along = np.linspace(low[0], high[0], 9)[:, None] * hand.approach
    side = np.linspace(low[1], high[1], 5)[:, None] * np.cross(hand.approach, hand.closing)
    pad = (along[:, None] + side).reshape(-1, 3)
    points = np.einsum("gij,kj->gki", Ts[:, :3, :3], pad) + Ts[:, None, :3, 3]
    outside = np.abs(points) - half
    faces = np.abs(closing).argmax(1)
    outside[np.arange(len(Ts)), :, faces] = -1.0
    assert (outside < 0).all(-1).any(1).all()


@pytest.mark.parametrize("name", OBJECTS)
def test_a_grasp_bears_weight_and_torque_in_any_orientation(
    robot: Robot, kitchen: Scene, name: str
) -> None:
    lifts, carries = (
        task_motion(kitchen, robot, make_task(kitchen, verb, name), DEFAULT).grasps
        for verb in ("pick", "place")
    )
    for grasps in (lifts, carries):
        assert (grasps.capacity >= DEFAULT.grasps.grasp_margin * grasps.need).all()
    assert 0 < len(carries) <= len(lifts)
    assert carries.capacity.max() <= lifts.capacity.max() + NONE


def box_room(width: float) -> Scene:
    """Return a scene with only a box on the floor."""
    model = Articulated(box_urdf("box", (width, 0.12, 0.08)))
    return Scene("box", (SceneObject("box", "box", pose((0.0, 0.0, 0.04)), model),))


@pytest.mark.parametrize("verb", ["pick", "place"])
def test_fingers_approach_an_object_with_the_clearance_of_a_grasp(robot: Robot, verb: str) -> None:
    least = DEFAULT.grasps.hand_clearance * HELD_CLEARANCE_SHARE
    for clearance, refused in ((1.1 * least, False), (0.9 * least, True)):
        scene = box_room(robot.opening - 2 * clearance)
        motion = task_motion(scene, robot, make_task(scene, verb, "box"), DEFAULT)
        assert ("cm wide" in motion.refusal) == refused == bool(motion.refusal)


def contact_at(*points: list[float]) -> Contact:
    """Return contacts at points, with a spread of 1 cm."""
    count = np.ones(len(points))
    return Contact(1e-4 * count, np.array(points), 0 * count, 0.01 * count)


def test_an_offset_of_the_center_of_mass_reduces_the_payload() -> None:
    contact = contact_at([0, 0, 0], [0, 0, 0.1], [0.01, 0, 0], [0.1, 0, 0], [0, 0.01, 0])
    closing = np.tile([0.0, 1.0, 0.0], (5, 1))
    lifts = lifting_capacity(
        50.0, 0.5, contact, closing, np.full(5, 0.04), np.zeros(3), np.array([[0.0, 0.0, -1.0]])
    )
    np.testing.assert_allclose(lifts[:2], 50.0)  # two pads, each by 0.5 x 50 N
    assert lifts[2] == pytest.approx(50.0 / np.sqrt(2.0))  # offset 1 cm, spread 1 cm
    assert lifts[3] < 6.0
    assert lifts[4] == pytest.approx(50.0 / 1.5)  # nearer to one pad, which bears 3/4
    tilted = lifting_capacity(
        50.0, 0.5, contact, closing, np.full(5, 0.04), np.zeros(3), np.array([[1.0, 0.0, 0.0]])
    )
    assert tilted[1] < 6.0


@pytest.mark.parametrize(
    ("name", "config", "words"),
    [
        ("table", GraspConfig(), "cm wide, and the gripper of"),
        ("cup", GraspConfig(resistance=ResistanceConfig(density=1e5)), "N of it at most, and"),
        ("cup", GraspConfig(pad_contact=50.0), "motion.grasps.pad_contact is 50 cm"),
    ],
)
def test_an_object_that_cannot_be_grasped_is_refused_before_the_search(
    kitchen: Scene, robot: Robot, name: str, config: GraspConfig, words: str
) -> None:
    task = make_task(kitchen, "pick", name)
    assert words in task_motion(kitchen, robot, task, MotionConfig(grasps=config)).refusal


def test_the_plan_of_such_a_task_states_only_the_reason(
    kitchen: Scene, robot: Robot, tmp_path: Path
) -> None:
    heavy = MotionConfig(grasps=GraspConfig(resistance=ResistanceConfig(density=1e5)))
    task, reach = make_task(kitchen, "pick", "cup"), load_reach_map(robot, tmp_path)
    config = PipelineConfig(motion=heavy)
    plan = plan_base_placement(kitchen, robot, task, reach, config=config).plan
    assert plan.status == "infeasible"
    assert plan.candidates.checked == 0
    assert dict(plan.candidates.rejections) == {task_motion(kitchen, robot, task, heavy).refusal: 1}


def test_a_suction_cup_is_perpendicular_to_faces(robot: Robot, kitchen: Scene) -> None:
    suction = replace(robot, grips=Grip.SUCTION)
    motion = task_motion(kitchen, suction, make_task(kitchen, "pick", "cereal_box"), DEFAULT)
    assert not motion.refusal
    assert set(motion.grasps.family) == {Family.SUCTION}
    half, hand = box_of(kitchen, "cereal_box"), hand_of(suction)
    Ts = in_object(motion, kitchen)
    approach = Ts[:, :3, :3] @ hand.approach
    tips = Ts[:, :3, 3] + hand.tip * approach
    beyond = np.abs(tips) - half
    assert (np.abs(approach).max(1) > np.cos(np.arctan(DEFAULT.grasps.friction))).all()
    assert (np.abs(beyond.max(1)) < 0.01).all()


def test_a_hook_cannot_lift_an_object(robot: Robot, kitchen: Scene) -> None:
    hooks = replace(robot, grips=Grip.HOOK)
    motion = task_motion(kitchen, hooks, make_task(kitchen, "pick", "cup"), DEFAULT)
    assert "no fingers that close" in motion.refusal
