"""Scene files: what is written is what is read, and every kind is recognized."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from momapos.apps.cli.main import main
from momapos.apps.cli.scene import scene_convert, scene_list, scene_show
from momapos.core.errors import FileFormatError, MomaposError, SceneError, UnknownNameError
from momapos.core.geometry.transforms import pose_rpy
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_names import builtin_names
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import box_urdf

CUPBOARD = """<robot name="cupboard">
  <link name="body"><collision><geometry><box size="0.4 0.6 0.8"/></geometry></collision></link>
  <link name="door"><collision><origin xyz="0 0.3 0"/><geometry><box size="0.02 0.6 0.8"/></geometry></collision></link>
  <joint name="hinge" type="revolute"><parent link="body"/><child link="door"/>
    <origin xyz="-0.21 -0.3 0"/><axis xyz="0 0 1"/><limit lower="0" upper="1.5" effort="1" velocity="1"/></joint>
</robot>"""  # noqa: E501


def write(folder: Path, **changes: Any) -> Path:
    """Write a scene of a cupboard and a box, with some top-level keys changed."""
    (folder / "cupboard.urdf").write_text(CUPBOARD)
    data = {
        "format": "momapos-scene",
        "version": 1,
        "name": "room",
        "objects": [
            {
                "name": "cupboard",
                "category": "cabinet",
                "pose": {"xyz": [1, 2, 0.8], "wxyz": [0.0, 0, 0, 1.0]},
                "urdf": "cupboard.urdf",
                "scale": 2.0,
                "joints": {"hinge": 0.5},
            },
            {"name": "cup", "category": "cup", "pose": {"xyz": [0, 0, 1]}, "box": [0.1, 0.1, 0.2]},
        ],
        "floor": [[-3, -3], [3, -3], [3, 3]],
        "start": {"x": 0, "y": -1, "yaw": 1.57},
        **changes,
    }
    path = folder / "room.json"
    path.write_text(json.dumps({key: value for key, value in data.items() if value is not None}))
    return path


def test_a_scene_is_read_as_written(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path))
    assert (scene.name, scene.warnings) == ("room", ())
    assert scene.object("cupboard").values() == {"hinge": 0.5}
    assert scene.object("cupboard").category == "cabinet"
    closed = scene.with_joint("cupboard", "hinge", 0.0).object("cupboard")
    assert_allclose(closed.bounds, [[0.6, 1.4, 0], [1.44, 2.6, 1.6]], atol=1e-9)
    assert_allclose(scene.object("cup").bounds, [[-0.05, -0.05, 0.9], [0.05, 0.05, 1.1]])
    assert scene.floor_polygon.shape == (3, 2)
    assert_allclose(scene.start, [0, -1, 1.57])


def test_a_saved_scene_round_trips(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path))
    save_scene(scene, tmp_path / "again.json")
    again = load_scene(tmp_path / "again.json")
    assert again.name == scene.name
    for a, b in zip(scene.objects, again.objects, strict=True):
        assert (a.name, a.category, a.joints) == (b.name, b.category, b.joints)
        assert_allclose(a.T_world_object, b.T_world_object, atol=1e-12)
        assert_allclose(a.bounds, b.bounds, atol=1e-12)
    assert_allclose(again.floor_polygon, scene.floor_polygon)
    assert_allclose(again.start, scene.start)
    first = (tmp_path / "again.json").read_bytes()
    save_scene(again, tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == first
    assert {p.name for p in tmp_path.iterdir()} == {"again.json", "room.json", "cupboard.urdf"}


@settings(max_examples=30)
@given(
    xyz=st.tuples(*[st.floats(-50, 50)] * 3),
    rpy=st.tuples(*[st.floats(-4, 4)] * 3),
    size=st.tuples(*[st.floats(1e-3, 5)] * 3),
)
def test_any_box_survives_the_round_trip(
    tmp_path_factory: pytest.TempPathFactory,
    xyz: tuple[float, float, float],
    rpy: tuple[float, float, float],
    size: tuple[float, float, float],
) -> None:
    path = tmp_path_factory.mktemp("box") / "scene.json"
    item = SceneObject("a", "", pose_rpy(xyz, rpy), Articulated(box_urdf("a", size)))
    save_scene(Scene("s", (item,)), path)
    again = load_scene(path).object("a")
    assert_allclose(again.T_world_object, item.T_world_object, atol=1e-9)
    assert_allclose(again.bounds, item.bounds, atol=1e-9)


def test_the_built_in_kitchens_load() -> None:
    for name in builtin_names():
        scene = load_scene(name)
        assert scene.objects
        assert scene.warnings == ()


def test_an_unknown_kitchen_suggests_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match="no kitchen 'gallery'"):
        load_scene("gallery")
    with pytest.raises(FileFormatError, match="no such scene file"):
        load_scene("kitchens/mine.json")


def test_a_urdf_is_a_scene_of_one_object_on_the_floor(tmp_path: Path) -> None:
    folder = tmp_path / "Fridge" / "10144"
    folder.mkdir(parents=True)
    (folder / "mobility.urdf").write_text(CUPBOARD)
    scene = load_scene(folder / "mobility.urdf")
    (item,) = scene.objects
    assert (item.name, item.category) == ("fridge", "fridge")
    assert item.bounds[0, 2] == pytest.approx(0)
    assert list(item.model.joints) == ["hinge"]


def test_the_content_determines_the_kind_of_a_file(tmp_path: Path) -> None:
    path = write(tmp_path)
    path.rename(tmp_path / "room.txt")
    assert load_scene(tmp_path / "room.txt").name == "room"
    (tmp_path / "cupboard.dat").write_text("\n" + CUPBOARD)
    assert load_scene(tmp_path / "cupboard.dat").objects[0].name == "cupboard"


def test_objects_of_one_urdf_share_their_model(tmp_path: Path) -> None:
    pose = {"xyz": [0, 0, 0]}
    items = [{"name": n, "pose": pose, "urdf": "./cupboard.urdf"} for n in "ab"]
    a, b = load_scene(write(tmp_path, objects=items)).objects
    assert a.model is b.model


def test_unknown_keys_are_reported(tmp_path: Path) -> None:
    items = [{"name": "a", "pose": {"xyz": [0, 0, 0]}, "box": [1, 1, 1], "joint": {}}]
    scene = load_scene(write(tmp_path, objects=items, color="red"))
    assert "'color' is not known" in scene.warnings[0]
    assert "did you mean 'joints'" in scene.warnings[1]


def test_a_scene_is_not_saved_away_from_its_models(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path))
    out = tmp_path / "elsewhere" / "room.json"
    with pytest.raises(SceneError, match=r"cupboard\.urdf, which is not below"):
        save_scene(scene, out)
    assert not out.exists()


def test_paths_go_below_the_given_root(tmp_path: Path) -> None:
    (tmp_path / "scenes").mkdir()
    path = write(tmp_path / "scenes")
    (tmp_path / "scenes" / "cupboard.urdf").rename(tmp_path / "cupboard.urdf")
    text = path.read_text().replace('"cupboard.urdf"', '"../cupboard.urdf"')
    path.write_text(text)
    with pytest.raises(SceneError, match="leaves"):
        load_scene(path)
    assert load_scene(path, root=tmp_path).objects[0].name == "cupboard"


def test_converting_copies_the_files_of_the_scene(tmp_path: Path) -> None:
    source, out = tmp_path / "source", tmp_path / "target" / "room.json"
    source.mkdir()
    path = write(source)
    (source / "mesh.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n")
    (source / "sub").mkdir()
    mesh = CUPBOARD.replace('<box size="0.4 0.6 0.8"/>', '<mesh filename="../mesh.obj"/>')
    (source / "sub" / "cupboard.urdf").write_text(mesh)
    path.write_text(path.read_text().replace('"cupboard.urdf"', '"sub/cupboard.urdf"'))
    with pytest.raises(SceneError, match="--copy") as caught:
        scene_convert(str(path), out)
    assert str(source) in str(caught.value), "suggests another folder"
    assert not out.parent.exists()
    assert scene_convert(str(path), out, copy=True) == 0
    shutil.rmtree(source / "sub")
    names = {str(p.relative_to(out.parent)) for p in out.parent.rglob("*") if p.is_file()}
    assert names == {"room.json", "room_files/mesh.obj", "room_files/sub/cupboard.urdf"}
    copied = load_scene(out)
    assert copied.object("cupboard").values() == {"hinge": 0.5}
    assert len(copied.object("cupboard").model.hulls["body"][0].vertices) == 4
    with pytest.raises(SceneError, match="exists already"):
        scene_convert(str(out), out, copy=True)


def test_converting_copies_no_private_file_that_an_untrusted_urdf_names(tmp_path: Path) -> None:
    (tmp_path / "home" / "download").mkdir(parents=True)
    for place, name, content in (
        ("home", "private.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"),
        ("home/download", "private.txt", "v 0 0 0\n"),
        ("home/download", "private.stl", "secret"),
        ("home/download", "private.obj", "secret"),
    ):
        secret = tmp_path / place / name
        secret.write_text(content)
        way = os.path.relpath(secret, tmp_path / "home" / "download")
        for kind in ("collision", "visual"):
            urdf = tmp_path / "home" / "download" / "evil.urdf"
            urdf.write_text(
                f'<robot name="e"><link name="a"><{kind}><geometry><mesh filename="{way}"/>'
                f"</geometry></{kind}></link></robot>"
            )
            with pytest.raises(MomaposError, match="private"):
                scene_convert(str(urdf), tmp_path / "out" / "room.json", copy=True)
            assert not list(tmp_path.glob("out/*"))
        secret.unlink()


def test_converting_copies_the_meshes_of_a_package(tmp_path: Path) -> None:
    for folder in ("pkg/urdf", "pkg/meshes"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "pkg/meshes/a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n")
    mesh = '<mesh filename="package://pkg/meshes/a.obj"/>'
    urdf = CUPBOARD.replace('<box size="0.4 0.6 0.8"/>', mesh)
    (tmp_path / "pkg/urdf/cupboard.urdf").write_text(urdf)
    out = tmp_path / "out" / "room.json"
    assert scene_convert(str(tmp_path / "pkg/urdf/cupboard.urdf"), out, copy=True) == 0
    shutil.rmtree(tmp_path / "pkg")
    assert len(load_scene(out).objects[0].model.hulls["body"][0].vertices) == 4


def test_an_interrupted_conversion_can_be_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "source").mkdir()
    path, out = write(tmp_path / "source"), tmp_path / "target" / "room.json"

    folders = []

    def cut_off(*_: object, **__: object) -> bytes:
        folders.append((out.parent / "room_files").exists())
        raise KeyboardInterrupt

    for step in (
        "momapos.model.scene.model_copies.read_bytes_bounded",
        "momapos.apps.cli.conversion.save_scene",
    ):
        with monkeypatch.context() as patch:
            patch.setattr(step, cut_off)
            with pytest.raises(KeyboardInterrupt):
                scene_convert(str(path), out, copy=True)
        assert not list(out.parent.iterdir())
    assert folders == [False, True], "the folder is complete, or missing"
    assert scene_convert(str(path), out, copy=True) == 0


def test_showing_a_scene_prints_its_joints_and_draws_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, picture = write(tmp_path, color="red"), tmp_path / "new" / "room.png"
    assert scene_show(str(path), plot=picture) == 0
    text = capsys.readouterr()
    assert "hinge" in text.out
    assert "0.00 to 1.50 rad, at 0.50" in text.out
    assert "'color'" in text.out
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert scene_show(str(path), json=True) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["floor_area"] == pytest.approx(18.0)
    assert facts["objects"][0]["joints"] == [
        {"name": "hinge", "kind": "revolute", "lower": 0.0, "upper": 1.5, "value": 0.5}
    ]


def test_the_built_in_kitchens_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert scene_list(json=True) == 0
    scenes = json.loads(capsys.readouterr().out)["scenes"]
    assert len(scenes) == len(builtin_names())


BOX = {"name": "a", "pose": {"xyz": [0, 0, 0]}, "box": [1, 1, 1]}
CABINET = {"name": "a", "pose": {"xyz": [0, 0, 0]}, "urdf": "cupboard.urdf"}


@pytest.mark.parametrize(
    ("item", "message"),
    [
        ([], "must be {name: ..., pose: ...}"),
        ({**BOX, "name": ""}, "name must be text"),
        ({**BOX, "name": 3}, "name must be text"),
        ({**BOX, "category": 3}, "category must be text"),
        ({**BOX, "pose": None}, "pose must be"),
        ({**BOX, "pose": {"xyz": [0, 0]}}, "xyz must be 3 numbers"),
        ({**BOX, "pose": {"xyz": [0, 0, True]}}, "xyz must be 3 numbers"),
        ({**BOX, "pose": {"xyz": [0, 0, 10**400]}}, "xyz must be 3 numbers"),
        ({**BOX, "pose": {"xyz": [0, 0, 1e6]}}, "from -10000 to 10000"),
        ({**BOX, "pose": {"xyz": [0, 0, 0], "wxyz": [0, 0, 0, 0]}}, "wxyz has length 0"),
        ({**BOX, "box": [1, 1, 0]}, "box must be 3 numbers > 0"),
        ({**BOX, "box": [1, 1, -1]}, "box must be 3 numbers > 0"),
        ({**BOX, "box": [1, 1, 1e9]}, "box must be 3 numbers > 0"),
        ({**BOX, "urdf": "cupboard.urdf"}, "either 'urdf' or 'box'"),
        ({**CABINET, "urdf": "gone.urdf"}, "does not exist"),
        ({**CABINET, "urdf": "/etc/passwd"}, "leaves the scene's folder"),
        ({**CABINET, "urdf": "../../etc/passwd"}, "leaves the scene's folder"),
        ({**CABINET, "scale": -1}, "scale"),
        ({**CABINET, "joints": {"hinge": 2}}, "limits are 0 to 1.5"),
        ({**CABINET, "joints": {"hinge": "0.1"}}, "must be a number"),
        ({**CABINET, "joints": [0.1]}, "joints must be"),
    ],
)
def test_an_invalid_object_is_named(tmp_path: Path, item: Any, message: str) -> None:
    with pytest.raises((SceneError, FileFormatError), match=message) as caught:
        load_scene(write(tmp_path, objects=[{**BOX, "name": "fine"}, item]))
    assert "object 1" in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, "not a scene"),
        ({"version": 2}, "reads version 1"),
        ({"objects": None}, "objects is missing; it must be a list"),
        ({"objects": [BOX] * 2_001}, "length 0 to 2000"),
        ({"floor": [[0, 0], [1, 1]]}, "3 to 1000"),
        ({"floor": [[0, 0], [1, 1], [2, 2]]}, "no area"),
        ({"floor": [[0, 0], [1, 1], [2, "x"]]}, "floor: point 2"),
        ({"floor": [[0, 0], [1, 0], [1e9, 2]]}, "from -10000 to 10000"),
        ({"start": [0, 0, 0]}, "start must be"),
        ({"start": {"x": 0, "y": 0}}, "start: yaw is missing"),
        ({"start": {"x": 0, "y": 0, "yaw": "north"}}, "start: yaw must be"),
    ],
)
def test_an_invalid_scene_is_refused_with_the_reason(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises((SceneError, FileFormatError), match=message):
        load_scene(write(tmp_path, **changes))


def test_an_unknown_joint_suggests_the_nearest(tmp_path: Path) -> None:
    items = [{**CABINET, "joints": {"hing": 0.1}}]
    with pytest.raises(UnknownNameError, match="did you mean hinge"):
        load_scene(write(tmp_path, objects=items))


def test_the_floor_is_kept_in_the_order_of_the_file(tmp_path: Path) -> None:
    outline = [[0, 0], [0, 4], [2, 4], [2, 2], [4, 2], [4, 0]]
    assert_allclose(
        load_scene(write(tmp_path, floor=outline)).floor_polygon, np.array(outline, float)
    )


_KILLED = """
import os, signal
from pathlib import Path
from momapos.apps.cli import conversion
from momapos.apps.cli.main import main
conversion.save_scene = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
main(["scene", "convert", "kitchen_small", "room.json", "--copy"])
"""


def test_converting_with_copies_goes_on_after_a_kill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    call = [sys.executable, "-c", _KILLED]
    assert subprocess.run(call, check=False).returncode == -signal.SIGKILL
    assert (tmp_path / "room_files").is_dir()
    assert main(["scene", "convert", "kitchen_small", "room.json", "--copy"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["room.json", "room_files"]
    assert not list((tmp_path / "room_files").glob(".*"))
    (tmp_path / "room.json").unlink()
    # A folder that is complete is the user's, also without its scene file.
    assert main(["scene", "convert", "kitchen_small", "room.json", "--copy"]) == 2


def test_half_a_character_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "room.json"
    path.write_text(
        json.dumps({"format": "momapos-scene", "version": 1, "walls": "\ud800", "objects": []})
    )
    with pytest.raises(SceneError, match="walls must be"):
        load_scene(path)
