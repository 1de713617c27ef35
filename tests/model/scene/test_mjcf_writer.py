"""Scenes as MJCF: MuJoCo reads them, and they round-trip."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from benchmarks.mjcf_support import Truth, compare
from numpy.testing import assert_allclose
from tests.commands import error_of
from tests.cupboards import DOOR, HINGE, carcass, furniture_room

from momapos.apps.cli.main import main
from momapos.core.errors import MomaposError
from momapos.model.robots.robot import Robot
from momapos.model.scene.formats.importing import write_mjcf, write_room
from momapos.model.scene.formats.mjcf import read_room
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, object_members
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement

MESHED = """<robot name="chest">
  <link name="box"><collision name="a&quot;b"><geometry><box size="1 0.5 0.4"/></geometry></collision></link>
  <link name="lid"><collision name="lid_handle"><origin xyz="0 -0.2 0"/>
    <geometry><mesh filename="wedge.obj" scale="1 2 1"/></geometry></collision>
    <collision><geometry><mesh filename="flat.obj"/></geometry></collision></link>
  <link name="stay"><inertial><origin xyz="0 0 0.3"/><mass value="0.4"/></inertial><visual><geometry><sphere radius="0.02"/></geometry></visual></link>
  <joint name="lid_hinge" type="revolute"><parent link="box"/><child link="lid"/>
    <origin xyz="0 0.25 0.2" rpy="0.1 0.2 0.3"/><axis xyz="1 0 0"/><limit lower="-1.5" upper="0"/></joint>
  <joint name="stay_hinge" type="revolute"><parent link="box"/><child link="stay"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1"/><mimic joint="lid_hinge" multiplier="0.5" offset="0.1"/></joint>
</robot>"""  # noqa: E501
WEDGE = "v 0 0 0\nv 0.3 0 0\nv 0 0.2 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
FLAT = "v 0 0 0\nv 0.3 0 0\nv 0.3 0.2 0\nv 0 0.2 0\nf 1 2 3 4\n"
ENTRY = {
    "name": "chest", "category": "trunk", "pose": {"xyz": [1, 2, 0.2], "wxyz": [0.6, 0, 0, 0.8]},
    "urdf": "chest.urdf", "joints": {"lid_hinge": -0.4},
    "confidence": {"object": 0.5, "label": 0.25},
}  # fmt: skip


def round_trip(scene: Scene, folder: Path) -> Scene:
    path = folder / "room.xml"
    write_mjcf(scene, path)
    return write_room(read_room(path, folder), path, folder / "again.json")


def chest(folder: Path) -> Scene:
    for name, text in (("chest.urdf", MESHED), ("wedge.obj", WEDGE), ("flat.obj", FLAT)):
        (folder / name).write_text(text)
    data = {
        "format": "momapos-scene", "version": 1, "name": "attic", "objects": [ENTRY],
        "floor": [[-3, -3], [3, -3], [3, 3]], "start": {"x": 0.0, "y": -1.0, "yaw": 1.5},
        "areas": {"aisle": [[-1, -1], [1, -1], [1, 0]]},
    }  # fmt: skip
    (folder / "attic.json").write_text(json.dumps(data))
    return load_scene(folder / "attic.json")


def test_meshes_couplings_and_custom_data_round_trip(tmp_path: Path) -> None:
    scene = chest(tmp_path)
    again = round_trip(scene, tmp_path)
    (old,), (new,) = scene.objects, again.objects
    assert object_members(new) == object_members(old)
    assert again.areas == scene.areas
    assert_allclose(again.floor_polygon, scene.floor_polygon)
    assert_allclose(again.start, scene.start)
    assert new.values() == pytest.approx(old.values(), abs=1e-12)
    for value in (-1.5, -0.7, 0.0):
        poses = new.link_poses({"lid_hinge": value})
        for link, T in old.link_poses({"lid_hinge": value}).items():
            assert_allclose(poses[link], T, atol=1e-9)
    for name, link in old.model.urdf.links.items():
        copy = new.model.urdf.links[name]
        assert_allclose((copy.mass, *copy.center), (link.mass, *link.center), atol=1e-12)
    for link, hulls in old.model.hulls.items():
        for a, b in zip(hulls, new.model.hulls[link], strict=True):
            assert_allclose(np.sort(a.vertices, 0), np.sort(b.vertices, 0), atol=2e-6)
            assert a.name == b.name


@pytest.mark.parametrize("name", ["kitchen_small", "kitchen_island"])
def test_every_part_of_a_kitchen_moves_alike_in_mujoco(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    write_mjcf(scene, tmp_path / "room.xml")
    found = list(compare(Truth(tmp_path / "room.xml"), scene))
    assert len(found) == sum(len(item.model.joints) for item in scene.objects)
    assert max(max(one.error, one.limits) for one in found) < 1e-9


def test_furniture_stands_still_in_mujoco(tmp_path: Path, kitchen: Scene) -> None:
    write_mjcf(kitchen, tmp_path / "room.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "room.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 50)
    assert data.ncon == 0
    assert_allclose(data.qpos, model.qpos0, atol=1e-2)


@pytest.mark.parametrize("target", [("fridge", "door_hinge"), ("microwave", "door_hinge")])
def test_plans_are_the_same_after_a_round_trip(
    target: tuple[str, str], tmp_path: Path, segway: Robot, kitchen: Scene
) -> None:
    plans = [
        plan_base_placement(room, segway, make_task(room, "open", *target)).plan
        for room in (kitchen, round_trip(kitchen, tmp_path))
    ]
    assert plans[0].status == plans[1].status
    if plans[0].base_pose is not None:
        assert plans[1].base_pose == pytest.approx(plans[0].base_pose, abs=1e-6)
    assert plans[0].candidates == plans[1].candidates


def test_friction_and_damping_of_joints_are_the_same_after_a_round_trip(tmp_path: Path) -> None:
    room = furniture_room(
        tmp_path,
        [
            carcass(),
            DOOR,
            HINGE.replace("</joint>", '<dynamics friction="3" damping="2"/></joint>'),
        ],
    )
    (item,) = round_trip(room, tmp_path).objects
    (joint,) = item.model.joints.values()
    assert (joint.friction, joint.damping) == (3.0, 2.0)


def test_the_command_writes_mjcf_and_refuses_unknown_formats(tmp_path: Path) -> None:
    out = tmp_path / "room.xml"
    assert main(["scene", "convert", "kitchen_small", str(out)]) == 0
    assert mujoco.MjModel.from_xml_path(str(out)).njnt > 5
    assert "scenes are written as .json (momapos), .xml (MJCF)" in error_of(
        "scene", "convert", "kitchen_small", str(tmp_path / "room.usdz")
    )


def test_an_untrusted_custom_text_is_checked(tmp_path: Path) -> None:
    write_mjcf(chest(tmp_path), tmp_path / "room.xml")
    text = (tmp_path / "room.xml").read_text()
    for was, now, message in (
        ('{"floor"', "[", "is invalid"),
        ('"objects": {', '"objects": {"a": 1, ', "is invalid"),
        ("[[-3.0, -3.0]", "[[1e99, -3.0]", "floor"),
        ('"trunk"', "[]", "category must be text"),
    ):
        was, now = (words.replace('"', "&quot;") for words in (was, now))
        (tmp_path / "room.xml").write_text(text.replace(was, now, 1))
        with pytest.raises(MomaposError, match=message):
            write_room(read_room(tmp_path / "room.xml", tmp_path), tmp_path, tmp_path / "b.json")
