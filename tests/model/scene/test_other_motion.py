"""Objects with another motion of a part than their URDF."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.verification.door_case import cupboard_urdf

from momapos.core.errors import SceneError
from momapos.core.geometry.transforms import apply, pose, rotation_about
from momapos.model.records.scans import Hypothesis
from momapos.model.scene.other_motion import (
    save_with_part_motion,
    scene_with_hypothesis,
    scene_with_part_motion,
    with_part_motion,
)
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import opening_of

WAYS = (
    Hypothesis("door_right", 0.5, (-0.215, 0.29, 0.1), (0.0, 0.0, -1.0), 1.3),
    Hypothesis("door_down", 0.3, (-0.2, 0.0, -0.39), (0.0, -1.0, 0.0), 1.5),
    Hypothesis("drawer", 0.2, (0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 0.3),
)


def cupboard(folder: Path, text: str | None = None, *, scale: float = 1.0) -> SceneObject:
    (folder / "cupboard.urdf").write_text(text or cupboard_urdf())
    return SceneObject.from_urdf(
        "cupboard", folder / "cupboard.urdf", (0.4, 0.1, 0.8), yaw=0.3, scale=scale
    )


def points(item: SceneObject, values: dict[str, float]) -> np.ndarray:
    """Return the vertices of what the hinge moves, in the world."""
    poses = item.link_poses(values)
    links = item.model.moved_by("hinge")
    return np.concatenate([apply(poses[n], h.vertices) for n in links for h in item.model.hulls[n]])


@pytest.mark.parametrize("scale", [1.0, 0.5])
@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.kind)
def test_a_part_looks_the_same_while_closed_and_opens_about_the_other_axis(
    tmp_path: Path, way: Hypothesis, scale: float
) -> None:
    item = cupboard(tmp_path, scale=scale)
    other = with_part_motion(item, "hinge", way)
    np.testing.assert_allclose(
        points(other, {"hinge": 0.0}), points(item, {"hinge": 0.0}), atol=1e-6
    )
    opening = opening_of(other.model, "hinge")
    assert (opening.closed, opening.wide) == (0.0, pytest.approx(way.upper))
    value = way.upper / 2
    T = pose(value * np.array(way.axis))
    if way.kind != "drawer":
        R, point = rotation_about(np.array(way.axis), np.array(value)), np.array(way.point)
        T = pose(point - R @ point, R)
    T = item.T_world_object @ T @ np.linalg.inv(item.T_world_object)
    expected = apply(T, points(item, {"hinge": 0.0}))
    np.testing.assert_allclose(points(other, {"hinge": value}), expected, atol=1e-6)


def test_a_drawer_that_becomes_hinged_loses_only_its_tray(tmp_path: Path) -> None:
    tray = '<collision><origin xyz="0.2 0.29 0"/><geometry><box size="0.36 0.5 0.7"/></geometry>'
    text = cupboard_urdf().replace('<link name="handle">', "@", 1)
    text = text.replace(
        "</collision></link>\n@", f'</collision>{tray}</collision></link>\n<link name="handle">'
    )
    text = text.replace('type="revolute"', 'type="prismatic"').replace(
        '<axis xyz="0 0 1"/>', '<axis xyz="-1 0 0"/>'
    )
    item = cupboard(tmp_path, text)
    assert len(item.model.hulls["door"]) == 2
    other = with_part_motion(item, "hinge", WAYS[0])
    assert len(other.model.hulls["door"]) == 1
    assert len(other.model.hulls["handle"]) == 1
    same = with_part_motion(item, "hinge", WAYS[2])
    assert len(same.model.hulls["door"]) == 2


def test_the_scene_file_contains_the_found_joint_and_its_value(tmp_path: Path) -> None:
    item = cupboard(tmp_path)
    other = SceneObject("other", "", pose((3.0, 0.0, 0.8)), item.model)
    scene = save_scene(Scene("room", (item, other)), tmp_path / "room.json")
    out = tmp_path / "elsewhere" / "learned.json"
    save_with_part_motion(scene, "cupboard", "hinge", WAYS[0], 0.7, out)
    again = load_scene(out)
    found = again.object("cupboard")
    assert found.values()["hinge"] == pytest.approx(0.7)
    ((known,),) = found.hypotheses.values()
    assert (known.kind, known.probability) == ("door_right", 1.0)
    expected = points(with_part_motion(item, "hinge", WAYS[0]), {"hinge": 0.7})
    np.testing.assert_allclose(points(found, {"hinge": 0.7}), expected, atol=1e-6)
    assert again.object("other").model.joint("hinge").upper == pytest.approx(1.2)
    with pytest.raises(SceneError, match="exists already"):
        save_with_part_motion(scene, "cupboard", "hinge", WAYS[0], 0.7, out)
    with pytest.raises(SceneError, match="exists already"):
        save_with_part_motion(scene, "cupboard", "hinge", WAYS[0], 0.7, scene.path or out)


def test_a_coupled_joint_cannot_be_replaced(tmp_path: Path) -> None:
    text = cupboard_urdf().replace(
        "</robot>",
        '<link name="flap"/><joint name="follower" type="revolute"><parent link="body"/>'
        '<child link="flap"/><axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1"'
        ' velocity="1"/><mimic joint="hinge"/></joint></robot>',
    )
    item = cupboard(tmp_path, text)
    with pytest.raises(SceneError, match="hinge is coupled to other joints"):
        with_part_motion(item, "hinge", WAYS[0])


def test_a_replaced_part_is_closed(tmp_path: Path) -> None:
    item = cupboard(tmp_path)
    scene = Scene("room", (item,)).with_joint("cupboard", "hinge", 0.4)
    other = scene_with_part_motion(scene, "cupboard", "hinge", WAYS[2])
    assert other.object("cupboard").values()["hinge"] == 0.0
    assert other.joints_set["cupboard"] == {}


def believed(folder: Path) -> Scene:
    item = replace(cupboard(folder), hypotheses={"hinge": WAYS})
    return save_scene(Scene("room", (item,)), folder / "room.json")


def test_a_chosen_hypothesis_rules_out_more_probable_ones_and_is_recorded(tmp_path: Path) -> None:
    scene = believed(tmp_path)
    taken = scene_with_hypothesis(scene, "cupboard", "hinge", 1)
    item = taken.object("cupboard")
    assert [way.kind for way in item.hypotheses["hinge"]] == ["door_down", "drawer"]
    assert [way.probability for way in item.hypotheses["hinge"]] == pytest.approx([0.6, 0.4])
    expected = points(with_part_motion(scene.object("cupboard"), "hinge", WAYS[1]), {"hinge": 0.5})
    np.testing.assert_allclose(points(item, {"hinge": 0.5}), expected, atol=1e-9)
    assert taken.hypotheses_set == {"cupboard": {"hinge": 1}}
    # Choosing twice counts from the file and moves the part as choosing once does.
    last = scene_with_hypothesis(taken, "cupboard", "hinge", 1)
    assert last.hypotheses_set == {"cupboard": {"hinge": 2}}
    expected = points(with_part_motion(scene.object("cupboard"), "hinge", WAYS[2]), {"hinge": 0.2})
    np.testing.assert_allclose(points(last.object("cupboard"), {"hinge": 0.2}), expected, atol=1e-9)


def test_a_scene_with_a_chosen_hypothesis_is_saved_with_the_learned_motion(tmp_path: Path) -> None:
    scene = believed(tmp_path)
    taken = scene_with_hypothesis(scene, "cupboard", "hinge", 1)
    out = tmp_path / "elsewhere" / "learned.json"
    save_with_part_motion(taken, "cupboard", "hinge", WAYS[1], 0.5, out)
    expected = points(with_part_motion(scene.object("cupboard"), "hinge", WAYS[1]), {"hinge": 0.5})
    found = load_scene(out).object("cupboard")
    np.testing.assert_allclose(points(found, {"hinge": 0.5}), expected, atol=1e-6)


def test_a_missing_hypothesis_is_refused(tmp_path: Path) -> None:
    scene = believed(tmp_path)
    for index in (-1, 3):
        with pytest.raises(SceneError, match=f"cupboard/hinge: no hypothesis {index}; it has 3"):
            scene_with_hypothesis(scene, "cupboard", "hinge", index)
    with pytest.raises(SceneError, match="cupboard/lid: no hypothesis 0; it has 0"):
        scene_with_hypothesis(scene, "cupboard", "lid", 0)
