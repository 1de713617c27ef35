"""Parts that are found by their handles alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.perception.reconstruction.fronts import face_of, raised

from momapos.model.records.scans import FaceImage, Part
from momapos.perception.reconstruction.bars import parts_from_bars

DRAWER = Part("drawer", (0.0, 0.0, 1.0, 0.25), 0.9)


def front(width: float = 0.6, height: float = 0.8) -> FaceImage:
    """Return a flat front with a recessed plinth."""
    face = face_of(width, height, 0.0)
    raised(face, (0.0, 0.9, 1.0, 1.0), -0.06)
    return face


def test_an_upright_bar_next_to_known_parts_is_a_door() -> None:
    face = front()
    raised(face, (0.85, 0.35, 0.88, 0.55), 0.03)
    (door,) = parts_from_bars(face, [DRAWER])
    assert door.kind == "door_left"
    np.testing.assert_allclose(door.box, (0.0, 0.25, 1.0, 0.9), atol=0.01)
    np.testing.assert_allclose(door.handle, (0.85, 0.35, 0.88, 0.55), atol=0.01)
    assert sum(share for _, share in door.odds) == pytest.approx(1.0)


def test_a_level_bar_in_the_middle_is_a_drawer() -> None:
    face = front()
    raised(face, (0.4, 0.3, 0.6, 0.32), 0.03)
    (drawer,) = parts_from_bars(face, [DRAWER, Part("drawer", (0.0, 0.6, 1.0, 0.9), 0.9)])
    assert drawer.kind == "drawer"
    np.testing.assert_allclose(drawer.box, (0.0, 0.25, 1.0, 0.6), atol=0.01)


@pytest.mark.parametrize(
    ("bar", "why"),
    [
        ((0.4, 0.1, 0.6, 0.12), "it is the drawer's"),
        ((0.1, 0.3, 0.3, 0.32), "buttons at a side"),
        ((0.05, 0.5, 0.95, 0.53), "a board"),
        ((0.97, 0.4, 1.0, 0.6), "what stands beside"),
    ],
)
def test_other_bars_add_no_part(bar: tuple[float, float, float, float], why: str) -> None:
    face = front()
    raised(face, bar, 0.03)
    assert not parts_from_bars(face, [DRAWER]), why


def test_a_bar_that_ends_near_an_edge_is_a_handle() -> None:
    face = face_of(0.6, 0.8, 0.0)
    raised(face, (0.85, 0.7, 0.88, 0.97), 0.03)
    (door,) = parts_from_bars(face, [DRAWER])
    assert door.kind == "door_left"


def test_a_part_that_covers_the_end_of_a_bar_does_not_own_it() -> None:
    face = front()
    raised(face, (0.85, 0.35, 0.88, 0.65), 0.03)
    (door,) = parts_from_bars(face, [replace(DRAWER, box=(0.0, 0.0, 1.0, 0.42))])
    assert door.kind == "door_left"
    np.testing.assert_allclose(door.box, (0.0, 0.35, 1.0, 0.9), atol=0.01)
    assert not parts_from_bars(face, [replace(DRAWER, box=(0.0, 0.0, 1.0, 0.55))]), "most is in it"


def test_a_bar_over_the_whole_width_is_a_handle_if_a_known_part_has_one() -> None:
    face = face_of(0.6, 0.8, 0.0)
    for top in (0.1, 0.55):
        raised(face, (0.05, top, 0.95, top + 0.03), 0.03)
    low = Part("drawer", (0.0, 0.5, 1.0, 1.0), 0.9)
    (drawer,) = parts_from_bars(face, [low])
    assert drawer.kind == "drawer"
    np.testing.assert_allclose(drawer.box, (0.0, 0.0, 1.0, 0.5), atol=0.01)


def test_a_strip_with_a_knob_and_a_face_without_depth_add_no_door() -> None:
    face = front()
    raised(face, (0.85, 0.3, 0.87, 0.4), 0.03)
    below = Part("door_left", (0.0, 0.45, 1.0, 0.9), 0.9)
    assert not parts_from_bars(face, [DRAWER, below])
    assert not parts_from_bars(face_of(0.6, 0.8), [DRAWER])
