"""BestMan scenes match the measurements of a physics engine."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests import optional
from tests.real import DATA

from momapos.core.errors import FileFormatError, SceneError, UrdfError
from momapos.model.scene.bestman import category_of, number
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject

BESTMAN = DATA / "bestman"
SCENES = (
    "Asset/Scene/Scene/Kitchen.json",
    "Asset/Scene/Scene/Kitchen_1.json",
    "Asset/Scene/Scene/Kitchen_anygrasp.json",
    "Asset/Scene/Scene/b512.json",
    "derived/MoMa_Kitchen.json",
    "derived/kitchen_v2.json",
)
TOLERANCE = 0.005
"""[m]; the engine's boxes have a margin of 1 to 3 mm."""
needs_data = optional.needs("real data", BESTMAN.is_dir())
CUBE = '<robot name="c"><link name="c"><collision><geometry><box size="1 1 1"/></geometry></collision></link></robot>'  # noqa: E501


def measured(scene: str) -> dict[str, dict[str, Any]]:
    """Return the measurements of the physics engine by object."""
    data = json.loads((BESTMAN / "derived" / "scene_articulations.json").read_text())
    return {item["name"]: item for item in data[scene.removeprefix("Asset/Scene/Scene/")]}


def bounds_of(item: SceneObject, links: tuple[str, ...]) -> np.ndarray:
    """Return the world-aligned bounding box of links at rest."""
    poses = item.link_poses()
    points = np.concatenate([
        hull.vertices @ poses[link][:3, :3].T + poses[link][:3, 3]
        for link in links
        for hull in item.model.hulls[link]
    ])  # fmt: skip
    return np.stack([points.min(0), points.max(0)])


@pytest.fixture(scope="module", params=SCENES)
def pair(request: pytest.FixtureRequest) -> tuple[Scene, dict[str, dict[str, Any]]]:
    # The engine knows no drawn shapes.
    scene = load_scene(optional.there(BESTMAN / request.param), visual_collisions=False)
    return scene, measured(request.param)


def test_object_bounds_match_the_engine(pair: tuple[Scene, dict]) -> None:
    scene, truth = pair
    assert [item.name for item in scene.objects] == list(truth)
    for item in scene.objects:
        if "aabb" in truth[item.name]:
            assert_allclose(item.bounds, truth[item.name]["aabb"], atol=TOLERANCE)


def test_joints_match_the_engine(pair: tuple[Scene, dict]) -> None:
    scene, truth = pair
    for item in scene.objects:
        poses = item.link_poses()
        rows = truth[item.name].get("joints", [])
        assert set(item.model.joints) == {row["name"] for row in rows}
        for row in rows:
            joint = item.model.joint(row["name"])
            assert (joint.kind, joint.child) == (row["type"], row["child"])
            if joint.kind != "continuous":
                limits = (row["lower"], row["upper"])
                assert_allclose((joint.lower, joint.upper), limits, atol=1e-3)
            T = poses[joint.parent] @ joint.T_parent_joint
            assert_allclose(T[:3, :3] @ joint.axis, row["world_axis"], atol=2e-3)
            assert_allclose(T[:3, 3], row["world_origin"], atol=TOLERANCE)


def test_bounds_of_moving_parts_and_handles_match_the_engine(pair: tuple[Scene, dict]) -> None:
    scene, truth = pair
    for item in scene.objects:
        for row in truth[item.name].get("joints", []):
            moving = item.model.moved_by(row["name"])
            part = bounds_of(item, tuple(link for link in moving if item.model.hulls[link]))
            assert_allclose(part, row["moving_part_aabb_closed"], atol=TOLERANCE)
            for handle in row.get("handle_link_aabb_closed", []):
                assert handle["link"] in moving
                box = bounds_of(item, (handle["link"],))
                assert_allclose(box, (handle["min"], handle["max"]), atol=TOLERANCE)


@needs_data
def test_boxes_for_missing_models_rest_on_what_is_below_them() -> None:
    scene = load_scene(BESTMAN / "derived/kitchen_v2.json", visual_collisions=False)
    table = scene.object("elementF").bounds[1, 2]
    assert len(scene.warnings) == 8
    assert any("'Peach'" in text and "7.7 x 7.5 x 7.1 cm" in text for text in scene.warnings)
    for name in ("Peach", "Banana", "Bread", "Lemon"):
        low, high = scene.object(name).bounds
        assert low[2] == pytest.approx(table, abs=1e-6)
        assert 0.03 < high[2] - low[2] < 0.08
    # upside down, and under a wall cabinet that it must not climb
    assert scene.object("pudding_box").bounds[0, 2] == pytest.approx(0.93, abs=0.02)


def _write(folder: Path, items: list[dict[str, Any]]) -> Path:
    (folder / "Asset").mkdir(exist_ok=True)
    (folder / "Asset" / "cube.urdf").write_text(CUBE)
    path = folder / "Asset" / "room.json"
    path.write_text(json.dumps(items))
    return path


def _item(name: str, **changes: Any) -> dict[str, Any]:
    return {
        "obj_name": name,
        "model_path": "Asset/cube.urdf",
        "object_position": [0, 0, 0.5],
        "object_orientation": [0, 0, 0],
        "scale": 1.0,
        "fixed_base": True,
        **changes,
    }


def test_orientation_is_roll_pitch_yaw_and_may_be_arithmetic(tmp_path: Path) -> None:
    path = _write(tmp_path, [_item("a", object_orientation=[0, 0, "math.pi / 2 * 3"], scale="2")])
    item = load_scene(path).object("a")
    assert_allclose(item.T_world_object[:3, 0], [0, -1, 0], atol=1e-12)
    assert_allclose(item.bounds, [[-1, -1, -0.5], [1, 1, 1.5]], atol=1e-9)


def test_objects_of_one_file_and_scale_share_their_model(tmp_path: Path) -> None:
    scene = load_scene(_write(tmp_path, [_item("a"), _item("b"), _item("c", scale=2)]))
    a, b, c = (item.model for item in scene.objects)
    assert a is b
    assert c is not a


def test_a_missing_model_of_unknown_size_is_a_small_cube_on_the_floor(tmp_path: Path) -> None:
    scene = load_scene(
        _write(
            tmp_path,
            [
                _item("cup", model_path="Asset/cup/model.urdf", fixed_base=False),
                _item("lamp", model_path="Asset/lamp/model.urdf", object_position=[1, 0, 2]),
            ],
        )
    )
    assert_allclose(scene.object("cup").bounds, [[-0.04, -0.04, 0], [0.04, 0.04, 0.08]], atol=1e-9)
    assert scene.object("lamp").bounds.mean(0)[2] == pytest.approx(2.0), (
        "fixed objects stay at their position"
    )
    assert len(scene.warnings) == 2
    assert "unknown size" in scene.warnings[0]
    assert (scene.floor_polygon, scene.start) == (None, None)


def test_the_root_is_found_in_the_parents_or_given(tmp_path: Path) -> None:
    path = _write(tmp_path, [_item("a")])
    other = tmp_path / "elsewhere"
    other.mkdir()
    assert load_scene(path, root=tmp_path).objects[0].name == "a"
    moved = other / "room.json"
    moved.write_text(path.read_text())
    assert load_scene(moved).objects[0].name == "a"
    (tmp_path / "Asset").rename(tmp_path / "Things")
    with pytest.raises(FileFormatError, match="'Asset'"):
        load_scene(moved)


def test_a_missing_mesh_of_an_existing_urdf_is_an_error(tmp_path: Path) -> None:
    path = _write(tmp_path, [_item("a")])
    cube = tmp_path / "Asset" / "cube.urdf"
    cube.write_text(CUBE.replace('<box size="1 1 1"/>', '<mesh filename="gone.obj"/>'))
    with pytest.raises(UrdfError, match=r"gone\.obj"):
        load_scene(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"object_position": [0, 0]}, "object_position must be a list of 3"),
        ({"object_position": [0, 0, "wide"]}, "object_position"),
        ({"object_orientation": [0, 0, "9**9**9"]}, "exponent"),
        ({"scale": 0}, "scale"),
        ({"scale": "math.inf"}, "scale"),
        ({"model_path": "../../etc/passwd"}, "leaves"),
        ({"model_path": 3}, "model_path must be printable"),
    ],
)
def test_a_wrong_entry_is_named(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        load_scene(_write(tmp_path, [_item("fine"), _item("bad", **change)]))


def test_duplicate_names_are_refused_with_both_places(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="objects 0 and 2 are both named 'a'"):
        load_scene(_write(tmp_path, [_item("a"), _item("b"), _item("a")]))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("math.pi", np.pi),
        ("-math.pi/3", -np.pi / 3),
        ("math.pi / 2 * 3", 1.5 * np.pi),
        ("(1 + 2) * -2", -6.0),
        ("2 ** 3", 8.0),
        ("np.pi", np.pi),
        (" 1.5 ", 1.5),
        (7, 7.0),
    ],
)
def test_arithmetic_has_its_value(text: object, value: float) -> None:
    assert number(text) == pytest.approx(value)


@pytest.mark.parametrize(
    "text",
    [
        "9**9**9", "9.0**(9**9)", "2**1000", "1/0", "1e400", "nan", "__import__('os')", "().x",
        "math.exp(1)", "os.pi", "x", "1 if 1 else 2", "[1]", "'a'", "True", "", "1;2", "1j",
        "(-1)**0.5", "1" + "+1" * 50, "-" * 100 + "1", "(" * 99, "1" * 300, "\0",
        "1(2)", True, None, [1], float("nan"), 10**400,
    ],
)  # fmt: skip
def test_everything_else_is_refused(text: object) -> None:
    with pytest.raises(ValueError, match=r"^.+$") as caught:
        number(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "path", "category"),
    [
        ("elementE", "Kitchen_models/models/Fridge/10144/mobility.urdf", "fridge"),
        ("x", "models/MiniFridgeBase/45746/mobility.urdf", "fridge"),
        ("microwave", "models/Unknown/7128/mobility.urdf", "microwave"),
        ("Mic", "URDF_models/B512/Mic/Mic.urdf", "microwave"),
        ("elementA", "models_yan/elementA/urdf/kitchen_part_right_gen_convex.urdf", "cabinet"),
        ("elementB1", "models_yan/elementB/model.urdf", "counter"),
        ("Bowl_Target", "URDF_models/utensil_bowl_blue/model.urdf", "bowl"),
        ("a", "URDF_models/orange_cup/model.urdf", "cup"),
        ("a", "URDF_models/plastic_orange/model.urdf", "orange"),
        ("remote_1", "URDF_models/remote_controller_1/model.urdf", "remote controller"),
    ],
)
def test_categories_come_from_names_and_paths(name: str, path: str, category: str) -> None:
    assert category_of(name, path) == category
