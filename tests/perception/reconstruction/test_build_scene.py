"""Scenes from detections have every object in its place, and models open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.perception.reconstruction.fronts import face_of
from tests.real import furniture

from momapos.core.errors import InputError, UnknownNameError
from momapos.core.geometry.polygons import UprightBox
from momapos.core.geometry.transforms import rotation_about
from momapos.model.records.scans import Detection, Part
from momapos.model.scene.library.kitchen_writer import Piece, urdf_text
from momapos.model.scene.model_copies import model_files
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf
from momapos.perception.reconstruction.object_model import furniture_model
from momapos.perception.reconstruction.scene_builder import GivenModel, build_scene, place_model
from momapos.planning.grasps.handles import opening_direction

FLOOR = [(-1.0, -3.0), (3.0, -3.0), (3.0, 1.0), (-1.0, 1.0)]
SOUTH = -np.pi / 2


def found(
    name: str, center: tuple[float, ...], size: tuple[float, ...], yaw: float = 0.0
) -> Detection:
    """Return a detection with its box."""
    box = UprightBox(np.array(center, float), np.array(size, float), yaw)
    return Detection(name, name.rstrip("_0123456789"), 0.9, box, np.arange(3))


FRIDGE = found("fridge", (0.3, 0.0, 0.9), (0.6, 0.65, 1.8))
TABLE = found("table_2", (2.0, -1.0, 0.36), (1.2, 0.8, 0.72), 0.4)
CUP = found("cup", (2.0, -1.0, 0.77), (0.08, 0.08, 0.1))


def fridge_model() -> Piece:
    """Return a fridge with one door, hinged on the right."""
    door = Part("door_right", (0.0, 0.0, 1.0, 1.0), 0.9, (0.06, 0.3, 0.1, 0.6))
    return furniture_model(FRIDGE, SOUTH, face_of(0.6, 1.8), [door])


@pytest.fixture
def given(tmp_path: Path) -> Path:
    """Return the URDF of that fridge, as a user's file."""
    path = tmp_path / "given" / "theirs.urdf"
    path.parent.mkdir()
    path.write_text(urdf_text(fridge_model()))
    return path


def test_a_scene_has_every_detection_in_its_box_and_its_models_open(tmp_path: Path) -> None:
    detections = [FRIDGE, TABLE, CUP]
    models = {"fridge": fridge_model()}
    out = build_scene(detections, models, FLOOR, tmp_path / "room.json", start=(1.0, -2.0, 0.5))
    scene = load_scene(out)
    assert scene.warnings == ()
    assert [item.name for item in scene.objects] == ["fridge", "table_2", "cup"]
    assert [item.category for item in scene.objects] == ["fridge", "table", "cup"]
    for detection, item in zip(detections, scene.objects, strict=True):
        box = detection.box
        corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), -1).reshape(-1, 3) * box.size
        R = rotation_about(np.array([0.0, 0.0, 1.0]), box.yaw)
        points = corners @ R.T + box.center
        low, high = item.bounds - np.stack([points.min(0), points.max(0)])
        out_of_front = 0.04 if detection is FRIDGE else 0.0
        np.testing.assert_allclose(low, [0.0, -out_of_front, 0.0], atol=1e-3)
        np.testing.assert_allclose(high, 0.0, atol=1e-3)
    assert list(scene.object("fridge").model.joints) == ["door_hinge"]
    np.testing.assert_allclose(scene.floor_polygon, FLOOR)
    np.testing.assert_allclose(scene.start, (1.0, -2.0, 0.5))


def test_a_room_without_known_floor_or_start_has_neither(tmp_path: Path) -> None:
    scene = load_scene(build_scene([CUP], {}, None, tmp_path / "room.json"))
    assert scene.floor_polygon is None
    assert scene.start is None


def test_the_same_detections_overwrite_the_scene_with_the_same_bytes(
    tmp_path: Path, given: Path
) -> None:
    def files() -> dict[Path, bytes]:
        return {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}

    other, _ = place_model(CUP, 0.0, GivenModel(given))
    models = {"fridge": fridge_model(), "cup": other}
    build_scene([FRIDGE, CUP], models, FLOOR, tmp_path / "room.json")
    before = files()
    build_scene([FRIDGE, CUP], models, FLOOR, tmp_path / "room.json")
    assert files() == before
    build_scene([FRIDGE, CUP], {}, FLOOR, tmp_path / "room.json")
    assert not list((tmp_path / "room_urdf").iterdir())


@pytest.mark.parametrize("name", ["../fridge", "a/b", "", 'x"><link name="y', "n" * 81, ".."])
def test_an_invalid_file_name_is_refused_and_nothing_is_written(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a valid file name"):
        build_scene([found(name, (0, 0, 0), (1, 1, 1))], {}, FLOOR, tmp_path / "room.json")
    assert not list(tmp_path.iterdir())


def test_models_of_unknown_objects_and_duplicate_names_are_refused(tmp_path: Path) -> None:
    out = tmp_path / "room.json"
    with pytest.raises(UnknownNameError, match="fridge"):
        build_scene([CUP], {"fridge": fridge_model()}, FLOOR, out)
    with pytest.raises(InputError, match="two objects are named"):
        build_scene([CUP, CUP], {}, FLOOR, out)
    with pytest.raises(InputError, match="must agree"):
        build_scene([CUP], {"cup": fridge_model()}, FLOOR, out)
    assert not out.exists()


@pytest.mark.parametrize("quarter", range(4))
@pytest.mark.parametrize("up", ["z", "y"])
def test_a_given_model_is_scaled_to_the_box_with_its_front_on_the_given_side(
    quarter: int, up: str, given: Path
) -> None:
    if up == "y":  # turned about x, so that what was up points along y
        text = given.read_text().replace(
            '<link name="body">', '<link name="root"/><link name="body">'
        )
        mount = (
            '<joint name="lie" type="fixed"><parent link="root"/><child link="body"/>'
            '<origin rpy="-1.5707963267948966 0 0"/></joint></robot>'
        )
        given.write_text(text.replace("</robot>", mount))
    model = Articulated(read_urdf(given))
    box = model_bounds(model)
    size = box[1] - box[0]
    width, depth, height = 1.2 * (size if up == "z" else size[[0, 2, 1]])
    sides = (depth, width, height) if quarter % 2 == 0 else (width, depth, height)
    target = found("fridge", (1.0, 2.0, 1.1), sides, 0.2)
    facing = 0.2 + quarter * np.pi / 2
    item, warnings = place_model(target, facing, GivenModel(given, up))  # type: ignore[arg-type]
    assert warnings == ()
    assert item.model.urdf.scale == pytest.approx(1.2)
    R = rotation_about(np.array([0.0, 0.0, 1.0]), 0.2)
    local = (item.vertices - target.box.center) @ R
    np.testing.assert_allclose(local.min(0), -np.array(sides) / 2, atol=1e-6)
    np.testing.assert_allclose(local.max(0), np.array(sides) / 2, atol=1e-6)
    _, direction = opening_direction(item, "door_hinge")
    assert direction @ [np.cos(facing), np.sin(facing), 0.0] > 0.95


def model_bounds(model: Articulated) -> np.ndarray:
    """Return the lowest and highest corner of a model at rest, in its root's frame [m]."""
    poses = model.rest_poses
    points = np.concatenate(
        [h.vertices @ T[:3, :3].T + T[:3, 3] for n, T in poses.items() for h in model.hulls[n]]
    )
    return np.stack([points.min(0), points.max(0)])


def test_a_given_model_of_other_proportions_is_placed_with_a_warning(given: Path) -> None:
    wide = found("fridge", (0.0, 0.0, 0.9), (0.9, 0.65, 1.8))
    item, warnings = place_model(wide, SOUTH, GivenModel(given))
    assert len(warnings) == 1
    assert str(given) in warnings[0]
    size = np.diff(item.bounds, axis=0)[0]
    ratios = size / wide.box.size
    assert ratios.max() * ratios.min() == pytest.approx(1.0)


def test_a_given_model_without_joints_needs_a_front(tmp_path: Path) -> None:
    path = tmp_path / "box.urdf"
    path.write_text(
        '<robot name="b"><link name="l"><collision><geometry><box size="1 2 3"/></geometry>'
        "</collision></link></robot>"
    )
    with pytest.raises(InputError, match="its front is unknown"):
        place_model(FRIDGE, SOUTH, GivenModel(path))
    item, _ = place_model(found("b", (0, 0, 3), (4, 2, 6)), SOUTH, GivenModel(path, front=0.0))
    np.testing.assert_allclose(item.bounds, [[-2, -1, 0], [2, 1, 6]], atol=1e-9)


@pytest.mark.parametrize(("name", "count"), [("kitchen_small/fridge", 1), ("Fridge/10144", 2)])
def test_a_given_fridge_fills_its_box_and_its_files_are_next_to_the_scene(
    name: str, count: int, tmp_path: Path
) -> None:
    item, _ = place_model(FRIDGE, SOUTH, GivenModel(furniture(name)))
    out = build_scene([FRIDGE, CUP], {"fridge": item}, FLOOR, tmp_path / "room.json")
    again = load_scene(out).object("fridge")
    np.testing.assert_allclose(again.bounds, item.bounds, atol=1e-4)
    files = model_files(again.model)
    assert len(files) == len(model_files(item.model)) >= count
    assert all(file.resolve().is_relative_to(tmp_path / "room_urdf") for file in files)
    joint = max(again.model.joints.values(), key=lambda joint: joint.upper - joint.lower)
    assert opening_direction(again, joint.name)[1] @ [0.0, -1.0, 0.0] > 0.8
