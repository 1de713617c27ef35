"""Strips next to doors may be frames of their leaves."""

from __future__ import annotations

import numpy as np
import pytest
from tests.perception.reconstruction.fronts import face_of, raised

from momapos.model.records.scans import FaceImage, Part
from momapos.perception.reconstruction.alignment import align, with_frames
from momapos.perception.reconstruction.height_maps import Area

WIDTH, HEIGHT, FRAME = 0.7, 0.9, 0.08  # [m]
SEEN = Area(0.0, 0.0, WIDTH - FRAME, HEIGHT)
"""A door without one side of its frame."""


def lined(face: FaceImage, *places: float) -> FaceImage:
    """Return a face with dark upright lines at places along x [m]."""
    for x in places:
        face.color[:, round(x / face.width * face.color.shape[1])] = 120
    return face


def framed() -> FaceImage:
    """Return a flat face with the two inner lines of a frame."""
    return lined(face_of(WIDTH, HEIGHT, 0.0), FRAME, WIDTH - FRAME)


def test_a_door_extends_to_the_rim_over_the_frame_of_its_leaf() -> None:
    assert with_frames([SEEN], framed()) == [Area(0.0, 0.0, WIDTH, HEIGHT)]
    other = Area(FRAME, 0.0, WIDTH, HEIGHT)
    assert with_frames([None, other], framed()) == [None, Area(0.0, 0.0, WIDTH, HEIGHT)]


def test_the_hinge_is_then_at_the_rim() -> None:
    seen = Part("door_right", (0.0, 0.0, 1 - FRAME / WIDTH, 1.0), 0.9)
    (part,) = align(framed(), [seen])
    assert part.area.right == WIDTH


def test_the_symmetric_line_of_a_double_door_is_at_the_seam() -> None:
    middle = WIDTH / 2
    pair = [Area(0.0, 0.0, middle, HEIGHT), Area(middle, 0.0, WIDTH - FRAME, HEIGHT)]
    face = lined(face_of(WIDTH, HEIGHT, 0.0), middle, middle + FRAME, WIDTH - FRAME)
    assert with_frames(pair, face)[1] == Area(middle, 0.0, WIDTH, HEIGHT)
    assert with_frames(pair, framed()) == pair


@pytest.mark.parametrize("out", [-0.02, 0.02, np.nan])
def test_a_strip_off_the_plane_of_the_door_or_unmeasured_is_not_its_frame(out: float) -> None:
    face = framed()
    raised(face, (1 - FRAME / WIDTH, 0.0, 1.0, 1.0), out)
    assert with_frames([SEEN], face) == [SEEN]


def test_a_seam_without_a_symmetric_line_ends_a_door() -> None:
    face = lined(face_of(WIDTH, HEIGHT, 0.0), WIDTH - FRAME)
    assert with_frames([SEEN], face) == [SEEN]
    assert with_frames([SEEN], face_of(WIDTH, HEIGHT, 0.0)) == [SEEN]


def test_a_body_that_shows_on_both_sides_stays() -> None:
    both = Area(0.03, 0.0, WIDTH - FRAME, HEIGHT)
    face = lined(framed(), 0.03 + FRAME)
    assert with_frames([both], face) == [both]


def test_another_part_next_to_a_door_is_not_its_frame() -> None:
    below = Area(WIDTH - FRAME, 0.0, WIDTH, 0.2)
    assert with_frames([SEEN, below], framed()) == [SEEN, below]
