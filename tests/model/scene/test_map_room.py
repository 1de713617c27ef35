"""A map becomes a floor and boxes: free cells are free, and others are not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Bool, Float
from numpy.testing import assert_allclose
from PIL import Image
from tests.commands import error_of

from momapos.apps.cli.main import main
from momapos.core.errors import MomaposError
from momapos.core.geometry.polygons import contains, signed_area
from momapos.model.scene import map_room
from momapos.model.scene.map_room import read_map_room, simplified
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject

FREE, WALL, UNKNOWN = 254, 0, 205
YAW = 0.4


def apartment() -> np.ndarray:
    """Return two rooms of 4 x 3 m with a door of 0.9 m between them, and a pillar, in cells."""
    cells = np.full((70, 180), UNKNOWN, np.uint8)
    cells[4:66, 4:174] = WALL
    cells[5:65, 5:85] = FREE
    cells[5:65, 88:173] = FREE
    cells[20:38, 85:88] = FREE  # the door
    cells[40:46, 30:36] = WALL  # a pillar with unknown cells inside
    cells[42:44, 32:34] = UNKNOWN
    return cells


def write_map(
    folder: Path, cells: np.ndarray, *, yaw: float = 0.0, resolution: float = 0.05
) -> Path:
    """Write cells, whose first row is the lowest, as a map."""
    Image.fromarray(cells[::-1].copy()).save(folder / "map.png")
    path = folder / "map.yaml"
    path.write_text(
        f"image: map.png\nresolution: {resolution}\norigin: [-2, 1, {yaw}]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return path


def centers(shape: tuple[int, int], yaw: float, resolution: float = 0.05) -> np.ndarray:
    rows, columns = np.indices(shape)
    local = (np.stack([columns, rows], -1) + 0.5) * resolution
    c, s = np.cos(yaw), np.sin(yaw)
    return local @ np.array([[c, s], [-s, c]]) + [-2, 1]


def in_boxes(
    items: tuple[SceneObject, ...], xy: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    found = np.zeros(len(xy), bool)
    for item in items:
        T, size = item.T_world_object, np.ptp(item.model.hulls["box"][0].vertices, axis=0)
        local = (xy - T[:2, 3]) @ T[:2, :2]
        found |= (np.abs(local) <= size[:2] / 2 + 1e-9).all(1)
    return found


@pytest.mark.parametrize("yaw", [0.0, YAW, -2.0])
def test_free_cells_are_on_the_floor_and_occupied_ones_are_in_boxes(
    tmp_path: Path, yaw: float
) -> None:
    cells = apartment()
    path = write_map(tmp_path, cells, yaw=yaw)
    room = read_map_room(path, tmp_path)
    xy = centers(cells.shape, yaw).reshape(-1, 2)
    on_floor, boxed = contains(room.floor, xy), in_boxes(room.walls, xy)
    free, wall = (cells.ravel() == value for value in (FREE, WALL))
    assert (on_floor & ~boxed)[free].all()
    assert boxed[wall].all()
    assert not (on_floor & ~boxed)[cells.ravel() == UNKNOWN].any()
    area = 0.05**2 * ((cells == FREE).sum() + 36)
    assert_allclose(signed_area(room.floor), area, rtol=0.01)
    assert len(room.floor) <= 16
    assert len(room.walls) < 20


def test_without_an_island_the_floor_alone_says_where_a_base_may_stand(tmp_path: Path) -> None:
    cells = np.full((40, 40), UNKNOWN, np.uint8)
    cells[10:30, 10:30] = FREE
    room = read_map_room(write_map(tmp_path, cells), tmp_path)
    assert room.walls == ()
    near = np.array([[-1.47, 1.53], [-0.53, 1.53], [-0.53, 2.47], [-1.47, 2.47]])
    assert contains(room.floor, near).all()
    assert np.abs(room.floor - [-1.0, 2.0]).max() <= 0.5 + 1e-9


def test_a_slanted_wall_is_an_edge_of_the_floor_without_steps(tmp_path: Path) -> None:
    xy = centers((120, 120), 0.0) - [-2, 1] - 3.0
    c, s = np.cos(0.35), np.sin(0.35)
    inside = (np.abs(xy @ np.array([[c, -s], [s, c]])) < [1.6, 1.0]).all(-1)
    cells = np.where(inside, FREE, WALL).astype(np.uint8)
    floor = read_map_room(write_map(tmp_path, cells), tmp_path).floor
    local = (floor - [-2, 1] - 3.0) @ np.array([[c, -s], [s, c]])
    edge = np.abs(np.abs(local) - [1.6, 1.0]).min(1)
    assert edge.max() <= 0.05  # a cell
    assert len(floor) <= 208 / 4  # of the cells around it
    assert_allclose(signed_area(floor), 3.2 * 2.0, rtol=0.02)


def test_the_start_chooses_the_room(tmp_path: Path) -> None:
    cells = apartment()
    cells[20:38, 85:88] = WALL
    path = write_map(tmp_path, cells)
    left = read_map_room(path, tmp_path, start=np.array([0.0, 3.0, 0.0]))
    largest = read_map_room(path, tmp_path)
    assert contains(left.floor, np.array([[0.0, 3.0]]))[0]
    assert not contains(largest.floor, np.array([[0.0, 3.0]]))[0]
    assert "1 other free region is not connected" in " ".join(largest.notes)
    off = read_map_room(path, tmp_path, start=np.array([90.0, 3.0, 0.0]))
    assert "is not on a free cell" in " ".join(off.notes)


def furnished(folder: Path, *, objects: str, **members: object) -> Path:
    head = {"format": "momapos-scene", "version": 1, "map": "map.yaml", **members}
    (folder / "room.json").write_text(f'{json.dumps(head)[:-1]}, "objects": [{objects}]}}')
    return folder / "room.json"


def test_furniture_stands_in_a_map_that_shows_it(tmp_path: Path) -> None:
    """The table of the file is the pillar of the map, and a shelf stands at the wall."""
    write_map(tmp_path, apartment())
    table = '{"name": "wall_1", "pose": {"xyz": [-0.35, 3.15, 0.4]}, "box": [0.3, 0.3, 0.8]}'
    shelf = '{"name": "shelf", "pose": {"xyz": [1.0, 1.4, 1.6]}, "box": [0.8, 0.3, 0.3]}'
    scene = load_scene(
        furnished(tmp_path, objects=f"{table},{shelf}", start={"x": 0, "y": 2, "yaw": 0})
    )
    assert [item.name for item in scene.objects[:2]] == ["wall_1", "shelf"]
    walls = scene.objects[2:]
    assert not in_boxes(walls, np.array([[-0.35, 3.15]]))[0]
    assert "map_wall_1" in [item.name for item in walls]
    assert any("lie under objects of the scene" in text for text in scene.warnings)
    # The shelf hangs above what a scanner sees, so the wall under it stays.
    assert in_boxes(walls, np.array([[1.0, 1.22]]))[0]


def test_a_floor_of_the_scene_wins(tmp_path: Path) -> None:
    write_map(tmp_path, apartment())
    floor = [[-1, 2], [0, 2], [0, 3], [-1, 3]]
    scene = load_scene(furnished(tmp_path, objects="", floor=floor))
    assert_allclose(scene.floor_polygon, floor)
    assert len(scene.objects) > 3


def test_a_map_alone_is_a_scene_and_converts_to_one(tmp_path: Path) -> None:
    path, out = write_map(tmp_path, apartment(), yaw=YAW), tmp_path / "out.json"
    scene = load_scene(path)
    assert main(["scene", "convert", str(path), str(out)]) == 0
    again = load_scene(out)
    assert [item.name for item in again.objects] == [item.name for item in scene.objects]
    for a, b in zip(scene.objects, again.objects, strict=True):
        assert_allclose(b.vertices, a.vertices, atol=1e-9)
    save_scene(load_scene(furnished(tmp_path, objects="")), tmp_path / "saved.json")
    saved = load_scene(tmp_path / "saved.json")
    assert isinstance(saved, Scene)
    assert len(saved.objects) == len(scene.objects)


def test_the_command_refuses_a_map_without_image_with_status_2(tmp_path: Path) -> None:
    path = write_map(tmp_path, apartment())
    (tmp_path / "map.png").unlink()
    for scene in (path, furnished(tmp_path, objects="")):
        assert "'map.png' does not exist" in error_of("scene", "show", str(scene))


@pytest.mark.parametrize("name", ["../map.yaml", "/etc/passwd", "gone.yaml", "map\x00.yaml", 7])
def test_the_key_map_names_a_file_inside_the_folder(tmp_path: Path, name: object) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    write_map(tmp_path, apartment())
    with pytest.raises(MomaposError) as raised:
        load_scene(furnished(inner, objects="", map=name))
    assert "\n" not in str(raised.value)


def test_maps_that_make_no_room_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_map(tmp_path, np.full((40, 40), WALL, np.uint8))
    with pytest.raises(MomaposError, match="no free region of at least"):
        load_scene(path)
    rng = np.random.default_rng(0)
    noise = np.where(rng.random((200, 200)) < 0.3, WALL, FREE).astype(np.uint8)
    path = write_map(tmp_path, noise)
    with pytest.raises(MomaposError, match="need more than 1500 boxes; crop or clean the map"):
        load_scene(path)
    monkeypatch.setattr(map_room, "MAX_CORNERS", 4)
    path = write_map(tmp_path, apartment())
    with pytest.raises(MomaposError, match="corners; at most 4 are supported"):
        load_scene(path)


def test_an_outline_keeps_its_distance_to_what_is_left_out() -> None:
    rng = np.random.default_rng(1)
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    points = (20 + rng.normal(0, 0.3, 400))[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    kept = simplified(points, 0.5)
    a, b = kept, np.roll(kept, -1, axis=0)
    t = np.einsum("npi,pi->np", points[:, None] - a, b - a) / ((b - a) ** 2).sum(1)
    near = a + np.clip(t, 0, 1)[..., None] * (b - a)
    assert np.linalg.norm(points[:, None] - near, axis=-1).min(1).max() <= 0.5
    assert 10 < len(kept) < 200
