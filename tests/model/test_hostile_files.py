"""Damaged or malicious files are rejected with one helpful line, and nothing is written."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from momapos.core.errors import MomaposError
from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf

BOX = "<collision><geometry><box size='0.2 0.2 0.2'/></geometry></collision>"
LIMIT = "<limit lower='-1' upper='1' effort='1' velocity='1'/>"
ROBOT_URDF = f"""<robot name="r">
  <link name="base">{BOX}</link> <link name="upper">{BOX}</link>
  <link name="lower">{BOX}</link> <link name="tool"/> <link name="wheel"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>{LIMIT}</joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>{LIMIT}</joint>
  <joint name="wrist" type="fixed"><parent link="lower"/><child link="tool"/></joint>
  <joint name="spin" type="continuous"><parent link="base"/><child link="wheel"/></joint>
</robot>"""
ROBOT_TOML = """name = "r"
urdf = "r.urdf"
base_link = "base"
tool_link = "tool"
arm_joints = ["shoulder", "elbow"]
gripper_links = []
home = [0.0, 0.0]
[base]
footprint = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]
drive = "differential"
[tool]
approach_axis = [1, 0, 0]
closing_axis = [0, 1, 0]
"""


def urdf(body: str) -> str:
    return f'<robot name="r">{body}</robot>'


def shape_of(text: str) -> str:
    return f"<collision><geometry>{text}</geometry></collision>"


def shape(text: str) -> str:
    return urdf(f'<link name="a">{shape_of(text)}</link>')


def joint(text: str, name: str = "j", parent: str = "a", child: str = "b") -> str:
    return f'<joint name="{name}" {text}<parent link="{parent}"/><child link="{child}"/></joint>'


def linked(*joints: str) -> str:
    return urdf('<link name="a"/><link name="b"/><link name="c"/>' + "".join(joints))


REVOLUTE = f'type="revolute">{LIMIT}<axis xyz="0 0 1"/>'
FIXED = 'type="fixed">'
BOMB = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(9))


def refused(folder: Path, act: Callable[[], Any], *words: str) -> None:
    """Check that a call fails quickly with one line that contains words, and writes nothing."""
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if not path.is_symlink()}
    started = time.process_time()
    with pytest.raises(MomaposError) as caught:
        act()
    message = str(caught.value)
    assert "\n" not in message
    assert 10 < len(message) < 600
    for word in words:
        assert word in message, message
    assert time.process_time() - started < 20, "hangs"
    after = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if not path.is_symlink()}
    assert after == before


URDFS: dict[str, tuple[str, str]] = {
    "empty": ("", "not well-formed"),
    "truncated": (ROBOT_URDF[:300], "not well-formed"),
    "other format": ('{"format": "momapos-scene"}', "not well-formed"),
    "other XML": ("<sdf><model/></sdf>", "<robot>"),
    "binary": ("\x00\x01\x02", "not well-formed"),
    "xacro": (
        '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:macro name="a"/></robot>',
        "xacro macros",
    ),
    "entity bomb": (
        f'<!DOCTYPE r [<!ENTITY e0 "ha">{BOMB}]><robot name="r">&e9;<link name="a"/></robot>',
        "entities are not allowed",
    ),
    "external entity": (
        '<!DOCTYPE r [<!ENTITY e SYSTEM "file:///etc/passwd">]><robot name="&e;"/>',
        "entities are not allowed",
    ),
    "no links": (urdf(""), "no links"),
    "no names": (urdf("<link/>"), "name"),
    "name with a line break": (urdf('<link name="a&#10;b"/>'), "name"),
    "too deep": (urdf("<a>" * 100_000 + "</a>" * 100_000), "nested deeper"),
    "too many links": (urdf("".join(f'<link name="{i}"/>' for i in range(6000))), "5000"),
    "many collisions": (
        urdf('<link name="a">' + shape_of('<sphere radius="1"/>') * 30_000 + "</link>"),
        "2000",
    ),
    "collision without geometry": (urdf('<link name="a"><collision/></link>'), "no <geometry>"),
    "optenv in optenv": (urdf('<link name="' + "$(optenv X " * 500_000 + '"/>'), "name"),
    "optenv and spaces": (urdf('<link name="$(optenv ' + " " * 5_000_000 + '"/>'), "name"),
    "an unknown encoding": ("<?xml version='1.0' encoding='utf-7'?>" + urdf(""), "no links"),
    "another encoding": ("<?xml version='1.0' encoding='utf-16'?>" + urdf(""), "no links"),
    "endless optenv": (urdf('<link name="$(optenv X ' + "a" * 2_000_000 + '"/>'), "name"),
    "missing mesh": (shape('<mesh filename="gone.stl"/>'), "'gone.stl' does not exist"),
    "mesh outside": (shape('<mesh filename="../secret.stl"/>'), "is outside"),
    "absolute mesh": (shape('<mesh filename="/etc/passwd"/>'), "is outside"),
    "package mesh outside": (shape('<mesh filename="package://../../secret.stl"/>'), "is outside"),
    "mesh through a link": (shape('<mesh filename="door/secret.stl"/>'), "is outside"),
    "mesh with an endless name": (shape(f'<mesh filename="{"a" * 5000}.stl"/>'), "looked up"),
    "mesh behind a circle": (shape('<mesh filename="circle/a.stl"/>'), "mesh"),
    "mesh without a name": (shape("<mesh/>"), "filename"),
    "mesh of another kind": (shape('<mesh filename="r.zip"/>'), ".stl"),
    "empty mesh": (shape('<mesh filename="empty.obj"/>'), "empty"),
    "NaN mesh": (shape('<mesh filename="nan.obj"/>'), "NaN"),
    "huge mesh": (shape('<mesh filename="huge.obj"/>'), "the limit is"),
    "text as a mesh": (shape('<mesh filename="text.obj"/>'), "OBJ"),
    "text as STL": (shape('<mesh filename="text.stl"/>'), "mesh"),
    "no shape": (shape(""), "box, cylinder, sphere, capsule, mesh"),
    "unknown shape": (shape('<torus radius="1"/>'), "box, cylinder, sphere, capsule, mesh"),
    "NaN size": (shape('<box size="1 nan 1"/>'), "3 finite numbers"),
    "infinite size": (shape('<sphere radius="1e999"/>'), "1 finite number"),
    "zero size": (shape('<box size="1 0 1"/>'), "> 0"),
    "negative size": (shape('<cylinder radius="-1" length="1"/>'), "> 0"),
    "huge size": (shape('<box size="1 1e30 1"/>'), "larger"),
    "two edges": (shape('<box size="1 1"/>'), "3 finite numbers"),
    "no size": (shape("<box/>"), "no size"),
    "no length": (shape('<cylinder radius="1"/>'), "no length"),
    "words for numbers": (shape('<sphere radius="big"/>'), "1 finite number"),
    "zero mesh scale": (shape('<mesh filename="good.obj" scale="1 0 1"/>'), "size"),
    "duplicate links": (urdf('<link name="a"/><link name="a"/>'), "unique"),
    "duplicate joints": (
        linked(joint(FIXED), joint(FIXED, parent="b", child="c")),
        "two joints are named 'j'",
    ),
    "joint to no link": (
        linked(joint(FIXED), joint(FIXED, "k", "b", "c").replace('<child link="c"/>', "<child/>")),
        "joint 'k': <child> has no link",
    ),
    "two parents": (
        linked(joint(FIXED), joint(FIXED, "k", "c"), joint(FIXED, "l", "a", "c")),
        "two parents",
    ),
    "loop": (
        linked(joint(FIXED), joint(FIXED, "k", "b", "c"), joint(FIXED, "l", "c", "a")),
        "loop",
    ),
    "joint on itself": (linked(joint(FIXED, child="a")), "loop"),
    "missing link": (linked(joint(FIXED, child="z")), "missing link 'z'"),
    "no parent": (linked('<joint name="j" type="fixed"><child link="b"/></joint>'), "<parent>"),
    "lower above upper": (
        linked(joint(REVOLUTE.replace("'-1'", "'2'")), joint(FIXED, "k", "b", "c")),
        "lower limit 2 above upper limit 1",
    ),
    "NaN limit": (
        linked(joint(REVOLUTE.replace("'-1'", "'nan'")), joint(FIXED, "k", "b", "c")),
        "finite",
    ),
    "unknown joint type": (
        linked(joint('type="screw">'), joint(FIXED, "k", "b", "c")),
        "'screw'; revolute, continuous, prismatic and fixed",
    ),
    "no joint type": (linked(joint(">"), joint(FIXED, "k", "b", "c")), "revolute"),
    "zero axis": (
        linked(joint(REVOLUTE.replace("0 0 1", "0 0 0")), joint(FIXED, "k", "b", "c")),
        "zero axis",
    ),
}


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """Return a folder with good and bad meshes, next to a file that must not be read."""
    folder = tmp_path / "room"
    folder.mkdir()
    (tmp_path / "secret.stl").write_text("solid secret\nendsolid secret\n")
    (folder / "door").symlink_to(tmp_path, target_is_directory=True)
    (folder / "circle").symlink_to(folder / "circle")
    os.mkfifo(folder / "pipe")
    meshes = {
        "good.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n",
        "empty.obj": "# nothing\n",
        "nan.obj": "v 0 0 nan\nv 1 0 0\nv 0 1 0\nv 0 0 1\n",
        "huge.obj": "v 0 0 1e300\nv 1 0 0\nv 0 1 0\nv 0 0 1\n",
        "text.obj": "v a b c\n",
        "text.stl": "lorem ipsum",
        "r.zip": "PK",
    }
    for name, text in meshes.items():
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize("case", URDFS)
def test_a_malicious_urdf_is_rejected(room: Path, case: str) -> None:
    text, word = URDFS[case]
    path = room / "r.urdf"
    path.write_text(text)

    def read() -> None:
        assert Articulated(read_urdf(path, root=room)).hulls

    refused(room, read, str(room), word)


@pytest.mark.parametrize("case", URDFS)
def test_a_malicious_urdf_is_rejected_in_a_scene(room: Path, case: str) -> None:
    text, word = URDFS[case]
    (room / "r.urdf").write_text(text)
    item = {"name": "a", "pose": {"xyz": [0, 0, 0]}, "urdf": "r.urdf"}
    path = scene(room, objects=[item])

    def read() -> None:
        assert load_scene(path).object("a").model.hulls

    refused(room, read, word)


# ------------------------------------------------------------------------------------------- scenes


def scene(folder: Path, **changes: Any) -> Path:
    box = {"name": "box", "pose": {"xyz": [0, 0, 0]}, "box": [1, 1, 1]}
    data = {"format": "momapos-scene", "version": 1, "name": "s", "objects": [box], **changes}
    path = folder / "scene.json"
    path.write_text(json.dumps(data))
    return path


def bestman(folder: Path, **changes: Any) -> Path:
    (folder / "Asset").mkdir(exist_ok=True)
    (folder / "Asset" / "a.urdf").write_text(shape('<box size="1 1 1"/>'))
    item = {
        "obj_name": "a", "model_path": "Asset/a.urdf", "object_position": [0, 0, 0],
        "object_orientation": [0, 0, 0], "scale": 1, **changes,
    }  # fmt: skip
    path = folder / "bestman.json"
    path.write_text(json.dumps([item]))
    return path


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "empty"),
        (b" \n", "empty"),
        (b'{"format": "momapos-scene", "vers', "invalid JSON"),
        (b"[1, 2", "invalid JSON"),
        (b"[]", "empty"),
        (b"[1]", "not a JSON object"),
        (b'[{"a": 1}]', "obj_name"),
        (b"{}", "not a scene"),
        (b'{"format": "momapos-plan", "version": 1}', "momapos-plan"),
        (b'{"format": "momapos-scene", "version": 99}', "version 99"),
        (b'{"format": "momapos-scene", "version": 1, "objects": 3}', "objects"),
        (b'{"format": "momapos-scene", "version": 1, "objects": [], "floor": [[NaN]]}', "NaN"),
        (b'{"format": "momapos-scene", "version": 1, "objects": [], "start": 1e999}', "start"),
        (b"[" * 100_000, "invalid JSON"),
        (b'{"a":' * 100_000, "invalid JSON"),
        (b"hello", "neither"),
        (b"\x89PNG\r\n\x1a\n", "neither"),
        (b"<html></html>", "<robot>"),
        (b"\xff\xfe{\x00}\x00", "neither"),
    ],
)
def test_a_file_that_is_not_a_scene_is_rejected(room: Path, content: bytes, word: str) -> None:
    path = room / "scene.json"
    path.write_bytes(content)
    refused(room, lambda: load_scene(path), str(path), word)


@pytest.mark.parametrize(
    "name", ["gone.json", "pipe", "/dev/zero", "no/such/scene", "x" * 5000, "a\0b.json", "."]
)
def test_a_missing_scene_is_rejected(room: Path, name: str) -> None:
    refused(room, lambda: load_scene(room / name), "")


@pytest.mark.parametrize(
    ("item", "words"),
    [
        ({"urdf": "../secret.urdf"}, ["leaves"]),
        ({"urdf": "door/secret.urdf"}, ["leaves"]),
        ({"urdf": "/etc/passwd"}, ["leaves"]),
        ({"urdf": "circle/a.urdf"}, ["urdf"]),
        ({"urdf": "a" * 900}, ["looked up"]),
        ({"urdf": "a\u0000b"}, ["printable"]),
        ({"urdf": "good.obj"}, ["XML"]),
        ({"urdf": "."}, ["does not exist"]),
        ({"urdf": "r.urdf", "joints": {"elbw": 0}}, ["elbow"]),
        ({"urdf": "r.urdf", "joints": {"elbow": 9}}, ["limits"]),
        ({"urdf": "r.urdf", "scale": 1e9}, ["scale"]),
        ({"box": [1, 1, 1e300]}, ["box must be 3 numbers"]),
        ({"box": [1, 1]}, ["3 numbers"]),
        ({"box": "1 1 1"}, ["3 numbers"]),
        ({"box": [1, 1, 1], "pose": {"xyz": [0, 0, 10**300]}}, ["xyz must be 3 numbers"]),
    ],
)
def test_a_malicious_object_is_rejected(room: Path, item: dict[str, Any], words: list[str]) -> None:
    (room / "r.urdf").write_text(ROBOT_URDF)
    path = scene(room, objects=[{"name": "a", "pose": {"xyz": [0, 0, 0]}, **item}])
    refused(room, lambda: load_scene(path), str(room), *words)


WIDE = [{"name": f"b{i}", "pose": {"xyz": [0, 0, 0]}, "box": [40, 40, 9]} for i in range(4)]
VAST: dict[str, tuple[dict[str, Any], list[str]]] = {
    "a wide floor": ({"floor": [[0, 0], [500, 0], [0, 500]]}, ["500.5 x 500.5 x", "the floor"]),
    "a floor far away": ({"floor": [[900, 900], [901, 900], [900, 901]]}, ["50 x 50 x 10 m"]),
    "many corners": ({"floor": [[i / 1e3, i % 2] for i in range(10_000)]}, ["3 to 1000"]),
    "a wide box": (
        {"objects": [{"name": "b", "pose": {"xyz": [0, 0, 0]}, "box": [900, 1, 1]}]},
        ["900 x 1 x 1 m", "'b'"]),
    "a high box": (
        {"objects": [{"name": "b", "pose": {"xyz": [0, 0, 0]}, "box": [1, 1, 90]}]}, ["'b'"]),
    "boxes far apart": (
        {"objects": [{"name": n, "pose": {"xyz": [x, 0, 0]}, "box": [1, 1, 1]}
                     for n, x in (("a", 0), ("b", 1), ("c", 9000))]}, ["'c'"]),
    "boxes one in another": ({"objects": WIDE}, ["4 collision elements", "50000 m^3"]),
    "a long mesh": (
        {"objects": [{"name": "b", "pose": {"xyz": [0, 0, 0]}, "urdf": "long.urdf"}]}, ["'b'"]),
    "many objects": ({"objects": [{}] * 2_001}, ["2000"]),
    "a start far away": ({"start": {"x": 1e300, "y": 0, "yaw": 0}}, ["start"]),
}  # fmt: skip


@pytest.mark.parametrize("case", VAST)
def test_a_room_that_is_too_large_for_a_grid_is_rejected(room: Path, case: str) -> None:
    changes, words = VAST[case]
    (room / "long.obj").write_text("v 0 0 0\nv 900 0 0\nv 0 1 0\nv 0 0 1\n")
    (room / "long.urdf").write_text(shape('<mesh filename="long.obj"/>'))
    path = scene(room, **changes)
    refused(room, lambda: load_scene(path), str(path), *words)


def test_a_room_with_a_thousand_objects_can_be_used(room: Path) -> None:
    objects = [
        {"name": f"b{i}", "pose": {"xyz": [1.5 * (i % 32), 1.5 * (i // 32), 1]}, "box": [1, 1, 2]}
        for i in range(1000)
    ]
    path = scene(room, objects=objects, floor=[[-1, -1], [48, -1], [48, 48], [-1, 48]])
    assert len(load_scene(path).objects) == 1000


def test_two_objects_with_the_same_name_are_rejected(room: Path) -> None:
    box = {"name": "cup", "pose": {"xyz": [0, 0, 0]}, "box": [1, 1, 1]}
    path = scene(room, objects=[box, {**box, "name": "pan"}, box])
    refused(room, lambda: load_scene(path), "objects 0 and 2", "'cup'")


@pytest.mark.parametrize(
    "text", ["9**9**9", "9**9**9**9", "(" * 500, "1" + "+1" * 5000, "-" * 5000, "__import__('os')"]
)
@pytest.mark.parametrize("key", ["object_position", "object_orientation", "scale"])
def test_arithmetic_bombs_are_rejected(room: Path, text: str, key: str) -> None:
    path = bestman(room, **{key: text if key == "scale" else [0, 0, text]})
    refused(room, lambda: load_scene(path), "object 0", key)


@pytest.mark.parametrize("model", ["../secret.stl", "/etc/passwd", "door/x.urdf", "a" * 900])
def test_a_bestman_model_outside_the_root_is_rejected(room: Path, model: str) -> None:
    path = bestman(room, model_path=model)
    refused(room, lambda: load_scene(path), "object 0", "model_path")


def test_errors_for_unknown_names_suggest_similar_ones(room: Path) -> None:
    (room / "r.urdf").write_text(ROBOT_URDF)
    loaded = load_scene(
        scene(room, objects=[{"name": "fridge", "pose": {"xyz": [0, 0, 0]}, "urdf": "r.urdf"}])
    )
    refused(room, lambda: loaded.object("frigde"), "did you mean fridge")
    refused(room, lambda: loaded.with_joint("fridge", "elbo", 0.0), "did you mean elbow")


# ------------------------------------------------------------------------------------------- robots


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("", ""), None),
        (('"shoulder", "elbow"', '"elbow", "shoulder"'), ["does not move with"]),
        (('"shoulder", "elbow"', '"shoulder", "spin"'), ["chain"]),
        (('"shoulder", "elbow"', '"shoulder", "shoulder"'), ["twice"]),
        (('"shoulder", "elbow"', '"shoulder", "elbo"'), ["elbow"]),
        (('"shoulder", "elbow"', ""), ["arm_joints"]),
        (('base_link = "base"', 'base_link = "bas"'), ["base"]),
        (('base_link = "base"', 'base_link = "lower"'), ["base"]),
        (('tool_link = "tool"', 'tool_link = "wheel"'), ["wheel"]),
        (("gripper_links = []", 'gripper_links = ["hand"]'), ["hand"]),
        (("[0.0, 0.0]", "[0.0]"), ["home"]),
        (("[0.0, 0.0]", "[0.0, 9.0]"), ["limits"]),
        (("[0.0, 0.0]", "[0.0, nan]"), ["nan"]),
        (("home = [0.0, 0.0]", ""), ["home is missing"]),
        (("[[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]", "[[0, 0]]"), ["footprint"]),
        (('"differential"', '"legs"'), ["differential, omni"]),
        (("[0, 1, 0]", "[1, 0, 0]"), ["perpendicular"]),
        (("[0, 1, 0]", "[0, 0, 0]"), ["closing_axis"]),
        (('"r.urdf"', '"gone.urdf"'), ["gone.urdf"]),
        (('"r.urdf"', '"a\\u0000b"'), ["urdf must be a printable text"]),
        (('"r.urdf"', '"circle/r.urdf"'), ["circle"]),
        (('"r.urdf"', '"pipe"'), ["fifo"]),
        (("home = [0.0, 0.0]", f"home = [0, 1{'0' * 400}]"), ["home[1] must be a number"]),
        (("home = [0.0, 0.0]", f"home = [0, 1{'0' * 5000}]"), ["TOML"]),
        (('"differential"', f'"omni"\nmax_speed = 1{"0" * 400}'), ["max_speed"]),
        (("[[-0.1, -0.1],", "[[-0.1, 1e300],"), ["footprint"]),
        (('name = "r"', "name = "), ["TOML"]),
        (('name = "r"', '{"name": "r"}'), ["TOML"]),
    ],
)
def test_an_inconsistent_robot_file_is_rejected(
    room: Path, change: tuple[str, str], words: list[str] | None
) -> None:
    (room / "r.urdf").write_text(ROBOT_URDF)
    path = room / "r.toml"
    path.write_text(ROBOT_TOML.replace(*change) if change[0] else ROBOT_TOML)
    if words is None:
        assert load_robot(path).chain.size == 2
    else:
        refused(room, lambda: load_robot(path), *words)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\xfe",
        b"a = [" * 50_000,
        b"x" * 2_000_000,
        b"<robot/>",
        b"{}",
        b"a = " + b"[" * 50_000,
        b"a." * 400_000 + b"a = 1",
        b"a = 1" + b"0" * 5000,
    ],
)
def test_a_damaged_robot_file_is_rejected(room: Path, content: bytes) -> None:
    path = room / "r.toml"
    path.write_bytes(content)
    refused(room, lambda: load_robot(path), str(path))


@pytest.mark.parametrize(
    "content",
    [
        b"<?xml version='1.0' encoding='utf-7'?><robot>",
        "<?xml version='1.0' encoding='utf-8'?><robot/>".encode("utf-16"),
        b"<!DOCTYPE r [<!ENTITY e 'x'>]><robot>&e;</robot>",
        b"<robot>" + b" " * 5_000_000 + b"</robot>",
        b"\x00",
        b"",
    ],
)
def test_a_damaged_srdf_is_rejected(room: Path, content: bytes) -> None:
    (room / "r.urdf").write_text(ROBOT_URDF)
    (room / "r.toml").write_text(ROBOT_TOML)
    (room / "r.srdf").write_bytes(content)
    refused(room, lambda: load_robot(room / "r.toml"), str(room / "r.srdf"))


def test_an_arm_of_kilometers_is_rejected(room: Path) -> None:
    (room / "r.urdf").write_text(ROBOT_URDF.replace('"0.4 0 0"', '"4000 0 0"'))
    (room / "r.toml").write_text(ROBOT_TOML)
    refused(room, lambda: load_robot(room / "r.toml"), "meters")


@pytest.mark.parametrize("name", ["fetsh", "gone.toml", "r.urdf", "x" * 5000])
def test_a_missing_robot_is_rejected(room: Path, name: str) -> None:
    refused(room, lambda: load_robot(name), "")
