"""Doors without visible seams get equal widths; visible seams stay."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.model.records.scans import FaceImage, Part
from momapos.perception.views.front_view import equalize_doors

WIDTH, HEIGHT, PIXELS = 1.2, 0.7, 480


def face_with(*seams: float) -> FaceImage:
    """Return a plain front with noise and upright seams at these places [m]."""
    rng = np.random.default_rng(0)
    rows = round(PIXELS * HEIGHT / WIDTH)
    gray = rng.normal(120.0, 3.0, (rows, PIXELS))
    for seam in seams:
        gray[:, int(seam / WIDTH * PIXELS)] -= 40.0
    color = np.clip(gray, 0, 255)[..., None].repeat(3, axis=-1).astype(np.uint8)
    return FaceImage(color, np.zeros(gray.shape, np.float32), WIDTH, HEIGHT)


def door(left: float, right: float, *, handle: bool = True, top: float = 0.0) -> Part:
    """Return a door between two places [m], its handle at its left end."""
    box = (left / WIDTH, top, right / WIDTH, 1.0)
    held = (box[0] + 0.02, 0.5, box[0] + 0.04, 0.8) if handle else None
    return Part("door_right", box, 0.8, held)


def sides(parts: tuple[Part, ...]) -> np.ndarray:
    return np.array([(part.box[0] * WIDTH, part.box[2] * WIDTH) for part in parts])


def test_doors_without_seams_are_equally_wide_up_to_the_rim() -> None:
    believed = [door(0.02, 0.45), door(0.45, 0.9), door(0.79, 1.18)]
    expected = [(0.0, 0.4), (0.4, 0.8), (0.8, 1.2)]
    found = equalize_doors(face_with(), believed)
    np.testing.assert_allclose(sides(found), expected, atol=1e-6)
    assert [part.handle for part in found] == [part.handle for part in believed]


def test_doors_keep_visible_seams() -> None:
    seams = (0.03, 0.33, 0.8, 1.17)
    believed = [door(0.03, 0.335), door(0.335, 0.795), door(0.795, 1.17)]
    found = sides(equalize_doors(face_with(*seams), believed))
    np.testing.assert_allclose(found.ravel(), np.repeat(seams, 2)[1:-1], atol=0.006)


def test_only_the_doors_between_visible_seams_change() -> None:
    believed = [door(0.0, 0.5), door(0.5, 0.86), door(0.86, 1.2)]
    found = sides(equalize_doors(face_with(0.86), believed))
    expected = [(0.0, 0.43), (0.43, 0.86), (0.86, 1.2)]
    np.testing.assert_allclose(found, expected, atol=0.004)


@pytest.mark.parametrize(
    "believed",
    [
        [door(0.1, 0.7)],
        [door(0.1, 0.4), door(0.7, 1.1)],
        [door(0.1, 0.5), door(0.5, 1.1, top=0.3)],
        [door(0.1, 0.2), door(0.2, 1.1)],
        [door(0.1, 0.5), Part("drawer", (0.5 / 1.2, 0.0, 0.8, 1.0), 0.9)],
    ],
    ids=["alone", "apart", "of other heights", "much too unlike", "a drawer"],
)
def test_other_parts_stay_unchanged(believed: list[Part]) -> None:
    assert equalize_doors(face_with(), believed) == tuple(believed)


def test_a_row_stays_unchanged_if_a_door_would_lose_its_handle() -> None:
    believed = [door(0.0, 0.65), door(0.65, 1.2)]
    at_end = Part("door_left", believed[0].box, 0.8, (0.51, 0.5, 0.53, 0.8))
    assert equalize_doors(face_with(), [at_end, believed[1]]) == (at_end, believed[1])
