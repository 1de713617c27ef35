"""Rooms in SDF: joints move as in the equivalent URDF, and dropped elements are counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.commands import output_of
from tests.model.scene.cabinet import assert_moves_alike, assert_refused, expected

from momapos.model.scene.formats.importing import write_room
from momapos.model.scene.formats.kinds import kind_of_file
from momapos.model.scene.formats.sdf import read_room
from momapos.model.scene.joint_resistance import known_resistance
from momapos.model.scene.resistance_config import ResistanceConfig
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene

# The same cabinet 0.4 m up: its link frames differ from the joint frames, and poses are relative to
# several frames.
ROOM = """<?xml version="1.0"?>
<sdf version="1.9"><world name="room">
  <physics type="ode"/><light name="sun" type="directional"/><plugin name="p" filename="p.so"/>
  <model name="ground"><static>true</static><link name="l"><collision name="c"><geometry>
    <plane><normal>0 0 1</normal><size>9 9</size></plane></geometry></collision></link></model>
  <model name="cabinet"><pose>1 2 0.4 0 0 0.5</pose>
    <frame name="front"><pose>0.21 0 0 0 0 0</pose></frame>
    <link name="body"><collision name="b"><geometry><box><size>0.4 0.6 0.8</size></box></geometry></collision>
      <sensor name="s" type="camera"/></link>
    <link name="door"><pose relative_to="hinge">0 0.3 0 0 0 0</pose>
      <collision name="door_handle"><geometry><box><size>0.02 0.6 0.3</size></box></geometry></collision></link>
    <link name="drawer"><pose relative_to="front" degrees="true">0 0 -0.2 0 0 90</pose>
      <collision name="d"><pose>0 0 0 0 0 -1.5707963267948966</pose>
        <geometry><box><size>0.02 0.6 0.3</size></box></geometry></collision>
      <collision name="e"><pose relative_to="">0 -0.03 0 0 -1.5 0</pose>
        <geometry><cylinder><radius>0.01</radius><length>0.2</length></cylinder></geometry></collision>
      <visual name="v"><geometry><mesh><uri>gone.dae</uri></mesh></geometry></visual></link>
    <joint name="hinge" type="revolute"><pose relative_to="front">0 -0.3 0.2 0 0 0.3</pose>
      <parent>body</parent><child>door</child><axis><xyz>0 0.6 0.8</xyz>
      <limit><lower>-0.2</lower><upper>1.5</upper></limit>
      <dynamics><damping>2</damping><friction>1</friction></dynamics></axis></joint>
    <joint name="slide" type="prismatic"><parent>body</parent><child>drawer</child>
      <axis><xyz expressed_in="__model__">1 0 0</xyz>
      <limit><lower>0</lower><upper>0.4</upper></limit></axis></joint>
  </model>
  <include><uri>model://cup</uri><pose>0 1 0.5 0 0 0</pose><name>my_cup</name></include>
  <model name="wall"><link name="l"><pose>0 3 1 1.5707963267948966 0 0</pose><collision name="c">
    <geometry><plane><size>4 2</size></plane></geometry></collision></link>
    <link name="ring"><pose>0 2.9 1 0 0 0</pose><collision name="c"><geometry><capsule><radius>0.05</radius>
    <length>0.3</length></capsule></geometry></collision></link>
    <joint name="spin" type="revolute"><parent>world</parent><child>ring</child><axis><xyz>0 0 1</xyz>
    <limit><lower>-1e16</lower><upper>1e16</upper></limit></axis></joint>
    <joint name="ball" type="ball"><parent>ring</parent><child>l</child></joint></model>
</world></sdf>"""  # noqa: E501
CUP = """<sdf version="1.6"><model name="cup"><pose>9 9 9 0 0 0</pose><link name="l">
  <collision name="c"><geometry><mesh><uri>model://cup/cup.obj</uri><scale>0.1 0.1 0.1</scale></mesh></geometry>
  </collision></link></model></sdf>"""  # noqa: E501
WEDGE = "v 0 0 0\nv 0.3 0 0\nv 0 0.2 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


def write(folder: Path, text: str = ROOM) -> Path:
    (folder / "cup").mkdir(exist_ok=True)
    (folder / "cup/model.sdf").write_text(CUP)
    (folder / "cup/cup.obj").write_text(WEDGE)
    (folder / "room.sdf").write_text(text)
    return folder / "room.sdf"


def read(folder: Path, text: str = ROOM) -> Scene:
    path = write(folder, text)
    return write_room(read_room(path, folder), path, folder / "out.json")


def test_joints_move_parts_as_in_the_urdf_of_the_same_cabinet(tmp_path: Path) -> None:
    truth = expected(
        tmp_path, (1, 2, 0.4), 0.5, bar=1.5, turn=0.3, axis="0 0.6 0.8", lower=-0.2, upper=1.5
    )
    found = read(tmp_path).object("cabinet")
    assert_moves_alike(found, truth, ((0.0, 0.0), (-0.2, 0.1), (1.5, 0.4)))


def test_included_models_are_at_the_pose_of_the_include(tmp_path: Path) -> None:
    cup = read(tmp_path).object("my_cup")
    assert_allclose(cup.bounds, [[0, 1, 0.5], [0.03, 1.02, 0.51]], atol=1e-6)


def mimic(leader: str, *values: str, axis: str = "") -> str:
    """Return a mimic element with multiplier, offset and reference."""
    keys = zip(("multiplier", "offset", "reference"), values, strict=False)
    texts = "".join(f"<{key}>{value}</{key}>" for key, value in keys if value)
    return f"<mimic joint='{leader}'{axis}>{texts}</mimic></axis>"


@pytest.mark.parametrize(
    ("values", "ratio", "offset"),
    [
        ((), 1.0, 0.0), (("-2",), -2.0, 0.0), (("0.5", "0.1"), 0.5, 0.1),
        (("0.5", "0.1", "0.4"), 0.5, -0.1), (("", "", "0.2"), 1.0, -0.2),
    ],
)  # fmt: skip
def test_a_mimic_joint_follows_multiplier_times_leader_beyond_reference_plus_offset(
    tmp_path: Path, values: tuple[str, ...], ratio: float, offset: float
) -> None:
    head, _, tail = ROOM.rpartition("<upper>0.4</upper></limit></axis>")
    text = head + "<upper>9</upper></limit>" + mimic("hinge", *values) + tail
    item = read(tmp_path, text.replace("<lower>0</lower>", "<lower>-9</lower>")).object("cabinet")
    for value in (-0.1, 0.0, 0.7):
        there = item.values({"hinge": value})
        assert there["slide"] == pytest.approx(ratio * value + offset)
    assert read_room(tmp_path / "room.sdf", tmp_path).final_report().kept["mimic joints"] == 1


def test_a_chain_of_mimic_joints_follows_the_first_leader(tmp_path: Path) -> None:
    extra = "".join(
        f'<link name="l{k}"/><joint name="j{k}" type="revolute"><parent>body</parent>'
        f"<child>l{k}</child><axis><xyz>0 0 1</xyz>{mimic(leader, *values)}</joint>"
        for k, (leader, values) in enumerate([("j1", ("2", "0.1")), ("hinge", ("-1", "0", "0.2"))])
    )
    text = ROOM.replace('<joint name="hinge"', f'{extra}<joint name="hinge"')
    item = read(tmp_path, text).object("cabinet")
    for value in (0.0, 0.5):
        there = item.values({"hinge": value})
        assert there["j1"] == pytest.approx(-(value - 0.2))
        assert there["j0"] == pytest.approx(2 * there["j1"] + 0.1)


def test_what_follows_a_joint_of_two_axes_is_dropped_and_counted(tmp_path: Path) -> None:
    two = (
        '<link name="u"/><joint name="two" type="universal"><parent>body</parent><child>u</child>'
        "<axis><xyz>0 0 1</xyz></axis><axis2><xyz>1 0 0</xyz></axis2></joint>"
    )
    text = ROOM.replace('<joint name="hinge"', f'{two}<joint name="hinge"')
    text = text.replace("</axis>", mimic("two", axis=" axis='axis2'"), 2)
    text = text.replace(mimic("two", axis=" axis='axis2'"), "</axis>", 1)
    path = write(tmp_path, text)
    report = read_room(path, tmp_path).final_report()
    assert report.dropped["mimic joints"] == 1
    assert report.kept["mimic joints"] == 0


def test_dropped_elements_are_counted(tmp_path: Path) -> None:
    path = write(tmp_path)
    report = read_room(path, tmp_path).final_report()
    assert {key: count for key, count in report.dropped.items() if count} == {
        "lights": 1, "plugins": 1, "sensors": 1, "visual meshes": 1, "floors": 1,
        "objects without collision shapes": 1,
    }  # fmt: skip
    assert {key: count for key, count in report.approximated.items() if count} == {
        "bounded planes as boxes": 1,
        "ball joints as fixed": 1,
    }
    scene = write_room(read_room(path, tmp_path), path, tmp_path / "out.json")
    wall = scene.object("wall")
    assert_allclose(np.ptp(wall.bounds, axis=0)[[0, 2]], [4, 2], atol=1e-6)
    assert wall.model.joint("spin").kind == "continuous"
    text = (tmp_path / "out_files/cabinet.urdf").read_text()
    assert '<dynamics damping="2.0" friction="1.0" />' in text


def test_older_files_can_define_axes_in_the_model_frame(tmp_path: Path) -> None:
    text = ROOM.replace('version="1.9"', 'version="1.6"').replace(
        '<xyz expressed_in="__model__">1 0 0</xyz>',
        "<xyz>1 0 0</xyz><use_parent_model_frame>1</use_parent_model_frame>",
    )
    slid = [
        read(folder, t).object("cabinet").link_poses({"slide": 0.3})["drawer"]
        for folder, t in ((tmp_path / "a", ROOM), (tmp_path / "b", text))
        if folder.mkdir() is None
    ]
    assert_allclose(slid[0], slid[1], atol=1e-12)


def test_the_command_converts_a_world(tmp_path: Path) -> None:
    path, out = write(tmp_path), tmp_path / "out.json"
    assert kind_of_file(path) == "SDF"
    assert "1 objects, as requested" in output_of(
        "scene", "convert", str(path), str(out), "--without", "wall"
    )
    assert {item.name for item in load_scene(out).objects} == {"cabinet", "my_cup"}


MODEL = '<sdf version="1.9"><model name="m"><link name="a">{}</link>{}</model></sdf>'
BOX = '<collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision>'
JOINT = '<joint name="j" type="revolute"><parent>{}</parent><child>{}</child>{}</joint>'
MESH = '<collision name="c"><geometry><mesh><uri>{}</uri></mesh></geometry></collision>'
BAD = {
    "damaged": (ROOM[:200], "not well-formed XML"),
    "an entity": ('<!DOCTYPE m [<!ENTITY a "b">]>' + MODEL.format("&a;", ""), "DTDs and entities"),
    "a mesh outside": (MODEL.format(MESH.format("../../m.stl"), ""), "leaves"),
    "a model outside": (
        '<sdf version="1.9"><world name="w"><include><uri>model://../x</uri></include></world></sdf>',
        "leaves",
    ),
    "a mesh that is not there": (MODEL.format(MESH.format("model://m/m.stl"), ""), "not exist"),
    "a mesh of another machine": (MODEL.format(MESH.format("https://x/m.stl"), ""), "only model://"),
    "itself": (
        '<sdf version="1.9"><world name="w"><include><uri>room.sdf</uri></include></world></sdf>',
        "includes itself",
    ),
    "models in a model": (MODEL.format(BOX, '<model name="n"/>'), "contains other models"),
    "a frame that is not there": (
        MODEL.format('<pose relative_to="x">0 0 0 0 0 0</pose>' + BOX, ""),
        "there is no frame 'x'",
    ),
    "a frame in itself": (
        MODEL.format('<pose relative_to="a">0 0 0 0 0 0</pose>' + BOX, ""),
        "relative to itself",
    ),
    "a joint of nothing": (
        MODEL.format(BOX, JOINT.format("a", "b", "")), "link 'b', which does not",
    ),
    "a loop": (
        MODEL.format(BOX, '<link name="b"/>' + JOINT.format("a", "b", "<axis/>")
                     + JOINT.format("b", "a", "<axis/>").replace('"j"', '"k"')),
        "loop",
    ),
    "no axis": (MODEL.format(BOX, '<link name="b"/>' + JOINT.format("a", "b", "")), "has no axis"),
    "a zero axis": (
        MODEL.format(BOX, '<link name="b"/>'
                     + JOINT.format("a", "b", "<axis><xyz>0 0 0</xyz></axis>")),
        "must not be zero",
    ),
    "a leader that is not there": (
        ROOM.replace("</axis>", mimic("door_hinge"), 1),
        "mimic names the joint 'door_hinge', which does not exist",
    ),
    "a leader without that axis": (
        ROOM.replace("</axis>", mimic("slide", axis=" axis='axis2'"), 1),
        "'axis2', which 'slide' does not have",
    ),
    "a circle of followers": (
        ROOM.replace("</axis>", mimic("slide"), 1).replace(
            "<upper>0.4</upper></limit></axis>", "</limit>" + mimic("hinge")
        ),
        "follows itself",
    ),
    "a multiplier that is no number": (
        ROOM.replace("</axis>", mimic("slide", "x"), 1), "'x' is not a number",
    ),
    "an infinite offset": (
        ROOM.replace("</axis>", mimic("slide", "1", "inf"), 1), "must be at most 10000",
    ),
    "no size": (MODEL.format(BOX.replace("1 1 1", "1 1 0"), ""), "sizes must be > 0"),
    "two numbers": (MODEL.format(BOX.replace("1 1 1", "1 1"), ""), "makes no valid scene"),
    "no number": (MODEL.format("<pose>0 0 x 0 0 0</pose>" + BOX, ""), "'x' is not a number"),
    "nothing finite": (MODEL.format("<pose>0 0 nan 0 0 0</pose>" + BOX, ""), "must be finite"),
    "deep": (MODEL.format("<a>" * 60 + "</a>" * 60, ""), "nested deeper"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_refused_in_one_line_and_leave_nothing(tmp_path: Path, case: str) -> None:
    text, message = BAD[case]
    (tmp_path / "m.stl").write_text("solid")
    assert_refused(tmp_path, read, text, message)


def test_links_have_the_mass_of_the_file_at_its_center(tmp_path: Path) -> None:
    """The door's origin is the hinge, 0.3 m from that of its link."""
    inertial = "<inertial><pose>0 0.1 0 0 0 0</pose><mass>7.5</mass></inertial>"
    head, door, tail = ROOM.partition('<pose relative_to="hinge">0 0.3 0 0 0 0</pose>')
    item = read(tmp_path, head + door + inertial + tail).object("cabinet")
    links = item.model.urdf.links
    assert links["door"].mass == 7.5
    assert_allclose(links["door"].center, (0, 0.4, 0), atol=1e-9)
    assert links["drawer"].mass == 0.0
    known = known_resistance(item, "hinge", ResistanceConfig())
    assert known.mass == pytest.approx(7.5)


def test_springs_of_joints_are_counted_as_dropped(tmp_path: Path) -> None:
    text = ROOM.replace("<friction>1</friction>", "<spring_stiffness>9</spring_stiffness>")
    report = read_room(write(tmp_path, text), tmp_path).final_report()
    assert report.dropped["springs of joints"] == 1


def test_what_is_drawn_far_out_of_the_collision_shapes_collides(tmp_path: Path) -> None:
    """The cabinet has a drawn mesh of 30 cm on its top, whose ends leave its sides."""
    wing = "<visual name='w'><pose>0.1 0.2 0.4 0 0 0</pose><geometry><mesh><uri>cup/cup.obj</uri>"
    wing += "</mesh></geometry></visual>"
    found = read(tmp_path, ROOM.replace('<link name="body">', f'<link name="body">{wing}'))
    assert found.object("cabinet").bounds[1, 2] == pytest.approx(0.9, abs=1e-6)
    assert any("of what is drawn; the drawn shapes are used, too" in w for w in found.warnings)
