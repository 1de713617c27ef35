"""Test tasks: what may be requested, and the resulting handles and motions."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import cabinet_room

from momapos.core.errors import InputError, TaskError, UnknownNameError
from momapos.model.robots.load_limits import touches
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.articulated import opening_of
from momapos.planning.arm_motion.payload import payload_hits_at_home, with_payload
from momapos.planning.grasps.config import MotionConfig
from momapos.planning.grasps.handles import find_handle
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task, openable

KITCHENS = ("kitchen_small", "kitchen_island")


def test_doors_open_a_quarter_turn_and_drawers_completely_by_default(kitchen: Scene) -> None:
    assert make_task(kitchen, "open", "microwave").to == pytest.approx(np.pi / 2)
    drawer = kitchen.object("cabinet_left").model.joint("drawer_slide")
    assert make_task(kitchen, "open", "cabinet_left", "drawer_slide").to == drawer.upper


def test_closing_returns_to_the_closed_value(kitchen: Scene) -> None:
    opened = make_task(kitchen, "open", "microwave")
    ajar = kitchen.with_joint("microwave", opened.joint, opened.to)
    assert make_task(ajar, "close", "microwave").to == 0.0


@pytest.mark.parametrize(
    ("verb", "target", "joint", "to", "words"),
    [
        ("open", "fridge", None, None, "several moving parts"),
        ("open", "cup", None, None, "no movable joint"),
        ("open", "microwave", "door_hinge", 9.0, "outside its limits"),
        ("open", "microwave", "door_hinge", 0.0, "already closed"),
        ("open", "microwave", "door_hinge", "1e400", "finite"),
        ("close", "microwave", "door_hinge", 1.0, "means to open"),
        ("close", "microwave", "door_hinge", None, "already closed"),
        ("pick", "fridge", None, None, "rigid objects"),
        ("pick", "cup", "door", None, "leave out"),
        ("turn", "microwave", None, None, "one of open, close, press, pick, place"),
    ],
)
def test_an_invalid_request_is_refused_in_one_line(
    verb: str, target: str, joint: str | None, to: float | str | None, words: str, kitchen: Scene
) -> None:
    with pytest.raises(TaskError, match=words) as caught:
        make_task(kitchen, verb, target, joint, to)
    assert "\n" not in str(caught.value)


def test_a_value_that_is_no_number_is_refused(kitchen: Scene) -> None:
    with pytest.raises(InputError, match="to must be a finite number"):
        make_task(kitchen, "open", "microwave", "door_hinge", float("nan"))


@pytest.mark.parametrize("kind", ["continuous", "prismatic"])
def test_a_part_without_limits_is_not_moved_endlessly(kind: str, tmp_path: Path) -> None:
    cabinet_room(tmp_path)
    text = (tmp_path / "cabinet.urdf").read_text()
    endless = text.replace('type="revolute"', f'type="{kind}"')
    endless = endless.replace('upper="1.9"', 'upper="1e12"')
    assert endless != text
    (tmp_path / "cabinet.urdf").write_text(endless)
    scene = load_scene(tmp_path / "room.json")
    assert make_task(scene, "open", "cabinet", "hinge", 1.0).to == 1.0
    with pytest.raises(TaskError, match="moves at most"):
        make_task(scene, "open", "cabinet", "hinge", 1e9)


def test_a_wrong_joint_error_names_the_object_not_its_model(tmp_path: Path) -> None:
    room = cabinet_room(tmp_path)
    item = room.objects[0]
    room = replace(room, objects=(replace(item, name="elementE"), *room.objects[1:]))
    assert item.model.urdf.name != "elementE"
    with pytest.raises(UnknownNameError, match=r"movable joint 'dor'.*elementE"):
        make_task(room, "open", "elementE", "dor", None)


def test_a_wrong_name_error_suggests_the_nearest(kitchen: Scene) -> None:
    with pytest.raises(UnknownNameError, match="did you mean microwave"):
        make_task(kitchen, "open", "micowave")
    with pytest.raises(UnknownNameError, match="door_hinge"):
        make_task(kitchen, "open", "fridge", "dor_hinge")


@pytest.mark.parametrize("name", KITCHENS)
def test_handles_face_the_opening_direction(name: str) -> None:
    scene = load_scene(name)
    found = openable(scene)
    assert len(found) > 10
    for item, joint in found:
        target = scene.object(item)
        record = target.model.joint(joint)
        handle = find_handle(target.model, joint, opening_of(target.model, joint).sign)
        velocity = (
            record.axis if record.kind == "prismatic" else np.cross(record.axis, handle.center)
        )
        velocity = opening_of(target.model, joint).sign * velocity / np.linalg.norm(velocity)
        assert handle.out @ velocity > 0.8, (item, joint)
        assert abs(handle.out @ handle.long) < 1e-6
        assert not handle.edge
        assert 0.005 < handle.thickness < 0.05


def test_a_part_without_handle_is_grasped_at_its_free_edge(tmp_path: Path) -> None:
    cabinet_room(tmp_path)
    text = (tmp_path / "cabinet.urdf").read_text().replace("door_handle", "trim")
    bare = text.replace('size="0.016 0.016 0.2"', 'size="0.001 0.001 0.001"')
    (tmp_path / "cabinet.urdf").write_text(bare)
    model = load_scene(tmp_path / "room.json").object("cabinet").model
    handle = find_handle(model, "hinge", 1.0)
    assert handle.edge
    assert abs(handle.long[2]) > 0.99
    assert handle.center[0] < -0.45


def test_the_grasp_moves_rigidly_with_the_part(robot: Robot, tmp_path: Path) -> None:
    scene = cabinet_room(tmp_path)
    task = make_task(scene, "open", "cabinet")
    motion = task_motion(scene, robot, task, MotionConfig())
    target = scene.object("cabinet")
    hold = motion.grasp_step
    poses = [target.link_poses({"hinge": v})["door"] for v in motion.object_q[hold:]]
    grasps = np.linalg.inv(poses)[:, None] @ np.swapaxes(motion.Ts_world_tool[:, hold:], 0, 1)
    np.testing.assert_allclose(grasps, np.broadcast_to(grasps[:1], grasps.shape), atol=1e-9)
    assert motion.object_q[hold] == 0.0
    assert motion.object_q[-1] == task.to


def test_the_straight_approach_moves_along_the_approach_axis(robot: Robot, tmp_path: Path) -> None:
    scene = cabinet_room(tmp_path)
    motion = task_motion(scene, robot, make_task(scene, "open", "cabinet"), MotionConfig())
    before, grasp = motion.Ts_world_tool[:, 0], motion.Ts_world_tool[:, motion.grasp_step]
    travel = grasp[:, :3, 3] - before[:, :3, 3]
    wanted = MotionConfig().grasps.pregrasp * (grasp[:, :3, :3] @ robot.approach_axis)
    np.testing.assert_allclose(travel, wanted, atol=1e-9)


@pytest.mark.parametrize(
    ("target", "joint", "to", "words"),
    [
        ("microwave", "door_hinge", "30cm", "to 30cm is not an angle; write it as 90deg"),
        ("cabinet_left", "drawer_slide", "20deg", "to 20deg is not a length; write it as 0.3m"),
        ("microwave", "door_hinge", "90", "did you mean 90deg?"),
        ("microwave", "door_hinge", 90.0, "did you mean 90deg?"),
        ("cabinet_left", "drawer_slide", "30", "did you mean 30cm?"),
    ],
)
def test_a_value_in_a_wrong_unit_is_refused_with_a_suggestion(
    target: str, joint: str, to: float | str, words: str, kitchen: Scene
) -> None:
    with pytest.raises(TaskError, match=re.escape(words)) as caught:
        make_task(kitchen, "open", target, joint, to)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("digits", [3, 4, 5])
def test_a_limit_written_with_fewer_digits_is_that_limit(tmp_path: Path, digits: int) -> None:
    cabinet_room(tmp_path)
    text = (tmp_path / "cabinet.urdf").read_text()
    upper = np.pi / 2
    (tmp_path / "cabinet.urdf").write_text(text.replace('upper="1.9"', f'upper="{upper}"'))
    scene = load_scene(tmp_path / "room.json")
    assert make_task(scene, "open", "cabinet", "hinge", f"{upper:.{digits}f}").to == upper
    with pytest.raises(TaskError, match="outside its limits"):
        make_task(scene, "open", "cabinet", "hinge", upper + 0.01)


def test_ninety_degrees_match_a_limit_of_1_57(tmp_path: Path) -> None:
    cabinet_room(tmp_path)
    text = (tmp_path / "cabinet.urdf").read_text()
    (tmp_path / "cabinet.urdf").write_text(text.replace('upper="1.9"', 'upper="1.57"'))
    scene = load_scene(tmp_path / "room.json")
    assert make_task(scene, "open", "cabinet", "hinge", "90deg").to == 1.57


def test_as_far_as_possible_ends_at_the_limit_and_is_not_for_closing(tmp_path: Path) -> None:
    scene = cabinet_room(tmp_path)
    task = make_task(scene, "open", "cabinet", to="max")
    assert (task.to, task.farthest) == (1.9, True)
    assert not make_task(scene, "open", "cabinet", to="1.9rad").farthest
    ajar = scene.with_joint("cabinet", "hinge", 1.0)
    with pytest.raises(TaskError, match="close always closes a part completely"):
        make_task(ajar, "close", "cabinet", to="max")
    with pytest.raises(TaskError, match="already open"):
        make_task(scene.with_joint("cabinet", "hinge", 1.9), "open", "cabinet", to="max")


def test_a_door_without_limits_is_opened_by_a_full_turn_at_most(tmp_path: Path) -> None:
    cabinet_room(tmp_path)
    text = (tmp_path / "cabinet.urdf").read_text().replace("revolute", "continuous")
    (tmp_path / "cabinet.urdf").write_text(text)
    scene = load_scene(tmp_path / "room.json")
    assert make_task(scene, "open", "cabinet", to="max").to == pytest.approx(2 * np.pi)


@pytest.mark.parametrize("limit", ["lower", "upper"])
def test_a_door_whose_zero_is_halfway_can_be_opened_and_closed(tmp_path: Path, limit: str) -> None:
    """The joint frame is rotated: the door is closed at a limit and half open at zero."""
    cabinet_room(tmp_path)
    text = (tmp_path / "cabinet.urdf").read_text()
    # Closed at the lower limit, it opens with growing values; at the upper one it is mirrored.
    lower, upper, axis = (-1.05, 1.92, 1) if limit == "lower" else (-1.92, 1.05, -1)
    text = text.replace('<axis xyz="0 0 1.0"/>', f'<axis xyz="0 0 {axis}"/>')
    text = text.replace('-0.25 0.8"/>', '-0.25 0.8" rpy="0 0 1.05"/>')
    text = text.replace('lower="0" upper="1.9"', f'lower="{lower}" upper="{upper}"')
    (tmp_path / "cabinet.urdf").write_text(text)
    scene = load_scene(tmp_path / "room.json")
    closed = lower if limit == "lower" else upper
    sign = 1.0 if limit == "lower" else -1.0
    assert make_task(scene, "close", "cabinet").to == closed
    assert make_task(scene, "open", "cabinet").to == pytest.approx(closed + sign * np.pi / 2)
    ajar = scene.with_joint("cabinet", "hinge", closed)
    assert make_task(ajar, "open", "cabinet", "hinge", "0deg").to == 0.0
    model = scene.object("cabinet").model
    assert opening_of(model, "hinge").sign == sign


def test_a_door_closed_at_zero_is_closed_there_whatever_its_limits(tmp_path: Path) -> None:
    """A limit that lets the door swing into its cupboard does not change its closed value."""
    cabinet_room(tmp_path)
    text = (tmp_path / "cabinet.urdf").read_text()
    (tmp_path / "cabinet.urdf").write_text(text.replace('lower="0"', 'lower="-1.0"'))
    model = load_scene(tmp_path / "room.json").object("cabinet").model
    assert (opening_of(model, "hinge").closed, opening_of(model, "hinge").wide) == (0.0, 1.9)


def test_the_error_for_an_ambiguous_joint_lists_knobs_separately(tmp_path: Path) -> None:
    cabinet_room(tmp_path)
    text = (tmp_path / "cabinet.urdf").read_text()
    knob = (
        '<link name="knob_handle"><collision><geometry><box size="0.04 0.02 0.02"/></geometry>'
        '</collision></link><joint name="a_knob" type="revolute"><parent link="body"/>'
        '<child link="knob_handle"/><origin xyz="0 -0.3 0.45"/><axis xyz="0 1 0"/>'
        '<limit lower="0" upper="3" effort="1" velocity="1"/></joint></robot>'
    )
    (tmp_path / "cabinet.urdf").write_text(text.replace("</robot>", knob))
    with pytest.raises(TaskError, match="cabinet/JOINT: hinge; knobs: a_knob"):
        make_task(load_scene(tmp_path / "room.json"), "open", "cabinet")


@pytest.mark.parametrize("verb", ["pick", "place"])
def test_a_robot_without_a_gripper_cannot_pick_or_place(
    verb: str, robot: Robot, kitchen: Scene
) -> None:
    task = make_task(kitchen, verb, "cup")
    assert robot.has_gripper
    assert len(task_motion(kitchen, robot, task, MotionConfig()).Ts_world_tool)
    last = robot.model.joint(robot.arm_joints[-1]).child
    bare = replace(robot, gripper_links=(last,))
    assert not bare.has_gripper
    with pytest.raises(TaskError, match="has no gripper, so it cannot"):
        task_motion(kitchen, bare, task, MotionConfig())


@pytest.mark.parametrize("name", ["cup", "cereal_box"])
def test_grasps_whose_payload_touches_the_robot_at_home_are_found(
    robot: Robot, name: str, kitchen: Scene
) -> None:
    """A placed object starts with the arm at home."""
    motion = task_motion(kitchen, robot, make_task(kitchen, "place", name), MotionConfig())
    touched = payload_hits_at_home(robot, motion)
    for g in range(0, len(touched), 7):
        spheres = with_payload(robot, motion, motion.Ts_world_tool[g, 0], 0)
        hits = touches(robot.chain, spheres, robot.home[None])[0]
        assert hits == (touched[g] >= 0)
