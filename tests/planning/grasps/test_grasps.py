"""Test the grasps of parts: contact of closing fingers, and transmitted forces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import cabinet_room

from momapos.model.records.plans import Family
from momapos.model.robots.robot import Grip, Robot
from momapos.model.scene.joint_resistance import resistance_along
from momapos.model.scene.resistance_config import ResistanceConfig
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import opening_of
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import GraspConfig, MotionConfig
from momapos.planning.grasps.grasp_families import Grasps
from momapos.planning.grasps.hand_boxes import hand_of
from momapos.planning.grasps.handle_shapes import CarriedPart, part_elements
from momapos.planning.grasps.handles import (
    HandleKind,
    HandleSource,
    find_handle,
    find_handles,
    front_face,
    front_part,
)
from momapos.planning.grasps.part_grasps import grasps_of, pinch_capacity, push_grasps
from momapos.planning.grasps.part_motion import motion_direction
from momapos.planning.grasps.task_motions import TaskMotion, task_motion, with_other_handle
from momapos.planning.grasps.task_requests import make_task, openable
from momapos.planning.task_setup import prepare

CONFIG = GraspConfig()
DEEP = 1e-3
"""Maximum depth of the pads in the handle [m]."""


def changed(folder: Path, *changes: tuple[str, str]) -> Scene:
    """Return the cabinet scene with changes of its URDF."""
    cabinet_room(folder)
    file = folder / "cabinet.urdf"
    text = file.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file.write_text(text)
    return load_scene(folder / "room.json")


def opened(scene: Scene, robot: Robot) -> TaskMotion:
    return task_motion(scene, robot, make_task(scene, "open", "cabinet"), MotionConfig())


def box_corners(robot: Robot, travel: float) -> list[tuple[int, bool, np.ndarray]]:
    """Return side, whether a pad, and grid points of each box of a hand with closed fingers."""
    hand, found = hand_of(robot), []
    t = np.linspace(-1, 1, 5)
    grid = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
    for center, rotation, half, side, pad in zip(
        hand.boxes.center, hand.boxes.rotation, hand.boxes.half, hand.side, hand.pad, strict=True
    ):
        at = center - side * travel * hand.closing
        found.append((int(side), bool(pad), at + (grid * half) @ rotation.T))
    return found


def test_the_distance_of_the_pads_is_the_opening(robot: Robot) -> None:
    hand = hand_of(robot)
    assert hand.closes
    assert hand.inner(1)[0] - hand.inner(-1)[0] == pytest.approx(robot.opening, abs=2e-3)
    assert hand.pad_middle < hand.tip
    assert set(hand.side[hand.pad]) == {1, -1}


def test_closed_fingers_touch_only_the_handle_and_only_with_their_pads(
    robot: Robot, kitchen: Scene
) -> None:
    for item, joint in (("fridge", "door_hinge"), ("cabinet_left", "drawer_slide")):
        model = kitchen.object(item).model
        handle = find_handle(model, joint, opening_of(model, joint).sign)
        found = grasps_of(robot, model, joint, 1.0, handle, CONFIG)
        assert len(found.code) > 20
        own = {id(e) for e in handle.elements}
        for T, width in zip(found.Ts_part_tool[::7], found.width[::7], strict=True):
            touched = {1: -np.inf, -1: -np.inf}
            for side, pad, points in box_corners(robot, (robot.opening - width) / 2):
                at = points @ T[:3, :3].T + T[:3, 3]
                for element in part_elements(CarriedPart.of(model, joint)):
                    depth = element.convex.depth(at).max()
                    if pad and id(element) in own:
                        touched[side] = max(touched[side], depth)
                    assert depth < DEEP, (element.name, side, pad, depth)
            assert min(touched.values()) > -0.01


def test_open_fingers_approach_without_contact(robot: Robot, kitchen: Scene) -> None:
    model = kitchen.object("microwave").model
    handle = find_handle(model, "door_hinge", 1.0)
    found = grasps_of(robot, model, "door_hinge", 1.0, handle, CONFIG)
    for T in found.Ts_part_tool[::5]:
        back = T[:3, :3] @ robot.approach_axis
        for _, _, points in box_corners(robot, 0.0):
            for distance in np.linspace(0, CONFIG.pregrasp, 9):
                at = points @ T[:3, :3].T + T[:3, 3] - distance * back
                for element in part_elements(CarriedPart.of(model, "door_hinge")):
                    assert element.convex.depth(at).max() <= 0.0


def test_every_grasp_points_at_the_handle_and_closes_across_it(
    robot: Robot, kitchen: Scene
) -> None:
    model = kitchen.object("microwave").model
    handle = find_handle(model, "door_hinge", 1.0)
    T = grasps_of(robot, model, "door_hinge", 1.0, handle, CONFIG).Ts_part_tool
    assert len(T) >= 40
    approach, closing = T[:, :3, :3] @ robot.approach_axis, T[:, :3, :3] @ robot.closing_axis
    np.testing.assert_allclose(np.linalg.det(T[:, :3, :3]), 1.0, atol=1e-9)
    assert (approach @ handle.out < 1e-6).all()
    assert (np.abs(closing @ handle.long) < np.sin(np.radians(max(CONFIG.tilts)) + 0.01)).all()
    along = (T[:, :3, 3] - handle.center) @ handle.long
    assert (np.abs(along) <= handle.half_length + 0.02).all()


def test_friction_carries_a_pull_across_the_pads_and_force_one_along_them() -> None:
    assert pinch_capacity(60.0, 0.6, np.array([0.0]))[0] == pytest.approx(72.0)
    assert pinch_capacity(60.0, 0.6, np.array([1.0]))[0] == pytest.approx(60.0)
    both = pinch_capacity(60.0, 0.6, np.array([0.5]))[0]
    # The unloaded pad has less friction.
    along, across = 0.5 * both, np.sqrt(0.75) * both
    assert across == pytest.approx(0.6 * (2 * 60.0 - along))


def test_the_needed_force_is_the_torque_over_the_lever_arm(robot: Robot, tmp_path: Path) -> None:
    motion = opened(changed(tmp_path), robot)
    item = changed(tmp_path).object("cabinet")
    lever = np.linalg.norm(find_handle(item.model, "hinge", 1.0).center[:2])
    values = np.linspace(0, 1.5, 5)
    torque = resistance_along(item, "hinge", values, float(lever), ResistanceConfig()).largest
    assert torque == pytest.approx(6.0 * lever + 0.4)
    grasps = motion.grasps
    assert (grasps.capacity >= CONFIG.grasp_margin * grasps.need).all()
    np.testing.assert_allclose(grasps.need * 0.5, torque, rtol=0.1)


def test_a_handle_too_thick_is_reported(robot: Robot, tmp_path: Path) -> None:
    size = robot.opening + 0.001
    scene = changed(tmp_path, ("0.016 0.016 0.2", f"{size} {size} 0.4"))
    task = make_task(scene, "open", "cabinet")
    ready = prepare(scene, robot, task, PipelineConfig(), clearance=0.0)
    assert "0.1 cm too thick for the gripper of" in ready.infeasible_reason
    assert f"opens {100 * robot.opening:.1f} cm" in ready.infeasible_reason


def test_a_handle_too_wide_in_one_direction_is_grasped_in_the_other(
    robot: Robot, tmp_path: Path
) -> None:
    """The bar is 8.6 cm wide and 2.6 cm deep, far before its door: the hand comes from the side."""
    wide = robot.opening + 0.001
    scene = changed(
        tmp_path, ("0.016 0.016 0.2", f"{wide} 0.026 0.3"), ('-0.065 0"/>', '-0.165 0"/>')
    )
    motion = opened(scene, robot)
    assert not motion.refusal
    assert motion.grasps.width.max() < 0.04


def test_a_gripper_too_weak_for_a_part_is_reported_with_both_forces(
    robot: Robot, tmp_path: Path
) -> None:
    scene = changed(tmp_path)
    weak = replace(robot, grip_force=0.5)
    task = make_task(scene, "open", "cabinet")
    ready = prepare(scene, weak, task, PipelineConfig(), clearance=0.0)
    assert "holds door_handle with 1 N at most" in ready.infeasible_reason
    assert "are needed at 0 deg" in ready.infeasible_reason


def test_an_unnamed_bar_is_found_by_its_shape_and_precedes_the_edge(
    robot: Robot, tmp_path: Path
) -> None:
    scene = changed(tmp_path, ("door_handle", "trim"))
    model = scene.object("cabinet").model
    bar, *others = find_handles(model, "hinge", 1.0)
    assert (bar.found, bar.kind) == (HandleSource.SHAPE, HandleKind.BAR)
    assert all(handle.edge for handle in others)
    named = find_handle(changed(tmp_path / "named").object("cabinet").model, "hinge", 1.0)
    np.testing.assert_allclose(bar.center, named.center, atol=1e-9)
    np.testing.assert_allclose(bar.out, named.out, atol=1e-9)
    assert str(opened(scene, robot).handle) == "bar 'trim', by its shape"


@pytest.mark.parametrize(
    ("size", "gap", "kind"),
    [
        ("0.016 0.016 0.2", "-0.065", HandleKind.BAR),
        ("0.03 0.03 0.03", "-0.035", HandleKind.KNOB),
        ("0.016 0.04 0.2", "-0.04", HandleKind.LIP),
    ],
)
def test_handles_are_classified_by_proportions_and_the_space_behind(
    size: str, gap: str, kind: HandleKind, tmp_path: Path
) -> None:
    scene = changed(tmp_path, ("0.016 0.016 0.2", size), ('-0.065 0"/>', f'{gap} 0"/>'))
    assert find_handle(scene.object("cabinet").model, "hinge", 1.0).kind is kind


def test_a_bar_with_posts_is_grasped_at_the_bar(kitchen: Scene) -> None:
    for item, joint in openable(kitchen):
        model = kitchen.object(item).model
        handle = find_handle(model, joint, opening_of(model, joint).sign)
        assert handle.kind is HandleKind.BAR, (item, joint)
        assert handle.depth == pytest.approx(0.02, abs=1e-6)
        assert any(e.convex.depth(handle.grip[None])[0] > 0.009 for e in handle.elements)


def test_geometry_flush_with_the_panel_is_no_handle(tmp_path: Path) -> None:
    flush = ('-0.065 0"/>', '-0.015 0"/>')
    scene = changed(tmp_path, ("door_handle", "trim"), flush, ("0.016 0.016", "0.016 0.002"))
    assert all(h.edge for h in find_handles(scene.object("cabinet").model, "hinge", 1.0))


def test_a_free_edge_is_grasped_only_where_fingers_get_behind_it(
    robot: Robot, tmp_path: Path
) -> None:
    """The closed door's edge lies before its body, so that no finger gets behind it."""
    bare = (("door_handle", "trim"), ("0.016 0.016 0.2", "0.001 0.001 0.001"))
    scene = changed(tmp_path, *bare)
    task = make_task(scene, "open", "cabinet")
    closed = prepare(scene, robot, task, PipelineConfig(), clearance=0.0)
    assert closed.motion.handle.edge
    assert "in every grasp" in closed.infeasible_reason
    ajar = scene.with_joint("cabinet", "hinge", 1.0)
    half_open = prepare(ajar, robot, task, PipelineConfig(), clearance=0.0)
    assert half_open.infeasible_reason == ""
    assert set(half_open.motion.grasps.family) == {Family.HOOK}


def test_a_door_is_closed_by_pushing_its_front(robot: Robot, tmp_path: Path) -> None:
    model = changed(tmp_path).object("cabinet").model
    face = front_face(front_part(model, "hinge", 1.0), 1.0)
    assert face is not None
    assert face.kind is HandleKind.FACE
    found = push_grasps(robot, model, "hinge", 1.0, face, CONFIG)
    assert len(found.code)
    for T, point in zip(found.Ts_part_tool, found.point, strict=True):
        into = T[:3, :3] @ robot.approach_axis
        assert into @ motion_direction(CarriedPart.of(model, "hinge"), 1.0, point) < 0.0
    ajar = changed(tmp_path).with_joint("cabinet", "hinge", 1.2)
    motion = task_motion(ajar, robot, make_task(ajar, "close", "cabinet"), MotionConfig())
    assert set(motion.grasps.family) >= {Family.PINCH, Family.PUSH}


@pytest.mark.parametrize("grips", [Grip.SUCTION, Grip.HOOK])
def test_a_tool_without_closing_fingers_has_the_force_of_its_file(
    grips: Grip, robot: Robot, tmp_path: Path
) -> None:
    motion = opened(changed(tmp_path), replace(robot, grips=grips))
    assert not motion.refusal
    wanted = Family.SUCTION if grips is Grip.SUCTION else Family.HOOK
    assert set(motion.grasps.family) == {wanted}
    assert (motion.grasps.capacity == robot.grip_force).all()


def test_a_subset_of_grasps_keeps_their_records(robot: Robot, tmp_path: Path) -> None:
    motion = opened(changed(tmp_path), robot)
    kept = np.zeros(len(motion.Ts_world_tool), bool)
    kept[::3] = True
    fewer = motion.only(kept)
    assert isinstance(fewer.grasps, Grasps)
    assert len(fewer.grasps) == len(fewer.Ts_world_tool) == kept.sum()
    np.testing.assert_array_equal(fewer.grasps.width, motion.grasps.width[kept])


def test_pads_do_not_hold_the_sharp_edge_of_a_bar(robot: Robot, tmp_path: Path) -> None:
    """A square bar turned by 40 degrees slips between the pads; a round one does not."""
    square = changed(tmp_path, ("0.016 0.016 0.2", "0.02 0.02 0.2"))
    shape = '<box size="0.016 0.016 0.2"/>'
    round_bar = changed(tmp_path / "round", (shape, '<cylinder radius="0.01" length="0.2"/>'))
    config = GraspConfig(turns=(40.0, -40.0), tilts=(0.0,))
    counts = []
    for scene in (square, round_bar):
        model = scene.object("cabinet").model
        handle = find_handle(model, "hinge", 1.0)
        counts.append(len(grasps_of(robot, model, "hinge", 1.0, handle, config).code))
    assert counts[0] == 0
    assert counts[1] > 0


def test_the_deepest_grasp_of_each_line_is_kept(robot: Robot, tmp_path: Path) -> None:
    motion = opened(changed(tmp_path), robot)
    grasps = motion.grasps
    for rows in (np.ones(len(grasps), bool), np.arange(len(grasps)) % 3 > 0):
        kept = grasps.deepest(rows)
        assert not (kept & ~rows).any()
        assert set(grasps.line[kept]) == set(grasps.line[rows])
        deep = motion.Ts_world_tool[:, motion.grasp_step]
        into = np.einsum("gi,gi->g", deep[:, :3, :3] @ robot.approach_axis, deep[:, :3, 3])
        for line in grasps.line[kept]:
            same = rows & (grasps.line == line)
            assert into[same].max() == pytest.approx(into[kept & same][0], abs=1e-9)


def test_the_next_handle_is_grasped_where_the_best_is_obstructed(
    robot: Robot, tmp_path: Path
) -> None:
    wall = (
        ', {"name": "wall", "category": "wall", "box": [0.1, 0.22, 1.1],'
        ' "pose": {"xyz": [0.41, -0.36, 0.85], "wxyz": [1, 0, 0, 0]}}'
    )
    cabinet_room(tmp_path, extra=wall)
    long_bar = (
        '<link name="long_handle"><collision><geometry><box size="0.016 0.016 0.3"/></geometry>'
        '</collision></link><joint name="long" type="fixed"><parent link="door"/>'
        '<child link="long_handle"/><origin xyz="-0.1 -0.065 0"/></joint></robot>'
    )
    file = tmp_path / "cabinet.urdf"
    file.write_text(file.read_text().replace("</robot>", long_bar))
    scene = load_scene(tmp_path / "room.json")

    def held(to: float) -> str:
        task = make_task(scene, "open", "cabinet", to=to)
        ready = prepare(scene, robot, task, PipelineConfig(), clearance=0.0)
        assert ready.no_grasp == ""
        return ready.motion.handle.name

    assert held(0.6) == "long_handle"
    assert held(np.pi / 2) == "door_handle"


def test_handles_that_cannot_be_grasped_are_excluded_once(tmp_path: Path, fetch: Robot) -> None:
    """The edge of the door is too thick for any gripper, so that a push follows the bar."""
    text = (Path(__file__).parents[3] / "examples" / "cupboard.urdf").read_text()
    path = tmp_path / "cupboard.urdf"
    thick = text.replace('size="0.02 0.59 0.88"', 'size="0.12 0.59 0.88"')
    path.write_text(thick.replace('xyz="-0.05 0.53 0.25"', 'xyz="-0.12 0.53 0.25"'))
    item = SceneObject.from_urdf("cupboard", path, (0.0, 0.0, 0.0), joints={"hinge": 1.2})
    scene = Scene("room", (item,))
    motion = task_motion(scene, fetch, make_task(scene, "close", "cupboard"), MotionConfig())
    excluded: list[Handle] = []
    other: TaskMotion | None = motion
    for _ in range(10):
        if other is None:
            return
        excluded += other.grasps.handles
        other = with_other_handle(motion, scene, fetch, MotionConfig(), excluded)
    raise AssertionError("the same handles are excluded repeatedly")
