"""A detected part with two handles is two parts."""

from __future__ import annotations

import numpy as np
import pytest
from tests.perception.reconstruction.fronts import face_of, raised

from momapos.core.geometry.line_detection import dark_lines
from momapos.model.records.scans import FaceImage, Part, PartKind
from momapos.perception.reconstruction.bars import divided_by_bars, fractions, handles_on

WHOLE = (0.0, 0.0, 1.0, 1.0)
Box = tuple[float, float, float, float]


def upright(x: float) -> Box:
    return (x - 0.015, 0.6, x + 0.015, 0.9)


def level(y: float) -> Box:
    return (0.35, y - 0.015, 0.65, y + 0.015)


def front(*bars: Box) -> FaceImage:
    """Return a plain front of 0.8 x 0.8 m with bars that protrude by 3 cm."""
    face = face_of(0.8, 0.8, 0.0)
    for bar in bars:
        raised(face, bar, 0.03)
    return face


def divided(face: FaceImage, *parts: Part) -> tuple[Part, ...]:
    lines = (dark_lines(face.color, axis) for axis in (1, 0))
    return divided_by_bars(face, parts, *lines)


@pytest.mark.parametrize(
    ("places", "kinds"),
    [
        ((0.44, 0.56), ("door_left", "door_right")),
        ((0.05, 0.95), ("door_right", "door_left")),
        ((0.05, 0.55), ("door_right", "door_right")),
        ((0.45, 0.95), ("door_left", "door_left")),
    ],
)
def test_a_door_with_two_upright_handles_is_two_similar_doors(
    places: tuple[float, float], kinds: tuple[PartKind, PartKind]
) -> None:
    bars = tuple(map(upright, places))
    left, right = divided(front(*bars), Part("door_left", WHOLE, 0.5))
    assert (left.kind, right.kind) == kinds
    np.testing.assert_allclose(left.box, (0.0, 0.0, 0.5, 1.0), atol=0.01)
    np.testing.assert_allclose(right.box, (0.5, 0.0, 1.0, 1.0), atol=0.01)
    for part, bar in zip((left, right), bars, strict=True):
        np.testing.assert_allclose(part.handle, bar, atol=0.01)


def test_a_handle_broken_by_noise_is_one_handle() -> None:
    face = front(upright(0.05), upright(0.95))
    for gap in ((0.0, 0.7, 0.1, 0.75), (0.0, 0.8, 0.1, 0.82)):
        raised(face, gap, 0.0)
    left, right = divided(face, Part("door_left", WHOLE, 0.5))
    assert (left.kind, right.kind) == ("door_right", "door_left")
    np.testing.assert_allclose(left.handle, upright(0.05), atol=0.01)


def test_specks_in_line_are_not_a_handle() -> None:
    specks = [(0.3 + 0.04 * k, 0.5, 0.305 + 0.04 * k, 0.505) for k in range(10)]
    face = front(upright(0.05), *specks)
    (bar,) = handles_on(face, Part("door_right", WHOLE, 0.5))
    np.testing.assert_allclose(fractions(bar, face), upright(0.05), atol=0.01)


def test_three_handles_are_three_doors() -> None:
    found = divided(front(*map(upright, (0.03, 0.62, 0.71))), Part("door_left", WHOLE, 0.5))
    assert [part.kind for part in found] == ["door_right", "door_left", "door_right"]
    np.testing.assert_allclose([p.box[0] for p in found], [0.0, 1 / 3, 2 / 3], atol=0.01)


def test_stacked_level_handles_are_drawers() -> None:
    face = front(level(0.05), level(0.55))
    found = sorted(divided(face, Part("door_left", WHOLE, 0.5)), key=lambda part: part.box[1])
    assert [part.kind for part in found] == ["drawer", "drawer"]
    np.testing.assert_allclose(found[0].box, (0.0, 0.0, 1.0, 0.5), atol=0.01)


def test_drawers_of_different_heights_have_handles_at_the_same_place() -> None:
    face = front(level(0.05), level(0.35))
    found = sorted(divided(face, Part("drawer", WHOLE, 0.5)), key=lambda part: part.box[1])
    np.testing.assert_allclose([p.box[3] for p in found], [0.3, 1.0], atol=0.01)


def test_a_visible_seam_overrides_the_places_of_handles() -> None:
    face = front(upright(0.05), upright(0.95))
    column = round(0.4 * face.color.shape[1])
    face.color[:, column : column + 2] //= 2
    left, right = divided(face, Part("door_left", WHOLE, 0.5))
    assert left.box[2] == right.box[0] == pytest.approx(0.4, abs=0.01)


def test_handles_end_to_end_belong_to_stacked_doors() -> None:
    bars = ((0.035, 0.2, 0.065, 0.45), (0.035, 0.65, 0.065, 0.9))
    face = front(*bars)
    part = Part("door_right", WHOLE, 0.5)
    top, low = sorted(divided(face, part), key=lambda one: one.box[1])
    assert (top.kind, low.kind) == ("door_right", "door_right")
    assert top.box[3] == low.box[1] == pytest.approx(0.5, abs=0.01)
    row = round(0.6 * face.color.shape[0])
    face.color[row : row + 2] //= 2
    top, low = sorted(divided(face, part), key=lambda one: one.box[1])
    assert top.box[3] == low.box[1] == pytest.approx(0.6, abs=0.01)
    np.testing.assert_allclose((top.handle, low.handle), bars, atol=0.01)


@pytest.mark.parametrize(
    "bars",
    [
        (upright(0.9),),
        ((0.885, 0.1, 0.915, 0.4), (0.885, 0.5, 0.915, 0.9)),
        (upright(0.9), level(0.2)),
        (upright(0.9), (0.1, 0.6, 0.13, 0.72)),
        (upright(0.9), upright(0.84)),
    ],
)
def test_a_broken_handle_or_one_next_to_another_object_is_one_handle(bars: tuple[Box, ...]) -> None:
    part = Part("door_left", WHOLE, 0.5)
    assert divided(front(*bars), part) == (part,)


def test_a_flap_with_two_level_bars_of_one_width_is_two_drawers() -> None:
    face = front(level(0.05), level(0.45))
    found = divided(face, Part("door_down", WHOLE, 0.5))
    assert [part.kind for part in found] == ["drawer", "drawer"]


def test_a_flap_has_one_handle_and_a_neighbors_handle_is_ignored() -> None:
    face = front(upright(0.05), upright(0.55))
    flap = Part("door_down", WHOLE, 0.5)
    assert divided(face, flap) == (flap,)
    towels = (0.4, 0.535, 0.7, 0.565)
    assert divided(front(level(0.05), towels), flap) == (flap,)
    parts = (
        Part("door_left", (0.0, 0.0, 0.6, 1.0), 0.5),
        Part("door_right", (0.5, 0.0, 1.0, 1.0), 0.5, handle=upright(0.55)),
    )
    assert divided(face, *parts) == parts
