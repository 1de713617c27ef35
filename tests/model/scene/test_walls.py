"""Walls of a room: solid boxes outside of the floor, in scene files and back."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.commands import error_of

from momapos.core.errors import SceneError
from momapos.core.geometry.polygons import contains, edge_distances
from momapos.model.scene.formats.importing import write_mjcf
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject, Wall, walls_around

SQUARE = [[0, 0], [4, 0], [4, 3], [0, 3]]
L_SHAPE = [[0, 0], [4, 0], [4, 2], [2, 2], [2, 4], [0, 4]]
NICHE = [[0, 0], [4, 0], [4, 3], [2.06, 3], [2.06, 1], [2, 1], [2, 3], [0, 3]]
"""Two rooms on either side of a partition that is 6 cm thick."""
FLOORS = {
    "a square": SQUARE, "clockwise": SQUARE[::-1], "an L": L_SHAPE, "a thin partition": NICHE,
    "a corner given twice": [*SQUARE[:2], *SQUARE[1:]],
    "an acute corner": [[0, 0], [4, 0], [0, 1.5]],
}  # fmt: skip


def write(folder: Path, **members: Any) -> Path:
    data = {
        "format": "momapos-scene", "version": 1, "name": "room",
        "objects": [{"name": "box", "pose": {"xyz": [1, 1, 0.5]}, "box": [0.4, 0.4, 1]}],
        **members,
    }  # fmt: skip
    path = folder / "room.json"
    path.write_text(json.dumps(data))
    return path


def inside_points(item: SceneObject) -> np.ndarray:
    """Return points on a grid in a box, up to its sides, seen from above."""
    size = np.array(item.model.urdf.links["box"].collisions[0].size[:2])
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-0.5, 0.5, 41)]), -1).reshape(-1, 2) * size
    return grid @ item.T_world_object[:2, :2].T + item.T_world_object[:2, 3]


@pytest.mark.parametrize("kind", FLOORS)
def test_walls_along_the_floor_leave_it_free_and_close_it(kind: str, tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path, floor=FLOORS[kind], walls="floor"))
    floor = np.array(FLOORS[kind], float)
    solid = [item for item in scene.objects if item.wall is not None]
    assert [item.name for item in solid] == [f"wall_{k + 1}" for k in range(len(solid))]
    for item in solid:
        points = inside_points(item)
        deep = edge_distances(points, floor)[contains(floor, points)]
        assert deep.max(initial=0.0) < 0.011
    # Just outside of the outline is wall everywhere.
    share = np.linspace(0.0, 1.0, 201)[1:-1, None]
    for a, b in zip(floor, np.roll(floor, -1, axis=0), strict=True):
        along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
        for side in (1, -1):
            points = a + share * (b - a) + side * 0.004 * np.array([along[1], -along[0]])
            out = points[~contains(floor, points) & (edge_distances(points, floor) > 0.0039)]
            assert all(any(in_wall(item, p) for item in solid) for p in out)


def in_wall(item: SceneObject, point: np.ndarray) -> bool:
    x, y = item.T_world_object[:2, :2].T @ (point - item.T_world_object[:2, 3])
    return bool(abs(x) <= item.wall.length / 2 + 1e-9 and abs(y) <= item.wall.thickness / 2 + 1e-9)


def test_a_listed_wall_is_a_box_around_its_segment(tmp_path: Path) -> None:
    walls = [
        {"from": [0, 0], "to": [3, 4]},
        {"from": [3, 4], "to": [6, 0], "height": 1.2, "thickness": 0.2},
    ]
    scene = load_scene(write(tmp_path, walls=walls))
    one, two = scene.object("wall_1"), scene.object("wall_2")
    assert one.category == two.category == "wall"
    assert one.T_world_object[:3, 3] == pytest.approx([1.5, 2.0, 1.25])
    assert one.T_world_object[:3, 0] == pytest.approx([0.6, 0.8, 0.0])
    assert one.model.urdf.links["box"].collisions[0].size == pytest.approx((5.0, 0.1, 2.5))
    assert two.model.urdf.links["box"].collisions[0].size == pytest.approx((5.0, 0.2, 1.2))
    assert two.bounds[:, 2] == pytest.approx([0.0, 1.2])


@pytest.mark.parametrize("kind", FLOORS)
def test_what_is_written_of_walls_is_what_is_read(kind: str, tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path, floor=FLOORS[kind], walls="floor"))
    again = load_scene(save_scene(scene, tmp_path / "again.json").path or "")
    data = json.loads((tmp_path / "again.json").read_text())
    assert data["walls"] == "floor"
    assert [item["name"] for item in data["objects"]] == ["box"]
    assert again.walls == scene.walls
    # Listed, the same walls are read as well: at corners they may overlap.
    data["walls"] = [
        {"from": w.start, "to": w.end, "height": w.height, "thickness": w.thickness}
        for w in scene.walls
    ]
    (tmp_path / "listed.json").write_text(json.dumps(data))
    assert load_scene(tmp_path / "listed.json").walls == scene.walls


@settings(max_examples=15)
@given(
    st.lists(st.tuples(*2 * [st.floats(-20, 20)]), min_size=2, max_size=2, unique=True),
    st.floats(0.01, 9), st.floats(0.01, 2),
)  # fmt: skip
def test_any_wall_survives_its_file(
    tmp_path_factory: pytest.TempPathFactory,
    ends: list[tuple[float, float]],
    height: float,
    thickness: float,
) -> None:
    if math.dist(*ends) < 0.01:
        return
    folder = tmp_path_factory.mktemp("wall")
    scene = Scene("room", ()).with_walls([Wall(*ends, height, thickness)])
    save_scene(scene, folder / "room.json")
    assert load_scene(folder / "room.json").walls == scene.walls


WRONG = {
    "no floor": ({"walls": "floor"}, 'walls: "floor" needs the outline of the floor'),
    "another word": ({"walls": "all"}, "walls must be 'floor' or a list"),
    "a number": ({"walls": [3]}, "walls: wall 0 must be {from: ..., to: ...}"),
    "no end": ({"walls": [{"from": [0, 0]}]}, "walls: wall 0: to is missing; it must be 2 numbers"),
    "a text": ({"walls": [{"from": [0, "0"], "to": [1, 1]}]}, "wall 0: from must be 2 numbers"),
    "no length": ({"walls": [{"from": [1, 1], "to": [1, 1]}]}, "wall_1: .*is 0 m long"),
    "no height": (
        {"walls": [{"from": [0, 0], "to": [1, 1], "height": 0}]}, "wall 0: height must be",
    ),
    "thick": (
        {"walls": [{"from": [0, 0], "to": [1, 1], "thickness": 1e4}]}, "wall 0: thickness must be",
    ),
    "far away": ({"walls": [{"from": [0, 0], "to": [1e9, 0]}]}, "to must be 2 numbers from"),
    "crossing": (
        {"walls": [{"from": [0, 0], "to": [2, 2]}, {"from": [0, 2], "to": [2, 0]}]},
        r"wall_1 and wall_2 cross at \(1, 1\)",
    ),
    "a name": (
        {
            "walls": [{"from": [0, 0], "to": [2, 2]}],
            "objects": [{"name": "wall_1", "pose": {"xyz": [5, 5, 1]}, "box": [1, 1, 1]}],
        },
        "'wall_1' has the name of one of the walls",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG)
def test_wrong_walls_are_refused_in_one_line(kind: str, tmp_path: Path) -> None:
    members, words = WRONG[kind]
    path = write(tmp_path, **members)
    with pytest.raises(SceneError, match=words) as error:
        load_scene(path)
    assert str(error.value).startswith(str(path))
    error_of("scene", "show", str(path))


@pytest.mark.parametrize(
    "second",
    [
        pytest.param([[2, 0], [2, 3]], id="at an end"),
        pytest.param([[1, 0.03], [1, 3]], id="in a T"),
        pytest.param([[1, -0.08], [1, 3]], id="in a T, an end within the thickness"),
        pytest.param([[0, 1], [2, 1]], id="parallel"),
    ],
)
def test_walls_may_meet(second: list[list[float]], tmp_path: Path) -> None:
    walls = [{"from": [0, 0], "to": [2, 0]}, {"from": second[0], "to": second[1]}]
    assert len(load_scene(write(tmp_path, walls=walls)).walls) == 2


def test_an_unknown_key_of_a_wall_is_reported(tmp_path: Path) -> None:
    walls = [{"from": [0, 0], "to": [1, 1], "hight": 2}]
    (words,) = load_scene(write(tmp_path, walls=walls)).warnings
    assert "walls: wall 0: 'hight' is not known and was ignored; did you mean 'height'?" in words


def test_walls_may_cross_furniture(tmp_path: Path) -> None:
    walls = [{"from": [0, 1], "to": [2, 1]}]  # through the middle of the box
    assert len(load_scene(write(tmp_path, walls=walls)).walls) == 1


def test_walls_can_be_set_in_code_and_stay_when_furniture_becomes_boxes() -> None:
    cup = SceneObject.box("cup", (0.1, 0.1, 0.1), (1.0, 1.0, 1.0))
    room = Scene("room", (cup,), floor_polygon=np.array(SQUARE, float))
    walled = room.with_walls()
    assert walled.walls == walls_around(np.array(SQUARE, float))
    assert walled.with_walls().walls == walled.walls
    assert walled.with_walls([]).objects == (cup,)
    assert walled.with_box_proxies(set()).walls == walled.walls
    assert walled.furniture.objects == (cup,)
    with pytest.raises(SceneError, match="no floor polygon"):
        Scene("room", (cup,)).with_walls()


def test_walls_are_solid_in_exported_scenes(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path, floor=SQUARE, walls="floor"))
    write_mjcf(scene, tmp_path / "room.xml")
    text = (tmp_path / "room.xml").read_text()
    assert all(f'"wall_{k}/box"' in text for k in (1, 2, 3, 4))
