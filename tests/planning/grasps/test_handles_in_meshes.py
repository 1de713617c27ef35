"""Test handles that are part of their panel's mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tests.meshes as given
from tests.rooms import cabinet_room

from momapos.model.records.plans import FAMILIES, Family
from momapos.model.robots.hand_openings import opened_to
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf
from momapos.planning.grasps.config import GraspConfig, MotionConfig
from momapos.planning.grasps.hand_boxes import hand_of
from momapos.planning.grasps.handle_shapes import CarriedPart, part_elements
from momapos.planning.grasps.handles import (
    HandleKind,
    HandleSource,
    find_handle,
    find_handles,
    handles_in_turn,
)
from momapos.planning.grasps.part_grasps import elements_near_handle, grasps_of
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task

CONFIG = GraspConfig()


def part(
    folder: Path, boxes: tuple[given.Box, ...], *, slides: bool, name: str = ""
) -> Articulated:
    """Return a part of one mesh: a drawer that opens toward -y, or a door that turns about z."""
    given.write_obj(folder / "part.obj", given.triangles_of(boxes))
    kind, axis = ("prismatic", "0 -1 0") if slides else ("revolute", "0 0 -1")
    (folder / "part.urdf").write_text(
        f'<robot name="one"><link name="body"/><link name="part"><collision name="{name}">'
        '<geometry><mesh filename="part.obj"/></geometry></collision></link>'
        f'<joint name="j" type="{kind}"><parent link="body"/><child link="part"/>'
        f'<axis xyz="{axis}"/><limit lower="0" upper="0.4" effort="1" velocity="1"/>'
        "</joint></robot>"
    )
    return Articulated(read_urdf(folder / "part.urdf"))


def one_mesh(folder: Path) -> Scene:
    """Return the cabinet scene with door and handle as one mesh."""
    cabinet_room(folder)
    file, x = folder / "cabinet.urdf", -1.0
    text = file.read_text()
    mirrored = tuple(
        ((x * b[0], a[1], a[2]), (x * a[0], b[1], b[2])) for a, b in given.DOOR_WITH_BOW
    )
    given.write_obj(folder / "door.obj", given.triangles_of(mirrored))
    start, end = text.index('<link name="door">'), text.index('<joint name="hinge"')
    door = '<link name="door"><collision><geometry><mesh filename="door.obj"/></geometry>'
    text = text[:start] + door + "</collision></link>\n" + text[end:]
    grip = text.index('<joint name="grip"')
    file.write_text(text[:grip] + "</robot>")
    return load_scene(folder / "room.json")


def test_the_bow_handle_of_a_door_of_one_mesh_is_a_bar(tmp_path: Path) -> None:
    model = part(tmp_path, given.DOOR_WITH_BOW, slides=False)
    assert len(part_elements(CarriedPart.of(model, "j"))) == 1
    bar, *others = find_handles(model, "j", 1.0)
    assert (bar.found, bar.kind) == (HandleSource.SHAPE, HandleKind.BAR)
    np.testing.assert_allclose(bar.grip, np.mean(given.BAR, axis=0), atol=1e-3)
    assert bar.half_length == pytest.approx(0.1, abs=1e-3)
    assert bar.thickness == pytest.approx(0.016, abs=1e-3)
    np.testing.assert_allclose(bar.out, [0, -1, 0], atol=1e-6)
    assert all(h.edge for h in others)


def test_a_named_bow_handle_of_one_mesh_is_also_found_in_pieces(tmp_path: Path) -> None:
    model = part(tmp_path, (*given.BOW, given.PANEL), slides=False, name="handle")
    kinds = [(h.found, h.in_pieces) for h in handles_in_turn(model, "j", 1.0)]
    assert kinds[:2] == [(HandleSource.NAME, False), (HandleSource.SHAPE, True)]
    assert kinds[-1] == (HandleSource.EDGE, False)


def test_fingers_reach_behind_a_bow_handle_and_stay_outside_the_mesh(
    robot: Robot, tmp_path: Path
) -> None:
    model = part(tmp_path, given.DOOR_WITH_BOW, slides=False)
    bar = find_handle(model, "j", 1.0)
    found = grasps_of(robot, model, "j", 1.0, bar, CONFIG)
    assert len(found.code) > 20
    hand, surface = hand_of(robot), given.triangles_of(given.DOOR_WITH_BOW)
    points = given.points_on(surface, 40, np.random.default_rng(0))
    behind = 0
    for T, width in zip(found.Ts_part_tool[::5], found.width[::5], strict=True):
        for travel in (0.0, (robot.opening - width) / 2):
            center = hand.boxes.center - (hand.side * travel)[:, None] * hand.closing
            local = (points - T[:3, 3]) @ T[:3, :3]
            away = np.einsum("nbi,bij->nbj", local[:, None] - center, hand.boxes.rotation)
            deep = (hand.boxes.half - np.abs(away)).min(-1)
            assert deep.max() < 1e-3
        tips = hand.tip * (T[:3, :3] @ robot.approach_axis) + T[:3, 3]
        behind += tips[1] > given.BAR[1][1]
    assert behind > 0


def test_the_hull_of_the_mesh_fills_the_space_that_the_hand_uses(
    robot: Robot, tmp_path: Path
) -> None:
    model = part(tmp_path, given.DOOR_WITH_BOW, slides=False)
    bar = find_handle(model, "j", 1.0)
    in_pieces = grasps_of(robot, model, "j", 1.0, bar, CONFIG)
    hulls = replace(bar, in_pieces=False, elements=part_elements(CarriedPart.of(model, "j")))
    in_hulls = grasps_of(robot, model, "j", 1.0, hulls, CONFIG)
    assert len(in_pieces.code) > 0
    assert len(in_hulls.code) == 0
    assert in_hulls.reason


BOWS = {"straight": given.triangles_of(given.BOW), "round": given.arch() + np.array([0.3, 0, 0])}


def panel_with(folder: Path, handle: np.ndarray, name: str = "") -> Articulated:
    """Return a drawer's front that is a box, and its handle, which is a mesh in the same link."""
    given.write_obj(folder / "bow.obj", handle)
    (folder / "part.urdf").write_text(
        '<robot name="two"><link name="body"/><link name="part"><collision>'
        '<origin xyz="0.28 -0.01 0"/><geometry><box size="0.56 0.02 0.6"/></geometry></collision>'
        f'<collision name="{name}"><geometry><mesh filename="bow.obj"/></geometry></collision>'
        '</link><joint name="j" type="prismatic"><parent link="body"/><child link="part"/>'
        '<axis xyz="0 -1 0"/><limit lower="0" upper="0.4" effort="1" velocity="1"/></joint></robot>'
    )
    return Articulated(read_urdf(folder / "part.urdf"))


@pytest.mark.parametrize("name", ["", "handle"])
@pytest.mark.parametrize("shape", BOWS)
def test_a_bow_that_is_a_mesh_of_its_own_is_a_bar(tmp_path: Path, shape: str, name: str) -> None:
    model = panel_with(tmp_path, BOWS[shape], name)
    bow, *others = handles_in_turn(model, "j", 1.0)
    assert bow.kind is HandleKind.BAR
    assert bow.found is (HandleSource.NAME if name else HandleSource.SHAPE)
    assert bow.depth < 0.02, "the bar alone"
    assert all(h.edge for h in others), "its pieces are no further handle"
    elements, held = elements_near_handle(model, "j", bow)
    assert {e.index for e, mine in zip(elements, held, strict=True) if mine} == {1}
    assert sum(e.index == 1 for e in elements) == held.sum() > 1, "pieces instead of the hull"


@pytest.mark.parametrize("shape", BOWS)
def test_a_finger_goes_behind_a_bow_that_is_a_mesh_of_its_own(
    tmp_path: Path, shape: str, husky: Robot
) -> None:
    model = panel_with(tmp_path, BOWS[shape])
    robot = opened_to(husky, 0.032)
    (bow, *_) = handles_in_turn(model, "j", 1.0)
    grasps = grasps_of(robot, model, "j", 1.0, bow, CONFIG)
    assert not grasps.reason
    hooks = grasps.code == FAMILIES.index(Family.HOOK)
    assert hooks.any()
    hand = hand_of(robot)
    for T in grasps.Ts_part_tool[hooks]:
        closing = T[:3, :3] @ hand.closing
        fingers = [hand.boxes.center[hand.side == s] @ T[:3, :3].T + T[:3, 3] for s in (1, -1)]
        behind = max(fingers, key=lambda points: points[:, 1].max())
        assert behind[:, 1].max() > bow.grip[1], "between the bar and the front"
        assert abs(closing[1]) > 0.8


def test_a_solid_handle_that_is_a_mesh_stays_a_lip(tmp_path: Path) -> None:
    block = given.triangles_of((((0.2, -0.05, -0.01), (0.4, -0.02, 0.01)),))
    lip, *_ = handles_in_turn(panel_with(tmp_path, block), "j", 1.0)
    assert lip.kind is HandleKind.LIP
    assert len(lip.elements) == 1


def test_a_profile_is_a_lip_and_the_rim_of_a_pocket_a_recessed_pull(tmp_path: Path) -> None:
    lip = part(tmp_path, given.FRONT_WITH_LIP, slides=True)
    assert find_handle(lip, "j", 1.0).kind is HandleKind.LIP
    (tmp_path / "pocket").mkdir()
    pocket = part(tmp_path / "pocket", given.FRONT_WITH_POCKET, slides=True)
    found = find_handle(pocket, "j", 1.0)
    assert found.kind is HandleKind.RECESS
    np.testing.assert_allclose(found.center[[0, 2]], [0.0, 0.09], atol=5e-3)
    assert str(found) == "recessed pull 'part', by its shape"


def test_a_recessed_pull_is_grasped_with_a_finger_in_the_pocket(
    robot: Robot, tmp_path: Path
) -> None:
    model = part(tmp_path, given.FRONT_WITH_POCKET, slides=True)
    found = [grasps_of(robot, model, "j", 1.0, h, CONFIG) for h in find_handles(model, "j", 1.0)]
    T = np.concatenate([g.Ts_part_tool for g in found[:-2]])
    tips = T[:, :3, 3] + hand_of(robot).tip * (T[:, :3, :3] @ robot.approach_axis)
    low, high = np.array(given.POCKET)
    assert ((tips[:, 1] > low[1]) & (np.abs(tips[:, 0]) < high[0])).any()


def test_a_door_is_not_pulled_at_a_strip_near_its_hinge(tmp_path: Path) -> None:
    """Two slots leave a strip at the hinge and one at the free edge; only the latter is grasped."""
    plates = (((0.0, 0.04), 0.3), ((0.1, 0.46), 0.3), ((0.52, 0.56), 0.3))
    front = tuple(((x[0], -0.03, -z), (x[1], -0.01, z)) for x, z in plates)
    back = ((0.0, -0.01, -0.3), (0.56, 0.0, 0.3))
    model = part(tmp_path, (back, *front), slides=False)
    found = [h for h in handles_in_turn(model, "j", 1.0) if h.kind is HandleKind.RECESS]
    assert found
    assert all(h.center[0] > 0.5 for h in found)


def test_a_solid_front_has_no_handle(tmp_path: Path) -> None:
    model = part(tmp_path, (given.PANEL,), slides=False)
    assert all(h.edge for h in handles_in_turn(model, "j", 1.0))


def test_a_door_of_one_mesh_is_grasped_at_the_same_place(robot: Robot, tmp_path: Path) -> None:
    scene = one_mesh(tmp_path)
    motion = task_motion(scene, robot, make_task(scene, "open", "cabinet"), MotionConfig())
    assert not motion.refusal
    assert str(motion.handle) == "bar 'door', by its shape"
    many = cabinet_room(tmp_path / "many")
    known = task_motion(many, robot, make_task(many, "open", "cabinet"), MotionConfig())
    off = motion.handle.grip - known.handle.grip
    assert np.linalg.norm(off - off @ motion.handle.out * motion.handle.out) < 0.01
