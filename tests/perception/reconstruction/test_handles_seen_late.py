"""Handles that the networks miss: bars in the height map, and lines of drawers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from tests.perception.reconstruction.fronts import face_of, raised

from momapos.core.geometry.line_detection import dark_lines
from momapos.model.records.scans import FaceImage, Part, PartKind
from momapos.perception.reconstruction.bars import into_drawers, with_bar

WHOLE = (0.0, 0.0, 1.0, 1.0)
Box = tuple[float, float, float, float]


@pytest.mark.parametrize(
    ("said", "bar", "kind"),
    [
        ("door_right", (0.9, 0.7, 0.93, 0.95), "door_left"),
        ("door_left", (0.05, 0.7, 0.08, 0.95), "door_right"),
        ("drawer", (0.9, 0.7, 0.93, 0.95), "door_left"),
        ("door_left", (0.1, 0.9, 0.8, 0.93), "door_up"),
        ("door_left", (0.1, 0.05, 0.8, 0.08), "door_down"),
        ("drawer", (0.1, 0.05, 0.8, 0.08), "drawer"),
        ("door_left", (0.6, 0.9, 0.8, 0.93), "door_left"),
        ("door_left", (0.5, 0.4, 0.53, 0.7), "door_left"),
    ],
)
def test_a_bar_in_the_height_map_is_the_handle_and_determines_the_kind(
    said: PartKind, bar: Box, kind: PartKind
) -> None:
    face = face_of(0.6, 0.6, 0.0)
    raised(face, bar, 0.03)
    part = with_bar(face, Part(said, WHOLE, 0.5))
    assert part.kind == kind
    np.testing.assert_allclose(part.handle, bar, atol=0.01)


def test_noise_is_not_a_bar() -> None:
    face = face_of(0.6, 0.6, 0.0)
    face.height_map[:] = np.random.default_rng(0).normal(0.0, 0.012, face.height_map.shape)
    raised(face, (0.9, 0.7, 0.93, 0.95), 0.03)
    part = Part("door_right", WHOLE, 0.5)
    assert with_bar(face, part) == part


def test_a_protruding_handle_stays_and_without_depth_nothing_changes() -> None:
    face = face_of(0.6, 0.6, 0.0)
    raised(face, (0.9, 0.7, 0.93, 0.95), 0.03)
    raised(face, (0.1, 0.1, 0.2, 0.12), 0.015)
    part = Part("door_right", WHOLE, 0.5, handle=(0.1, 0.1, 0.2, 0.12))
    assert with_bar(face, part) == part
    bare = Part("door_right", WHOLE, 0.5)
    assert with_bar(face_of(0.6, 0.6), bare) == bare


def test_a_bar_replaces_a_label_as_the_handle() -> None:
    face = face_of(0.6, 0.6, 0.0)
    labeled = Part("door_left", WHOLE, 0.5, handle=(0.9, 0.6, 0.95, 0.8))
    assert with_bar(face, labeled) == labeled
    raised(face, (0.0, 0.0, 1.0, 0.04), 0.03)
    assert with_bar(face, labeled) == labeled, "a worktop above it is no handle"
    raised(face, (0.1, 0.08, 0.8, 0.11), 0.03)
    found = with_bar(face, labeled)
    assert found.kind == "door_down"
    np.testing.assert_allclose(found.handle, (0.1, 0.08, 0.8, 0.11), atol=0.01)


def gripped(rows: list[float], *, left: float = 0.4, wide: float = 0.2) -> FaceImage:
    """Return a plain 0.5 x 0.8 m front with faint handles at shares of the height, from the top."""
    face = face_of(0.5, 0.8)
    h, w = face.color.shape[:2]
    for row in rows:
        start = round(left * w)
        face.color[round(row * h), start : start + round(wide * w)] = 185
    return face


def drawers_on(face: FaceImage, kind: PartKind = "door_right") -> tuple[Part, ...]:
    return into_drawers(face, [Part(kind, WHOLE, 0.5)], dark_lines(face.color, 0))


@pytest.mark.parametrize(
    ("rows", "edges"),
    [([0.1, 0.4, 0.7], [0.1, 0.4, 0.7, 1.0]), ([1 / 6, 0.5, 5 / 6], [0.0, 1 / 3, 2 / 3, 1.0])],
    ids=["handles at the top", "handles in the middle"],
)
def test_evenly_stacked_handles_are_drawers(rows: list[float], edges: list[float]) -> None:
    found = drawers_on(gripped(rows))
    assert [part.kind for part in found] == ["drawer"] * 3
    np.testing.assert_allclose([part.box[1] for part in found], edges[:-1], atol=0.02)
    np.testing.assert_allclose([part.box[3] for part in found], edges[1:], atol=0.02)
    for part, row in zip(found, rows, strict=True):
        assert part.handle[1] <= row + 0.01 <= part.handle[3] + 0.02


def cabinet(rows: list[float]) -> tuple[FaceImage, Part, Part]:
    """Return handles on a front below a recessed board, and two stretches of it as drawers."""
    face = gripped(rows)
    face.height_map[:] = 0.0
    raised(face, (0.0, 0.0, 1.0, 0.08), -0.05)
    handle = (0.4, rows[1], 0.6, rows[1] + 0.01)
    return face, Part("drawer", (0, 0.25, 1, 0.6), 0.7, handle), Part("drawer", (0, 0.6, 1, 1), 0.6)


def test_a_stack_is_found_from_any_stretch_of_it() -> None:
    face, high, low = cabinet([0.1, 0.4, 0.7])
    lines = dark_lines(face.color, 0)
    above = Part("drawer", (0.1, 0.0, 0.9, 0.07), 0.5)
    for parts in ([high], [high, low], [low, high]):
        *drawers, board = into_drawers(face, [*parts, above], lines)
        assert board == above, "what lies above it is another part"
        np.testing.assert_allclose([part.box[1] for part in drawers], [0.1, 0.4, 0.7], atol=0.02)
        np.testing.assert_allclose([part.box[3] for part in drawers], [0.4, 0.7, 1.0], atol=0.02)
        assert all(part.kind == "drawer" for part in drawers)


def test_parts_with_one_handle_of_the_stack_each_stay_unchanged() -> None:
    face, _, _ = cabinet([0.1, 0.4, 0.7])
    edges = [0.1, 0.39, 0.69, 0.98]
    parts = [Part("drawer", (0.02, top, 0.98, bottom), 0.8) for top, bottom in pairwise(edges)]
    assert into_drawers(face, parts, dark_lines(face.color, 0)) == tuple(parts)


@pytest.mark.parametrize(
    "face",
    [
        gripped([0.3, 0.6]),
        gripped([0.1, 0.3, 0.8]),
        gripped([0.30, 0.33, 0.36, 0.39]),
        gripped([0.1, 0.4, 0.7], left=0.1),
        gripped([0.1, 0.4, 0.7], left=0.02, wide=0.96),
    ],
    ids=["two", "uneven", "a vent", "aside", "grooves"],
)
def test_other_lines_are_not_a_stack(face: FaceImage) -> None:
    assert len(drawers_on(face)) == 1


def test_a_line_shorter_than_the_handles_is_not_a_handle() -> None:
    face = gripped([0.1, 0.35, 0.6])
    h, w = face.color.shape[:2]
    face.color[round(0.85 * h), round(0.45 * w) : round(0.55 * w)] = 150
    found = drawers_on(face)
    np.testing.assert_allclose([part.box[1] for part in found], [0.1, 0.35, 0.6], atol=0.02)


def test_a_flap_is_never_a_stack() -> None:
    assert len(drawers_on(gripped([0.1, 0.4, 0.7]), "door_down")) == 1
