"""Laws of the drawn faces: their labels match the images."""

from __future__ import annotations

import numpy as np
import pytest
from tests import optional
from training.fronts import (
    blanks,
    cabinets,
    canvas,
    generator,
    handles,
    layouts,
    materials,
    plans,
    pool,
)

from momapos.perception.reconstruction import decode

SEEDS = range(40)


@pytest.fixture(scope="module")
def faces() -> list[generator.Drawn]:
    """Draw some faces."""
    return [generator.draw(np.random.default_rng([7, i])) for i in SEEDS]


def test_the_same_seed_draws_the_same_image() -> None:
    one, two = (generator.draw(np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(one.face.color, two.face.color)
    np.testing.assert_array_equal(one.face.height_map, two.face.height_map)
    assert one.parts == two.parts


def test_every_part_lies_within_its_face(faces: list[generator.Drawn]) -> None:
    boxes = np.array([part.box for drawn in faces for part in drawn.parts])
    assert boxes.min() >= 0.0
    assert boxes.max() <= 1.0
    assert (boxes[:, 2:] > boxes[:, :2]).all()


def test_parts_of_a_face_are_disjoint(faces: list[generator.Drawn]) -> None:
    for drawn in faces:
        if len(drawn.parts) > 1:
            boxes = np.array([part.box for part in drawn.parts])
            common = decode.overlaps(boxes, boxes)[1]
            np.fill_diagonal(common, 0.0)
            assert common.max() < 0.12


def test_every_handle_lies_within_its_part(faces: list[generator.Drawn]) -> None:
    pairs = [(p.box, p.handle) for drawn in faces for p in drawn.parts if p.handle is not None]
    box, handle = (np.array(side) for side in zip(*pairs, strict=True))
    assert len(pairs) > 30
    assert (handle[:, :2] >= box[:, :2] - 1e-9).all()
    assert (handle[:, 2:] <= box[:, 2:] + 1e-9).all()


def test_most_door_handles_are_opposite_the_hinge(faces: list[generator.Drawn]) -> None:
    far = [
        (sum(p.handle[::2]) > sum(p.box[::2])) == (p.kind == "door_left")
        for drawn in faces
        for p in drawn.parts
        if p.handle is not None and p.kind in ("door_left", "door_right")
    ]
    assert np.mean(far) > 0.85


def test_a_face_is_a_front_if_it_has_parts(faces: list[generator.Drawn]) -> None:
    assert {drawn.front for drawn in faces} == {True, False}
    for drawn in faces:
        if drawn.family == "nothing":
            assert not drawn.parts


@pytest.mark.parametrize("maker", layouts.FAMILIES)
def test_plans_keep_their_cells_within_the_face(maker: layouts.Maker) -> None:
    for seed in range(60):
        plan = maker(np.random.default_rng(seed))
        cells = np.array([cell.rect for cell in plan.cells])
        assert cells.min() >= -1e-9
        assert (cells[:, 2] <= plan.width + 1e-9).all()
        assert (cells[:, 3] <= plan.height + 1e-9).all()


def test_packed_crops_are_restored_approximately(faces: list[generator.Drawn]) -> None:
    stack = decode.planes(faces[0].face)
    small = decode.resample(stack, np.array([0.0, 0.0, 1.0, 1.0]), 64)
    again = pool.unpacked(pool.packed(small)[None])[0]
    known = small[4] > 0.5
    assert np.abs(again[:3] - small[:3]).max() < 0.02
    assert np.abs(again[3] - small[3] / np.maximum(small[4], 1e-6))[known].max() < 0.02
    np.testing.assert_array_equal(again[4] > 0, known)


def test_a_proposal_is_assigned_to_the_part_that_it_covers(faces: list[generator.Drawn]) -> None:
    for i, drawn in enumerate(faces):
        boxes, meant = pool.proposals(np.random.default_rng(i), drawn)
        parts = np.array([p.box for p in drawn.parts]).reshape(-1, 4)
        if not len(parts):
            assert (meant < 0).all()
            continue
        best = decode.overlaps(boxes, parts)[0].max(axis=1)
        assert ((best > 0.5) == (meant >= 0)).all()


def test_targets_decode_to_their_boxes() -> None:
    targets = optional.module("training.fronts.targets", "torch")
    boxes = np.array([[0.1, 0.1, 0.45, 0.5], [0.55, 0.1, 0.9, 0.5], [0.1, 0.6, 0.9, 0.9]])
    kinds = np.array([0, 1, 4])
    heat, reach, _ = targets.face_targets(boxes, kinds, 48)
    found, hot = decode.peaks(heat, reach, 0.9, 10)
    assert decode.overlaps(boxes, found)[0].max(axis=1).min() > 0.97
    assert sorted(hot.argmax(axis=1)) == [0, 1, 4]


def test_wall_cabinets_have_lifted_doors_with_low_handles_and_no_drawers() -> None:
    mix = generator.Mix({cabinets.hung: 1.0})
    faces = [generator.draw(np.random.default_rng([9, i]), mix) for i in SEEDS]
    parts = [part for drawn in faces for part in drawn.parts]
    lifted = [part for part in parts if part.kind == "door_up"]
    assert 0.1 < len(lifted) / len(parts) < 0.6
    assert "drawer" not in {part.kind for part in parts}
    low = [sum(p.handle[1::2]) > sum(p.box[1::2]) for p in lifted if p.handle is not None]
    assert len(low) > 5
    assert all(low)


@pytest.mark.parametrize("free", ["left", "right"])
def test_a_cup_handle_of_a_door_is_level_and_next_to_the_free_edge(free: str) -> None:
    door = canvas.box(0.2, 0.1, 0.7, 0.9)
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        style = handles.HandleStyle(
            "cup", rng.uniform(0.07, 0.12), rng.uniform(0.028, 0.045), 0.03,
            rng.uniform(0.0, 0.07), materials.metal(rng), 0.5,
        )  # fmt: skip
        left, top, right, bottom = handles.place(rng, style, door, free, rng.random())
        assert right - left > bottom - top
        assert door[0] <= left < right <= door[2]
        assert door[1] <= top < bottom <= door[3]
        assert ((left + right) / 2 < 0.45) == (free == "left")


def test_level_handles_of_base_doors_are_at_the_top_and_never_at_the_hinge() -> None:
    habit = cabinets.Habit("base", 0.003, 0.0, 0.2, "top", 0.0, 0.0, 0.0, 0.0, level=True)
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        doors = cabinets.leaf(rng, (0.0, 0.0, 0.4, 0.7), habit)
        assert {door.kind for door in doors} <= {"door_left", "door_right"}
        for door in doors:
            assert door.free == "top"
            assert door.along >= 0.5 if door.kind == "door_left" else door.along <= 0.5


@pytest.mark.parametrize("fill", blanks.FILLS)
def test_a_face_without_parts_has_no_labels(fill: str) -> None:
    def only(rng: np.random.Generator) -> plans.Plan:
        rect = (0.0, 0.0, rng.uniform(0.3, 2.0), rng.uniform(0.3, 2.0))
        return plans.Plan("nothing", rect[2], rect[3], [plans.Cell(rect, None, fill)])

    for seed in range(4):
        drawn = generator.draw(np.random.default_rng(seed), generator.Mix({only: 1.0}))
        assert not drawn.parts
        assert not drawn.front


def test_the_last_mix_has_more_faces_without_parts_than_the_first() -> None:
    def share(families: dict[layouts.Maker, float]) -> float:
        return families[layouts.nothing] / sum(families.values())

    assert share(layouts.LAST_FAMILIES) > 2 * share(layouts.FAMILIES)
