"""Rooms in MJCF: parts move as in MuJoCo, and dropped elements are counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benchmarks.mjcf_support import Truth, compare
from numpy.testing import assert_allclose
from tests.commands import error_of, json_of, output_of

from momapos.core.errors import FileFormatError, MomaposError, SceneError, UnknownNameError
from momapos.model.scene.formats import mjcf_files
from momapos.model.scene.formats.imported_room import ImportedRoom
from momapos.model.scene.formats.importing import write_room
from momapos.model.scene.formats.mjcf import read_room
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene

WEDGE = "v 0 0 0\nv 0.3 0 0\nv 0 0.2 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
ROOM = """<mujoco model="flat">
  <compiler angle="degree" eulerseq="xyz" meshdir="models"/>
  <include file="parts/defaults.xml"/>
  <asset>
    <texture name="wood" type="2d" builtin="flat" width="8" height="8"/>
    <material name="wood" texture="wood"/>
    <mesh file="wedge.obj" scale="2 1 1" refpos="0.1 0 0"/>
  </asset>
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="floor" type="plane" size="5 5 0.1" pos="0 0 -0.5"/>
    <geom name="wall" type="box" size="2 0.05 1.25" pos="0 2 0.75" material="wood"/>
    <geom name="mat" type="box" size="1 1 0.01" pos="0 0 -0.51"/>
    <geom name="picture" type="box" size="0.3 0.01 0.2" pos="0 1.9 1" contype="0" conaffinity="0"/>
    <body name="row" pos="-1 1.6 0" euler="0 0 180">
      <body name="cabinet" pos="0.5 0 0">
        <geom type="box" size="0.3 0.25 0.4" pos="0 -0.3 -0.1"/>
        <body name="door" pos="0 0 0.1" euler="0 0 5" childclass="front">
          <joint name="door_hinge" pos="-0.28 0.02 0" axis="0 0 1" range="0 95" ref="20"
            damping="2"/>
          <geom class="front" pos="0 0.02 0" size="0.28 0.01 0.3"/>
          <geom name="door_handle" type="capsule" fromto="0.2 0.06 -0.1 0.2 0.06 0.1" size="0.01"/>
          <site name="handle" pos="0.2 0.06 0"/>
        </body>
      </body>
      <body name="drawers" pos="-0.3 0 0">
        <geom type="box" size="0.3 0.25 0.4" pos="0 -0.3 -0.1"/>
        <body name="drawer" pos="0 0.01 0.1">
          <joint name="drawer_slide" type="slide" axis="0 1 0" range="-0.1 0.4" frictionloss="3"/>
          <geom type="box" size="0.28 0.01 0.1"/>
          <geom type="mesh" mesh="wedge" pos="0 0.02 0" euler="20 30 40"/>
          <geom type="ellipsoid" size="0.05 0.03 0.02" pos="0 0.03 0"/>
          <geom type="cylinder" size="0.01 0.05" pos="0.1 0.03 0" euler="90 0 0"/>
          <body name="knob" pos="0 0.05 0">
            <joint name="knob_hinge" axis="0 1 0" range="-90 90"/>
            <joint name="knob_push" type="slide" axis="0 1 0" range="-0.01 0.01"/>
            <geom type="sphere" size="0.02"/>
          </body>
        </body>
      </body>
    </body>
    <body name="swing" pos="1.5 1.5 0">
      <joint name="swing_hinge" axis="0 0 1" range="10 90"/>
      <geom type="box" size="0.3 0.02 0.4"/>
      <body name="loose" pos="0.3 0 0"><joint name="ball" type="ball"/><geom size="0.02"/></body>
    </body>
    <body name="cup" pos="0 1 0.4"><freejoint/><geom type="cylinder" size="0.04 0.05"/></body>
    <body name="arm" pos="1 -1 0">
      <joint name="shoulder" axis="0 0 1"/><geom type="capsule" size="0.05 0.3"/>
    </body>
  </worldbody>
  <equality>
    <joint joint1="knob_push" joint2="knob_hinge" polycoef="0.001 0.004 0 0 0"/>
    <joint joint1="swing_hinge" polycoef="0.2 0 0 0 0" active="false"/>
    <weld body1="cup" body2="arm" active="false"/>
  </equality>
  <tendon><fixed name="pull"><joint joint="shoulder" coef="1"/></fixed></tendon>
  <actuator><motor joint="shoulder"/><motor tendon="pull"/></actuator>
  <sensor><jointpos joint="shoulder"/></sensor>
  <keyframe><key qpos=""/></keyframe>
</mujoco>
"""
DEFAULTS = """<mujocoinclude><include file="more.xml"/></mujocoinclude>"""
MORE = """<mujocoinclude>
  <default><default class="front"><geom type="box" rgba="1 0 0 1"/></default></default>
</mujocoinclude>"""
CABINET = """<mujoco><worldbody><body name="cabinet"><geom type="box" size="0.3 0.3 0.4"/>
{}</body></worldbody></mujoco>"""


def write(folder: Path, text: str = ROOM) -> Path:
    """Write the room and the files that it names."""
    for name, content in (
        ("room.xml", text.replace('<keyframe><key qpos=""/></keyframe>', "")),
        ("models/wedge.obj", WEDGE),
        ("parts/defaults.xml", DEFAULTS),
        ("parts/more.xml", MORE),
    ):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(content)
    return folder / "room.xml"


def read(folder: Path, text: str = ROOM) -> tuple[ImportedRoom, Scene]:
    path = write(folder, text)
    room = read_room(path, folder)
    return room, write_room(room, path, folder / "out.json")


def test_every_joint_moves_its_part_as_in_mujoco(tmp_path: Path) -> None:
    _, scene = read(tmp_path)
    found = {one.name: one for one in compare(Truth(tmp_path / "room.xml"), scene)}
    assert {name: one.ours for name, one in found.items()} == {
        "door_hinge": "cabinet/door_hinge",
        "drawer_slide": "drawers/drawer_slide",
        "knob_hinge": "drawers/knob_hinge",
        "swing_hinge": "swing/swing_hinge",
    }
    for one in found.values():
        ball = 1e-3 if one.name == "drawer_slide" else 0.0  # its ellipsoid is a mesh around it
        assert one.error < 1e-6 + ball, one
    assert found["door_hinge"].limits < 1e-9


def test_dropped_elements_are_counted(tmp_path: Path) -> None:
    room, scene = read(tmp_path)
    report = room.final_report()
    assert {item.name for item in scene.objects} == {
        "wall", "cabinet", "drawers", "swing", "cup", "arm",
    }  # fmt: skip
    assert report.kept["hinges"] == 4
    assert report.kept["slides"] == 2
    assert report.kept["mimic joints"] == 1
    assert report.approximated == {
        "ellipsoids as meshes": 1,
        "ball joints as fixed": 1,
        "joint values outside their limits, clipped": 1,
    }
    assert {key: count for key, count in report.dropped.items() if count} == {
        "floors": 2, "objects without collision shapes": 1, "sites": 1, "lights": 1, "textures": 1,
        "materials": 1, "actuators": 2, "tendons": 1, "sensors": 1,
        "equality constraints (joint)": 1, "equality constraints (weld)": 1,
    }  # fmt: skip
    assert report.notes == [
        "moved by 0.5 m along z, so that the floor is at 0",
        "actuators drive 1 joints of 'arm'; if it is a robot, exclude it: without arm",
    ]


def test_joints_keep_their_values_and_resistance(tmp_path: Path) -> None:
    _, scene = read(tmp_path)
    assert scene.object("cabinet").joints == {"door_hinge": pytest.approx(np.deg2rad(20))}
    assert scene.object("swing").values() == {"swing_hinge": pytest.approx(np.deg2rad(10))}
    texts = {p.stem: p.read_text() for p in (tmp_path / "out_files").glob("*.urdf")}
    assert '<dynamics damping="2.0" friction="0.0" />' in texts["cabinet"]
    assert '<dynamics damping="0.0" friction="3.0" />' in texts["drawers"]


def test_model_prefixes_of_part_names_are_removed(tmp_path: Path) -> None:
    text = CABINET.format(
        '<body name="cabinet/door"><joint name="cabinet/hinge" axis="0 0 1" range="0 1"/>'
        '<geom name="cabinet/door/door_handle#3" size="0.1"/></body>'
    )
    _, scene = read(tmp_path, text.replace('"cabinet"', '"cabinet/"'))
    (item,) = scene.objects
    assert (item.name, list(item.model.joints)) == ("cabinet", ["hinge"])
    assert item.model.urdf.links["door"].collisions[0].name == "door_handle"


def test_the_command_reports_the_conversion(tmp_path: Path) -> None:
    path, out = write(tmp_path), tmp_path / "out.json"
    printed = json_of("scene", "convert", str(path), str(out), "--without", "arm", "--json")
    assert printed["report"]["dropped"]["tendons"] == 1
    assert printed["report"]["kept"]["objects"] == len(load_scene(out).objects) == 5
    assert "2 floors, 1 objects without collision shapes" in output_of(
        "scene", "convert", str(path), str(tmp_path / "two.json")
    )
    assert "is in the format MJCF; convert it first" in error_of("scene", "show", str(path))


def test_a_missing_object_cannot_be_left_out(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean cabinet"):
        read(tmp_path)[0].without(["cabinets"])


HOSTILE = {
    "an entity": ('<!DOCTYPE m [<!ENTITY a "b">]>' + CABINET.format("&a;"), "DTDs and entities"),
    "damaged": (CABINET[:60], "not well-formed XML"),
    "a path out of the root": (CABINET.format('<include file="../../secret.xml"/>'), "leaves"),
    "an absolute path": (CABINET.format('<include file="/etc/passwd"/>'), "leaves"),
    "no file": (CABINET.format('<include file="gone.xml"/>'), "does not exist below"),
    "itself": (CABINET.format('<include file="room.xml"/>'), "is included twice"),
    "a mesh outside": (
        '<mujoco><asset><mesh name="m" file="../../m.stl"/></asset></mujoco>',
        "leaves",
    ),
    "a mesh of another kind": (
        '<mujoco><asset><mesh name="m" file="models/m.xml"/></asset></mujoco>',
        "must be one of .obj, .stl, .msh",
    ),
    "a link out of the root": (
        '<mujoco><asset><mesh name="m" file="linked.stl"/></asset></mujoco>',
        "leaves",
    ),
    "a NUL": (CABINET.format(f'<include file="{"x" * 5000}"/>'), "is not a valid path"),
    "a bomb of copies": (
        CABINET.format('<replicate count="999"><replicate count="999"><geom size="1"/></replicate>'
                       "</replicate>"),
        "more than 200000 elements",
    ),
    "a count that is none": (CABINET.format('<replicate count="-1"/>'), "must be a number from 1"),
    "deep": (CABINET.format("<frame>" * 200 + "</frame>" * 200), "nested deeper than 100"),
    "what MuJoCo refuses": (CABINET.format('<geom type="box" size="-1 1 1"/>'), "MuJoCo rejects"),
    "another model": (CABINET.format('<attach model="m" body="b" prefix="p"/>'), "attaches"),
    "nothing that is finite": (CABINET.format('<geom size="1" pos="nan 0 0"/>'), "must be finite"),
    "vast": (CABINET.format('<geom size="400"/>'), "makes no valid scene: out.json: the room"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_bad_rooms_are_refused_in_one_line_and_leave_nothing(tmp_path: Path, case: str) -> None:
    text, message = HOSTILE[case]
    inside = tmp_path / "inside"
    inside.mkdir()
    (tmp_path / "secret.stl").write_text("solid")
    (inside / "linked.stl").symlink_to(tmp_path / "secret.stl")
    with pytest.raises(MomaposError, match=message) as caught:
        read(inside, text)
    assert "\n" not in str(caught.value)
    assert not list(inside.glob("*out*"))


def test_meshes_that_are_too_large_are_refused_before_mujoco_reads_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path)
    monkeypatch.setattr(mjcf_files, "MAX_ALL_MESH_BYTES", 10)
    with pytest.raises(FileFormatError, match="its meshes have more than"):
        read_room(path, tmp_path)
    monkeypatch.setattr(mjcf_files, "MAX_MESH_BYTES", 10)
    with pytest.raises(FileFormatError, match="larger than the limit"):
        read_room(path, tmp_path)


def test_an_existing_folder_is_not_overwritten(tmp_path: Path) -> None:
    _, scene = read(tmp_path)
    with pytest.raises(SceneError, match="exists already"):
        read(tmp_path)
    again = load_scene(tmp_path / "out.json")
    assert_allclose(again.object("cup").bounds, scene.object("cup").bounds)


@pytest.mark.parametrize(
    ("inside", "mass"),
    [
        ('<geom name="g" type="box" size="0.1 0.2 0.3"/>', 0.0),
        ('<geom type="box" size="0.1 0.2 0.3" mass="4"/>', 4.0),
        ('<geom type="box" size="0.1 0.2 0.3" density="100"/>', 4.8),
        ('<geom class="light" type="box" size="0.1 0.2 0.3"/>', 2.4),
        ('<inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/><geom size="0.1"/>', 3.0),
        ('<geom type="box" size="0.1 0.2 0.3"/><geom size="0.1" mass="0" contype="0"/>', 0.0),
    ],
)
def test_bodies_have_the_mass_that_mujoco_gives_them_if_the_file_states_one(
    tmp_path: Path, inside: str, mass: float
) -> None:
    part = (
        f'<body name="lid" pos="0 0 1"><joint name="h" pos="0.5 0 0" range="0 90"/>{inside}</body>'
    )
    light = '<default><default class="light"><geom density="50"/></default></default>'
    text = CABINET.format(part).replace("<mujoco>", f"<mujoco>{light}")
    _, scene = read(tmp_path, text)
    link = scene.object("cabinet").model.urdf.links["lid"]
    assert link.mass == pytest.approx(mass)
    if mass:
        assert_allclose(link.center, (-0.5, 0, 0), atol=1e-9)  # from the joint's anchor


def test_springs_of_joints_are_counted_as_dropped(tmp_path: Path) -> None:
    part = '<body><joint range="0 90" stiffness="5"/><geom type="box" size="0.1 0.2 0.3"/></body>'
    room, _ = read(tmp_path, CABINET.format(part))
    assert room.final_report().dropped["springs of joints"] == 1
