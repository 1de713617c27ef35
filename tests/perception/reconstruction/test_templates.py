"""Templates fill the face, and their handles can be grasped."""

from __future__ import annotations

import typing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from momapos.model.records.scans import FaceImage, Front, Part, PartKind
from momapos.perception.reconstruction.usual_kinds import (
    ALIASES,
    HANDLES,
    SCORE,
    TEMPLATES,
    TemplatePredictor,
)


def face(width: float, height: float) -> FaceImage:
    return FaceImage(np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2), np.float32), width, height)


def guess(label: str, width: float, height: float) -> tuple[Part, ...]:
    return TemplatePredictor()(face(width, height), label).parts


def area(box: tuple[float, float, float, float]) -> float:
    return (box[2] - box[0]) * (box[3] - box[1])


SIDES = st.floats(0.05, 4.0)


@given(st.sampled_from(sorted(TEMPLATES)), SIDES, SIDES)
def test_parts_lie_on_the_face_without_overlap(label: str, width: float, height: float) -> None:
    parts = guess(label, width, height)
    boxes = np.array([part.box for part in parts])
    assert (boxes >= 0.0).all()
    assert (boxes <= 1.0).all()
    assert (boxes[:, :2] < boxes[:, 2:]).all()
    low = np.maximum(boxes[:, None, :2], boxes[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], boxes[None, :, 2:])
    shared = np.prod(np.clip(high - low, 0.0, None), axis=-1)
    np.testing.assert_allclose(shared, np.diag([area(part.box) for part in parts]), atol=1e-9)


@given(st.sampled_from(sorted(TEMPLATES)), SIDES, SIDES)
def test_handles_lie_on_their_parts_away_from_the_hinge(
    label: str, width: float, height: float
) -> None:
    for part in guess(label, width, height):
        left, top, right, bottom = part.box
        assert left <= part.handle[0] < part.handle[2] <= right
        assert top <= part.handle[1] < part.handle[3] <= bottom
        across = ((part.handle[0] + part.handle[2]) / 2 - left) / (right - left)
        down = ((part.handle[1] + part.handle[3]) / 2 - top) / (bottom - top)
        slack = 1e-9
        assert {
            "door_left": across >= 0.5 - slack,
            "door_right": across <= 0.5 + slack,
            "door_down": down <= 0.5 + slack,
            "drawer": abs(across - 0.5) < slack,
        }[part.kind]


def test_each_label_opens_in_the_usual_way() -> None:
    assert [part.kind for part in guess("fridge", 0.6, 0.85)] == ["door_right"]
    freezer, fridge = guess("fridge", 0.7, 1.8)
    assert freezer.box[3] == fridge.box[1] < 0.5
    (door,) = guess("microwave", 0.5, 0.3)
    assert (door.kind, door.box) == ("door_left", (0.0, 0.0, 0.75, 1.0))
    (door,) = guess("oven", 0.6, 0.6)
    assert (door.kind, door.box) == ("door_down", (0.0, 0.15, 1.0, 1.0))
    assert [part.kind for part in guess("dishwasher", 0.6, 0.85)] == ["door_down"]
    assert {part.kind for part in guess("drawer", 0.5, 0.75)} == {"drawer"}


@pytest.mark.parametrize(("width", "doors"), [(0.3, 1), (0.6, 1), (0.61, 2), (1.2, 2), (2.3, 4)])
def test_doors_of_a_cabinet_come_in_pairs_of_bearable_width(width: float, doors: int) -> None:
    parts = guess("cabinet", width, 0.8)
    assert len(parts) == doors
    assert all(area(part.box) * width <= 0.6 + 1e-9 for part in parts)
    assert [part.kind for part in parts] == (["door_left", "door_right"] * 2)[:doors]


@pytest.mark.parametrize(("height", "rows"), [(0.2, 1), (0.5, 2), (0.75, 3), (0.8, 4)])
def test_drawers_stack(height: float, rows: int) -> None:
    tops = [part.box[1] for part in guess("drawer", 0.5, height)]
    np.testing.assert_allclose(tops, np.arange(rows) / rows)


def test_all_parts_have_the_score_of_a_guess() -> None:
    front = TemplatePredictor()(face(0.6, 1.8), "fridge")
    assert {front.score, *(part.score for part in front.parts)} == {SCORE}


def test_an_unknown_label_has_no_parts() -> None:
    assert TemplatePredictor()(face(0.6, 1.8), "teddy bear") == Front(0.0, ())
    assert TemplatePredictor()(face(0.6, 1.8), "") == Front(0.0, ())


def test_synonyms_and_spellings_are_equivalent() -> None:
    assert set(ALIASES.values()) <= set(TEMPLATES)
    assert guess("Refrigerator", 0.7, 1.8) == guess("fridge", 0.7, 1.8)
    assert guess("wall_cabinet ", 1.0, 0.7) == guess("cabinet", 1.0, 0.7)


def test_templates_fill_the_height_and_fit_every_face() -> None:
    for choices in TEMPLATES.values():
        heights = [choice.up_to for choice in choices]
        assert heights == sorted(heights)
        assert heights[-1] == float("inf")
        for choice in choices:
            assert sum(band.share for band in choice.bands) == pytest.approx(1.0)
    assert set(HANDLES) == set(typing.get_args(PartKind))
