"""Furniture is read as it is drawn: visual shapes stand in for missing collision shapes."""

from __future__ import annotations

from pathlib import Path

import pytest
import tests.meshes as given
from tests import optional
from tests.cupboards import joint
from tests.real import CASES

from momapos.core.cache import Cache
from momapos.core.errors import UrdfError
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.furniture import read_furniture
from momapos.model.urdf.hulls import hull_of
from momapos.model.urdf.reader import read_urdf

BOX = '<geometry><box size="0.5 0.5 0.5"/></geometry>'
SOLID, DRAWN = f"<collision>{BOX}</collision>", f"<visual>{BOX}</visual>"
HINGE = joint("hinge", "revolute", ("body", "door"), (0, 0, 0), (0, 0, 1), (0, 1))


def fixed(parent: str, child: str) -> str:
    return (
        f'<joint name="{parent}_{child}" type="fixed"><parent link="{parent}"/>'
        f'<child link="{child}"/></joint>'
    )


def written(folder: Path, *parts: str) -> Path:
    path = folder / "model.urdf"
    path.write_text(f'<robot name="a">{"".join(parts)}</robot>')
    return path


def link(name: str, *shapes: str) -> str:
    return f'<link name="{name}">{"".join(shapes)}</link>'


def mesh(name: str, tag: str = "visual") -> str:
    return f'<{tag}><geometry><mesh filename="{name}"/></geometry></{tag}>'


@pytest.mark.parametrize(
    ("parts", "bare"),
    [
        ((link("body", DRAWN),), ["body"]),
        ((link("body", SOLID), link("door", DRAWN), HINGE), ["door"]),
        ((link("body", DRAWN), link("door", DRAWN), HINGE), ["body", "door"]),
        ((link("body", DRAWN), link("door", SOLID), HINGE), ["body"]),
        # A decal on a link that has a collision shape is only drawn.
        ((link("body", SOLID), link("decal", DRAWN), fixed("body", "decal")), []),
        ((link("body", DRAWN), link("frame", SOLID), fixed("body", "frame")), []),
        # A body of several links without any collision shape.
        ((link("body"), link("top", DRAWN), fixed("body", "top")), ["top"]),
        ((link("body", SOLID), link("door", SOLID), HINGE), []),
    ],
)
def test_visual_shapes_stand_in_for_bodies_without_collision_shapes(
    tmp_path: Path, parts: tuple[str, ...], bare: list[str]
) -> None:
    path = written(tmp_path, *parts)
    plain, found = read_urdf(path), read_furniture(path)
    for name, record in found.links.items():
        given_shapes = plain.links[name].collisions
        assert len(record.collisions) == (1 if name in bare else len(given_shapes))
        assert not (name in bare and given_shapes)
    assert len(found.notes) == bool(bare)
    assert all(str(path) in note and repr(name) in note for note in found.notes for name in bare)
    if bare:
        with pytest.raises(UrdfError, match=f"no collision shapes of .*{bare[0]}"):
            read_furniture(path, visual_collisions=False)


def test_a_scene_warns_once_per_file_and_can_refuse(tmp_path: Path) -> None:
    path = written(tmp_path, link("body", DRAWN))
    entry = '{"name": "%s", "urdf": "model.urdf", "pose": {"xyz": [%d, 0, 0]}}'
    scene = tmp_path / "scene.json"
    objects = ", ".join(entry % (name, 2 * x) for x, name in enumerate("ab"))
    scene.write_text(f'{{"format": "momapos-scene", "version": 1, "objects": [{objects}]}}')
    room = load_scene(scene, cache=Cache(tmp_path / "cache"))
    assert len([text for text in room.warnings if "visual shapes" in text]) == 1
    assert len(room.objects[0].static_boxes["body"]) == 1
    with pytest.raises(UrdfError, match="no collision shapes"):
        load_scene(scene, visual_collisions=False)
    assert SceneObject.from_urdf("a", path, (0, 0, 0)).model.urdf.notes
    with pytest.raises(UrdfError, match="no collision shapes"):
        SceneObject.from_urdf("a", path, (0, 0, 0), visual_collisions=False)


def damaged(folder: Path, name: str) -> str:
    (folder / name).write_bytes(b"v 1 2\nv nan")
    return name


@pytest.mark.parametrize(
    "lost", ["no.obj", "package://absent/no.dae", "bad.obj", "bad.stl", "a.3ds"]
)
def test_a_visual_mesh_that_cannot_be_read_is_left_out(tmp_path: Path, lost: str) -> None:
    if "no." not in lost:
        damaged(tmp_path, lost)
    path = written(tmp_path, link("body", SOLID, DRAWN, mesh(lost)))
    for _ in range(2):  # the second time from the cache
        found = read_furniture(path, cache=Cache(tmp_path / "cache"))
        assert len(found.links["body"].visuals) == len(found.links["body"].collisions) == 1
        assert [Path(lost).name in note for note in found.notes] == [True]


def test_a_lost_visual_mesh_is_an_error_if_nothing_else_shows_its_body(tmp_path: Path) -> None:
    parts = link("body", SOLID), link("door", mesh("no.obj")), HINGE
    with pytest.raises(UrdfError, match=r"no\.obj.*does not exist"):
        read_furniture(written(tmp_path, *parts))


def test_a_lost_collision_mesh_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UrdfError, match=r"no\.obj.*does not exist"):
        read_furniture(written(tmp_path, link("body", mesh("no.obj", "collision"), DRAWN)))


def test_a_package_that_exists_is_not_blamed_for_a_lost_mesh(tmp_path: Path) -> None:
    folder = tmp_path / "kitchen-1.0"
    folder.mkdir()
    (folder / "package.xml").write_text("<package><name>kitchen</name></package>")
    path = written(tmp_path, link("body", mesh("package://kitchen/a.obj", "collision")))
    with pytest.raises(UrdfError, match=r"'a\.obj' does not exist in the package .*kitchen-1\.0"):
        read_furniture(path)
    given.write_obj(folder / "a.obj", given.triangles_of((given.PANEL,)))
    assert read_furniture(path).links["body"].collisions[0].mesh == (folder / "a.obj").resolve()


def box(tag: str, size: str, xyz: str = "0 0 0") -> str:
    origin, shape = f'<origin xyz="{xyz}"/>', f'<geometry><box size="{size}"/></geometry>'
    return f"<{tag}>{origin}{shape}</{tag}>"


@pytest.mark.parametrize(
    ("drawn", "solid", "added"),
    [
        # Only the handle of a door collides.
        (box("visual", "0.02 0.5 0.7"), box("collision", "0.02 0.02 0.2", "0.05 0.2 0"), True),
        # A simplified front: a knob of 2 cm is not worth it, a bar of 6 cm is.
        (box("visual", "0.02 0.03 0.03", "0.02 0 0"), box("collision", "0.02 0.5 0.7"), False),
        (box("visual", "0.01 0.3 0.01", "0.06 0 0"), box("collision", "0.02 0.5 0.7"), True),
        # What is drawn in the middle, between collision shapes at both ends.
        (
            box("visual", "0.02 1.0 0.1"),
            box("collision", "0.02 0.1 0.1", "0 0.45 0")
            + box("collision", "0.02 0.1 0.1", "0 -0.45 0"),
            True,
        ),
        (box("visual", "0.02 0.5 0.7"), box("collision", "0.02 0.46 0.66"), False),
    ],
)
def test_drawn_shapes_that_collision_shapes_miss_are_added(
    drawn: str, solid: str, added: bool, tmp_path: Path
) -> None:
    path = written(tmp_path, link("body", SOLID), link("door", drawn, solid), HINGE)
    urdf = read_furniture(path)
    door = urdf.links["door"]
    assert len(door.collisions) == solid.count("<collision>") + added
    assert [("'door' miss up to" in note) for note in urdf.notes] == [True] * added
    assert (
        len(read_furniture(path, visual_collisions=False).links["door"].collisions)
        == len(door.collisions) - added
    )


def test_shapes_of_links_that_are_fixed_together_cover_each_other(tmp_path: Path) -> None:
    shifted = fixed("body", "shell").replace("<parent", '<origin xyz="0.3 0 0"/><parent')
    cover = box("collision", "0.5 0.5 0.5", "-0.3 0 0")
    assert not read_furniture(
        written(tmp_path, link("body", DRAWN), link("shell", cover), shifted)
    ).notes
    elsewhere = box("collision", "0.5 0.5 0.5", "0.3 0 0")
    parts = link("body", DRAWN), link("shell", elsewhere), shifted
    urdf = read_furniture(written(tmp_path, *parts))
    assert len(urdf.links["body"].collisions) == 1
    assert urdf.links["shell"].collisions[0].size == (0.5, 0.5, 0.5)


def test_only_the_missed_pieces_of_a_drawn_mesh_are_added(tmp_path: Path) -> None:
    """The hull of a drawn tray with a front would fill the tray."""
    front = ((-0.02, -0.3, 0.0), (0.0, 0.3, 0.3))
    bottom = ((0.0, -0.3, 0.0), (0.5, 0.3, 0.02))
    given.write_obj(tmp_path / "tray.obj", given.triangles_of((front, bottom)))
    solid = box("collision", "0.02 0.6 0.3", "-0.01 0 0.15")
    path = written(tmp_path, link("body", mesh("tray.obj"), solid))
    pieces = read_furniture(path, cache=Cache(tmp_path / "cache")).links["body"].collisions[1:]
    again = read_furniture(path, cache=Cache(tmp_path / "cache")).links["body"].collisions[1:]
    assert pieces
    for shape, other in zip(pieces, again, strict=True):
        low, high = hull_of(shape).vertices.min(0), hull_of(shape).vertices.max(0)
        assert high[0] == pytest.approx(0.5, abs=1e-3)
        assert high[2] - low[2] < 0.05
        assert (hull_of(other).vertices == hull_of(shape).vertices).all()


def test_visual_shapes_of_a_robot_do_not_collide(tmp_path: Path) -> None:
    path = written(tmp_path, link("body", DRAWN))
    assert not read_urdf(path).links["body"].collisions


CASES_DRAWN = {
    "furniture/vtable.json": ("table", "top"),
    "furniture/visual_only.json": ("cupboard", "door"),
    "furniture/vdoor.json": ("cupboard", "door"),
    "rooms/ghost.json": ("fridge", "freezer"),
    "rooms/visual.json": ("fridge", "body"),
}


@pytest.mark.parametrize("name", CASES_DRAWN)
def test_public_furniture_that_is_only_drawn_is_solid(name: str) -> None:
    scene, (item, link_name) = load_scene(optional.there(CASES / name)), CASES_DRAWN[name]
    assert len(scene.object(item).static_boxes[link_name])
    assert [link_name in text for text in scene.warnings if "visual shapes" in text] == [True]


def test_a_public_case_with_a_lost_visual_mesh_is_read() -> None:
    scene = load_scene(optional.there(CASES / "furniture/lost_visual.json"))
    assert any("logo.dae" in text and "in the package" in text for text in scene.warnings)
