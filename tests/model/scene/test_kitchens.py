"""Built-in kitchens: everything opens, nothing collides, and the seed determines the result.

The scenes are checked by an independent reader, with pinocchio and coal.
"""

from __future__ import annotations

import json
import random
import sys
import tempfile
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tests.independent import Item, Placed, Room
from tests.shapes import unchecked

from momapos.core.errors import InputError, MissingExtraError, UnknownNameError
from momapos.model.scene.kitchens import LAYOUTS, generate_kitchen
from momapos.model.scene.library import kitchen_writer as writer
from momapos.model.scene.library.kitchen_writer import (
    MAX_TOUCH_OVERLAP,
    Box,
    FurniturePart,
    JointMotion,
    Obstacles,
    Piece,
    hits,
)

REPOSITORY = Path(__file__).parents[3]
LIBRARY = REPOSITORY / "src" / "momapos" / "model" / "scene" / "library"
SHIPPED = ("kitchen_small", "kitchen_island")
CHEAPEST = "single_wall"


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Generate a kitchen."""
    out = tmp_path_factory.mktemp("generated") / "kitchen.json"
    return generate_kitchen(CHEAPEST, seed=3, out=out)


@pytest.fixture(params=[*SHIPPED, "generated"], scope="module")
def kitchen(request: pytest.FixtureRequest) -> Path:
    """Return the scene file of each shipped kitchen, and of a generated one."""
    if request.param == "generated":
        path: Path = request.getfixturevalue("generated")
        return path
    return LIBRARY / f"{request.param}.json"


def bounds(shapes: Sequence[Placed]) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the world-aligned boxes around shapes [m]."""
    corners = np.array([shape.corners for shape in shapes])
    return corners.min(1), corners.max(1)


def least_distance(some: Sequence[Placed], others: Sequence[Placed]) -> float:
    """Return the minimum signed distance of two sets of shapes [m], capped at 3 mm."""
    margin, least = 0.003, 0.003
    low, high = bounds(others)
    for shape, its_low, its_high in zip(some, *bounds(some), strict=True):
        near = np.all((low < its_high + margin) & (high > its_low - margin), axis=1)
        least = min([least, *(shape.distance(others[i]) for i in np.flatnonzero(near))])
    return least


def moving_parts(path: Path) -> Iterator[tuple[Item, str, list[Placed]]]:
    """Yield every object and joint of a scene, with the shapes that the joint does not move."""
    room = Room.read(path)
    for item in room.items:
        rest = [shape for other in room.items if other is not item for shape in other.shapes()]
        for joint in item.joints:
            own = [s for s in item.shapes() if not item.moved_by(joint, s)]
            yield item, joint, [*rest, *own]


def shapes_at(item: Item, joint: str, value: float) -> list[Placed]:
    """Return the shapes that a joint moves, at a joint value."""
    return [s for s in item.shapes(item.at(joint, value)) if item.moved_by(joint, s)]


def test_a_kitchen_has_closed_objects_with_unique_names_and_categories(kitchen: Path) -> None:
    items = Room.read(kitchen).items
    names = [item.name for item in items]
    assert len(set(names)) == len(names)
    assert all(item.category for item in items)
    assert all(not item.q.any() for item in items)
    assert sum(len(item.q) for item in items) >= 8


def test_every_file_of_a_kitchen_is_in_its_own_folder(kitchen: Path) -> None:
    entries = json.loads(kitchen.read_text())["objects"]
    named = {entry["urdf"] for entry in entries if "urdf" in entry}
    folder = f"{kitchen.stem}_urdf"
    there = {f"{folder}/{path.name}" for path in (kitchen.parent / folder).iterdir()}
    assert named == there


def test_a_moving_part_hits_nothing_along_its_whole_opening(kitchen: Path) -> None:
    for item, joint, still in moving_parts(kitchen):
        for value in np.linspace(*item.limits(joint), 30):
            least = least_distance(shapes_at(item, joint, value), still)
            assert least >= -1e-3, (item.name, joint, value, least)


def test_a_closed_part_leaves_a_gap_all_around(kitchen: Path) -> None:
    for item, joint, still in moving_parts(kitchen):
        least = least_distance(shapes_at(item, joint, 0.0), still)
        assert least >= 1e-3, (item.name, joint, least)


def test_every_moving_part_has_a_bar_that_fingers_fit_behind(kitchen: Path) -> None:
    for item, joint, _ in moving_parts(kitchen):
        moved = [shape for shape in item.shapes() if shape.joint == item.joints[joint]]
        bars = [s for s in moved if "handle" in s.link and max(s.box.halfSide) >= 0.06]
        panels = [s for s in moved if "handle" not in s.link]
        assert len(bars) == 1, (item.name, joint)
        length = 2 * float(max(bars[0].box.halfSide))
        outward = item.front
        door_front = max(float((s.corners @ outward).max()) for s in panels)
        bar_back = float((bars[0].corners @ outward).min())
        assert 0.12 - 1e-6 <= length <= 0.40 + 1e-6
        assert bar_back - door_front == pytest.approx(0.04, abs=1e-4)


def test_the_start_is_on_the_floor_and_clear_of_everything(kitchen: Path) -> None:
    room = Room.read(kitchen)
    start, floor = room.start, room.floor
    assert np.all(np.abs(start - floor.mean(0)) <= np.ptp(floor, axis=0) / 2 - 0.6)
    low, high = bounds([shape for item in room.items for shape in item.shapes()])
    away = np.maximum(np.maximum(low[:, :2] - start, start - high[:, :2]), 0.0)
    assert np.linalg.norm(away, axis=1).min() >= 0.6


def test_the_furniture_stands_on_the_floor_and_the_walls_beside_it(kitchen: Path) -> None:
    room = Room.read(kitchen)
    floor = room.floor
    for item in room.items:
        low, high = (bound[:, :2] for bound in bounds(item.shapes()))
        inside = (low.min(0) >= floor.min(0) - 1e-6).all() and (
            high.max(0) <= floor.max(0) + 1e-6
        ).all()
        beside = (low.min(0) >= floor.max(0) - 1e-6).any() or (
            high.max(0) <= floor.min(0) + 1e-6
        ).any()
        assert beside if item.category == "wall" else inside, item.name


def test_there_are_objects_to_pick_that_rest_on_something(kitchen: Path) -> None:
    items = Room.read(kitchen).items
    small = {"cup", "apple", "cereal box", "bottle", "can"}
    objects = [item for item in items if item.category in small]
    assert 3 <= len(objects) <= 5
    for item in objects:
        others = [s for other in items if other is not item for s in other.shapes()]
        assert 0 < least_distance(item.shapes(), others) <= 0.002, item.name


def test_the_shipped_kitchens_are_small() -> None:
    files = [path for path in LIBRARY.rglob("*") if path.suffix in (".json", ".urdf")]
    assert {path.stem for path in files if path.suffix == ".json"} == set(SHIPPED)
    assert sum(path.stat().st_size for path in files) < 300_000


def test_generation_is_reproducible_and_without_side_effects(
    generated: Path, tmp_path: Path
) -> None:
    def left_behind() -> set[Path]:
        return set(Path(tempfile.gettempdir()).glob("sink*"))

    def global_state() -> tuple[str, object]:
        return repr(np.random.get_state()), random.getstate()  # noqa: NPY002

    before, files = global_state(), left_behind()
    with unchecked():
        again = generate_kitchen(CHEAPEST, seed=3, out=tmp_path / "deep" / "kitchen.json")
    assert global_state() == before
    assert left_behind() == files
    first, second = (
        {path.relative_to(scene.parent): path.read_bytes() for path in scene.parent.rglob("*.urdf")}
        | {Path("scene"): scene.read_bytes()}
        for scene in (generated, again)
    )
    assert len(first) > 5
    assert first == second


@pytest.mark.slow
@pytest.mark.parametrize(("layout", "seed"), list(product(LAYOUTS, (0, 1))))
def test_every_layout_opens_without_hitting_anything(
    layout: str, seed: int, tmp_path: Path
) -> None:
    out = generate_kitchen(layout, seed=seed, out=tmp_path / "kitchen.json")
    test_a_kitchen_has_closed_objects_with_unique_names_and_categories(out)
    test_a_moving_part_hits_nothing_along_its_whole_opening(out)
    test_a_closed_part_leaves_a_gap_all_around(out)
    test_every_moving_part_has_a_bar_that_fingers_fit_behind(out)
    test_the_start_is_on_the_floor_and_clear_of_everything(out)
    test_the_furniture_stands_on_the_floor_and_the_walls_beside_it(out)
    test_there_are_objects_to_pick_that_rest_on_something(out)


def test_an_unknown_layout_is_refused_with_the_nearest_name(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean l_shaped"):
        generate_kitchen("l_shape", seed=0, out=tmp_path / "kitchen.json")
    assert list(tmp_path.iterdir()) == []


def test_a_negative_seed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="0 or more"):
        generate_kitchen(CHEAPEST, seed=-1, out=tmp_path / "kitchen.json")


def test_without_scene_synthesizer_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "scene_synthesizer", None)
    with pytest.raises(MissingExtraError, match="pip install scene-synthesizer"):
        generate_kitchen(CHEAPEST, seed=0, out=tmp_path / "kitchen.json")
    assert list(tmp_path.iterdir()) == []


def cupboard(name: str, upper: float = 1.0) -> Piece:
    """Return a body with one door."""
    body = Box("wall", (0.0, 0.0, 0.0), (1.0, 0.5, 1.0))
    door = Box("panel", (0.0, -0.03, 0.0), (1.0, -0.01, 1.0))
    motion = JointMotion("revolute", (0.0, -0.03, 0.0), (0.0, 0.0, -1.0), upper)
    return Piece(
        name,
        "x",
        (0.0, 0.0, 0.0),
        0.0,
        (FurniturePart("body", (body,)), FurniturePart("door", (door,), motion)),
    )


def write(out: Path, *pieces: Piece) -> Path:
    """Write a scene of some pieces."""
    return writer.write_kitchen(out, "k", pieces, [(0, 0), (1, 0), (1, 1)], (0.0, 0.0, 0.0))


def contents(folder: Path) -> dict[str, str]:
    """Return the files in a folder with their content."""
    return {
        str(path.relative_to(folder)): path.read_text()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_a_failed_write_keeps_the_old_kitchen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = write(tmp_path / "kitchen.json", cupboard("old_one"), cupboard("old_two"))
    before = contents(tmp_path)

    def broken(_source: Path, _target: Path) -> Path:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", broken)
    with pytest.raises(InputError, match="No space left"):
        write(out, cupboard("new"))
    assert contents(tmp_path) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kitchen.json", "kitchen_urdf"]


def test_a_new_kitchen_replaces_the_old_one_completely(tmp_path: Path) -> None:
    out = write(tmp_path / "kitchen.json", cupboard("old"))
    write(out, cupboard("new"))
    assert set(contents(tmp_path)) == {"kitchen.json", "kitchen_urdf/new.urdf"}


def test_a_folder_with_other_files_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "kitchen_urdf").mkdir()
    (tmp_path / "kitchen_urdf" / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match=r"thesis\.tex"):
        write(tmp_path / "kitchen.json", cupboard("new"))
    assert contents(tmp_path) == {"kitchen_urdf/thesis.tex": "precious"}


@given(
    center=st.tuples(*[st.floats(-1.2, 1.2)] * 3),
    size=st.tuples(*[st.floats(0.02, 0.8)] * 3),
    axis=st.sampled_from([(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]),
    turns=st.integers(0, 3),
)
@settings(max_examples=60)
def test_hits_match_coal(
    center: tuple[float, float, float],
    size: tuple[float, float, float],
    axis: tuple[float, float, float],
    turns: int,
) -> None:
    values, pivot = np.linspace(0.0, 2.0, 7), np.array([0.0, -0.1, 0.0])
    motion = JointMotion("revolute", (0.0, -0.1, 0.0), axis, 2.0)
    door = FurniturePart("door", (Box("panel", (0.0, -0.1, 0.0), (0.6, 0.0, 0.5)),), motion)
    piece = Piece("piece", "x", (0.1, 0.2, 0.3), turns * np.pi / 2, (door,))
    half = np.array(size) / 2
    found = hits(piece, door, values, Obstacles(np.eye(3)[None], np.array([center]), half[None]))
    request = coal.DistanceRequest()
    request.enable_signed_distance = True
    R_yaw = Rotation.from_euler("z", piece.yaw)
    for value, hit in zip(values, found, strict=True):
        R = Rotation.from_rotvec(value * np.array(axis))
        middle = piece.xyz + R_yaw.apply(pivot + R.apply(np.array([0.3, -0.05, 0.25]) - pivot))
        distance = coal.distance(
            coal.Box(0.6, 0.1, 0.5),
            coal.Transform3s((R_yaw * R).as_matrix(), middle),
            coal.Box(*size),
            coal.Transform3s(np.eye(3), np.array(center)),
            request,
            coal.DistanceResult(),
        )
        if abs(distance + MAX_TOUCH_OVERLAP) > 1e-4:
            assert hit == (distance < -MAX_TOUCH_OVERLAP)
