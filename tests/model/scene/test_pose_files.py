"""Laws of files of tool poses: every format gives the same poses, and mistakes name the row."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from momapos.core.errors import FileFormatError, InputError, UnknownNameError
from momapos.core.geometry.transforms import rotation_of
from momapos.model.records.poses import ToolPose
from momapos.model.scene import pose_files
from momapos.model.scene.pose_files import load_poses
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject

XYZ, WXYZ = (0.5, -1.0, 1.2), (0.5, 0.5, -0.5, 0.5)


@pytest.fixture(scope="module")
def room() -> Scene:
    return Scene("room", (SceneObject.box("table", (1, 1, 1), (2.0, 1.0, 0.5), yaw=0.7),))


def matrix() -> list[list[float]]:
    T = np.eye(4)
    T[:3, :3] = rotation_of(2 * math.pi / 3 * np.array([1.0, -1.0, 1.0]) / math.sqrt(3))
    T[:3, 3] = XYZ
    return T.tolist()


def ros(frame: str = "") -> dict[str, Any]:
    x, y, z = XYZ
    w, a, b, c = WXYZ
    pose = {
        "position": {"x": x, "y": y, "z": z},
        "orientation": {"x": a, "y": b, "z": c, "w": w},
    }
    return {"header": {"frame_id": frame, "stamp": {"sec": 1, "nanosec": 2}}, "pose": pose}


SAME: dict[str, Callable[[Path], object]] = {
    "own.json": lambda p: p.write_text(json.dumps([{"xyz": XYZ, "wxyz": WXYZ}])),
    "xyzw.json": lambda p: p.write_text(json.dumps([{"xyz": XYZ, "xyzw": [*WXYZ[1:], WXYZ[0]]}])),
    "matrix.json": lambda p: p.write_text(json.dumps([matrix()])),
    "numbers.json": lambda p: p.write_text(json.dumps([[*XYZ, *WXYZ[1:], WXYZ[0]]])),
    "stamped.json": lambda p: p.write_text(json.dumps(ros("map"))),
    "array.yaml": lambda p: p.write_text(
        json.dumps({"header": ros()["header"], "poses": [ros()["pose"]]})
    ),
    "pose.yaml": lambda p: p.write_text(json.dumps(ros()["pose"])),
    "table.csv": lambda p: p.write_text(
        "name, x, y, z, qx, qy, qz, qw\nfirst, 0.5, -1, 1.2, 0.5, -0.5, 0.5, 0.5\n"
    ),
    "four.npy": lambda p: np.save(p, np.array([matrix()])),
    "seven.npz": lambda p: np.savez(p, poses=np.array([[*XYZ, *WXYZ[1:], WXYZ[0]]])),
}


@pytest.mark.parametrize("name", SAME)
def test_every_format_gives_the_same_pose(name: str, tmp_path: Path, room: Scene) -> None:
    path = tmp_path / name
    SAME[name](path)
    (pose,) = load_poses(path, room)
    assert np.allclose(pose.T_world_tool, matrix())
    assert pose.name == ("first" if name == "table.csv" else "pose 1")


def written(tmp_path: Path, value: object, name: str = "poses.json") -> Path:
    path = tmp_path / name
    path.write_text(value if isinstance(value, str) else json.dumps(value))
    return path


def test_poses_move_with_the_object_that_is_their_frame(tmp_path: Path, room: Scene) -> None:
    path = written(tmp_path, {"frame": "table", "poses": [{"xyz": XYZ, "wxyz": WXYZ}]})
    (pose,) = load_poses(path, room)
    assert np.allclose(pose.T_world_tool, room.object("table").T_world_object @ matrix())


def test_poses_move_with_the_part_that_is_their_frame(tmp_path: Path) -> None:
    kitchen = load_scene("kitchen_small")
    path = written(tmp_path, [{"frame": "fridge/door_hinge", "xyz": XYZ, "wxyz": WXYZ}])
    closed, opened = (
        load_poses(path, one)[0].T_world_tool
        for one in (kitchen, kitchen.with_joint("fridge", "door_hinge", 1.0))
    )
    link = kitchen.object("fridge").joint("door_hinge").child
    for T, scene in ((closed, kitchen), (opened, kitchen.with_joint("fridge", "door_hinge", 1.0))):
        assert np.allclose(T, scene.object("fridge").link_poses()[link] @ matrix())


def test_what_holds_for_all_poses_holds_unless_a_pose_says_otherwise(
    tmp_path: Path, room: Scene
) -> None:
    one = {"xyz": XYZ, "wxyz": WXYZ}
    value = {
        "tolerance": {"position": "3mm", "axis": "x", "spin": "180deg"},
        "contact": "table",
        "poses": [one, one | {"tolerance": {"position": [0.1, 0.2, 0.3], "cone": 0.1}}],
    }
    first, second = load_poses(written(tmp_path, value), room)
    assert first.position == (0.003, 0.003, 0.003)
    assert first.spin == second.spin == pytest.approx(math.pi)
    assert second.position == (0.1, 0.2, 0.3)
    assert (first.contact, second.cone) == ("table", 0.1)


def test_a_scaled_quaternion_is_within_a_thousandth(tmp_path: Path, room: Scene) -> None:
    path = written(tmp_path, [{"xyz": XYZ, "wxyz": [1.0005 * one for one in WXYZ]}])
    assert np.allclose(load_poses(path, room)[0].T_world_tool, matrix())


GOOD = {"xyz": XYZ, "wxyz": WXYZ}
WRONG: dict[str, tuple[str, object, str]] = {
    "three numbers": ("a.json", [GOOD, [1, 2, 3]], "pose 2: must be an object"),
    "long quaternion": ("a.json", [GOOD | {"wxyz": [1, 0, 0, 1]}], "pose 1: quaternion has length"),
    "short position": ("a.json", [GOOD, GOOD | {"xyz": [1, 2]}], "pose 2: position must be 3"),
    "unknown frame": ("a.json", [GOOD | {"frame": "tabel"}], "pose 1: no object 'tabel'"),
    "unknown part": ("a.json", [GOOD | {"frame": "table/door"}], "pose 1: no part 'door'"),
    "unknown contact": ("a.json", [GOOD | {"contact": "x"}], "pose 1: no object 'x'"),
    "unknown key": ("a.json", [GOOD | {"foo": 1}], "pose 1: unknown 'foo'"),
    "zero": (
        "a.json",
        [GOOD, GOOD | {"tolerance": {"position": 0, "rotation": 0}}],
        "pose 2: all tolerances are zero",
    ),
    "no axis": ("a.json", [GOOD | {"tolerance": {"spin": 1}}], "need tolerance.axis"),
    "not rigid": ("a.json", [(2 * np.eye(4)).tolist()], "pose 1: the matrix is no rigid"),
    "not finite": ("a.json", '[{"xyz": [NaN, 0, 0], "wxyz": [1, 0, 0, 0]}]', "pose 1: position"),
    "nothing": ("a.json", [], "has no poses"),
    "no list": ("a.json", "3", "must hold a list of poses"),
    "damaged": ("a.json", "{", "damaged JSON"),
    "no column": ("a.csv", "x,y,z\n1,2,3\n", "has no column qx"),
    "short row": ("a.csv", "x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n1,2\n", "pose 2: must have 7"),
    "word": ("a.csv", "x,y,z,qx,qy,qz,qw\n1,2,3,0,0,a,1\n", "pose 1: qz: 'a' is not a value"),
    "kind": ("a.txt", "", r"\.json, \.yaml, \.csv"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_mistake_is_named_with_its_pose(case: str, tmp_path: Path, room: Scene) -> None:
    name, content, words = WRONG[case]
    with pytest.raises(InputError, match=words) as caught:
        load_poses(written(tmp_path, content, name), room)
    assert str(caught.value).startswith(str(tmp_path / name))
    if case.startswith("unknown") and case != "unknown key":
        assert isinstance(caught.value, UnknownNameError)


def test_arrays_hold_numbers_and_no_pickles(tmp_path: Path, room: Scene) -> None:
    path = tmp_path / "a.npy"
    for array, words in (
        (np.zeros((3, 3)), "shape"),
        (np.array([["a"]]), "must hold numbers"),
        (np.array([{}], dtype=object), "not an array of numpy"),
    ):
        np.save(path, array, allow_pickle=True)
        with pytest.raises(FileFormatError, match=words):
            load_poses(path, room)


def test_the_number_of_poses_is_bounded(
    tmp_path: Path, room: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pose_files, "MAX_POSES", 2)
    with pytest.raises(InputError, match="at most 2 are planned"):
        load_poses(written(tmp_path, [GOOD] * 3), room)


def test_poses_of_other_people_are_read(room: Scene) -> None:
    from tests import optional
    from tests.real import CASES

    path = optional.there(CASES / "users/11_pose_list/poses.json")
    poses = load_poses(path, room)
    assert len(poses) == 6
    assert all(isinstance(one, ToolPose) for one in poses)
