"""The front network finds clear parts, and its results are valid."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from momapos.core.errors import InputError, MissingExtraError
from momapos.model.records.scans import FaceImage
from momapos.perception.reconstruction import decode
from momapos.perception.reconstruction import front_network as network
from momapos.perception.reconstruction.front_network import (
    MAX_OVERLAP,
    MIN_PART_SCORE,
    FrontNetwork,
)

HINGES = {"door_left": "door_right", "door_right": "door_left"}


def cabinet(side: int = 360) -> FaceImage:
    """Return two drawers above two doors with dark knobs, painted flat."""
    image = np.full((side, side, 3), 205, np.uint8)
    scale = side / 360

    def fill(left: int, top: int, right: int, bottom: int, value: int) -> None:
        rows = slice(int(top * scale), int(bottom * scale))
        image[rows, int(left * scale) : int(right * scale)] = value

    for left, right in ((20, 176), (184, 340)):
        for top, bottom in ((20, 100), (110, 340)):
            fill(left, top, right, bottom, 70)
            fill(left + 2, top + 2, right - 2, bottom - 2, 215)
        fill((left + right) // 2 - 8, 52, (left + right) // 2 + 8, 68, 30)
    fill(156, 150, 168, 164, 30)
    fill(192, 150, 204, 164, 30)
    blank = np.full((side, side), np.nan, np.float32)
    return FaceImage(image, blank, 0.9, 0.9)


def wall() -> FaceImage:
    """Return a bare wall."""
    noise = np.random.default_rng(0).normal(180, 3, (200, 300, 3))
    return FaceImage(noise.astype(np.uint8), np.zeros((200, 300), np.float32), 3.0, 2.0)


def test_doors_and_drawers_of_a_plain_cabinet_are_found() -> None:
    front = FrontNetwork()(cabinet(), "cabinet")
    true = np.array(
        [[20, 20, 176, 100], [184, 20, 340, 100], [20, 110, 176, 340], [184, 110, 340, 340]]
    )
    found = np.array([part.box for part in front.parts])
    common = decode.overlaps(true / 360, found)[0]
    assert len(found) == 4
    assert common.max(axis=1).min() > 0.75
    kinds = [front.parts[j].kind for j in common.argmax(axis=1)]
    assert kinds == ["drawer", "drawer", "door_left", "door_right"]
    assert front.score > 0.5


def test_a_bare_wall_has_no_parts() -> None:
    front = FrontNetwork()(wall(), "cabinet")
    assert front.parts == ()
    assert front.score < 0.5


def test_a_mirror_swaps_the_hinges() -> None:
    face = cabinet()
    mirrored = replace(face, color=np.ascontiguousarray(face.color[:, ::-1]))
    kinds = sorted(part.kind for part in FrontNetwork()(face, "").parts)
    swapped = sorted(
        HINGES.get(part.kind, part.kind) for part in FrontNetwork()(mirrored, "").parts
    )
    assert kinds == swapped


def test_parts_are_sorted_by_score_within_the_face_and_disjoint() -> None:
    front = FrontNetwork()(cabinet(), "cabinet")
    boxes = np.array([part.box for part in front.parts])
    assert boxes.min() >= 0.0
    assert boxes.max() <= 1.0
    common = decode.overlaps(boxes, boxes)[1] - np.eye(len(boxes))
    assert common.max() < MAX_OVERLAP
    scores = [part.score for part in front.parts]
    assert scores == sorted(scores, reverse=True)
    for part in front.parts:
        assert MIN_PART_SCORE <= part.score <= 1.0
        if part.handle is not None:
            left, top, right, bottom = part.handle
            assert part.box[0] <= left < right <= part.box[2]
            assert part.box[1] <= top < bottom <= part.box[3]


def test_the_same_face_always_gives_the_same_result() -> None:
    first, again = (FrontNetwork()(cabinet(), "cabinet") for _ in range(2))
    assert first == again


def test_resolution_hardly_matters() -> None:
    small, large = (FrontNetwork()(cabinet(side), "") for side in (240, 720))
    a, b = (np.array([part.box for part in front.parts]) for front in (small, large))
    assert len(a) == len(b)
    assert decode.overlaps(a, b)[0].max(axis=1).min() > 0.8


@pytest.mark.parametrize("shape", [(1, 40), (0, 0), (40, 1)])
def test_an_empty_face_is_refused(shape: tuple[int, int]) -> None:
    face = FaceImage(np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32), 1.0, 1.0)
    with pytest.raises(InputError, match="at least 2 x 2"):
        FrontNetwork()(face, "fridge")


def test_an_error_about_a_missing_runtime_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    network._session.cache_clear()
    with pytest.raises(MissingExtraError, match="onnxruntime is not installed; pip install"):
        FrontNetwork()


BOXES = hnp.arrays(float, (6, 2, 2), elements=st.floats(0, 1)).map(
    lambda corners: np.concatenate((corners.min(axis=1), corners.max(axis=1) + 0.01), axis=1)
)


@settings(max_examples=40)
@given(BOXES, hnp.arrays(float, 6, elements=st.floats(0, 1)), st.floats(0.2, 0.9))
def test_kept_boxes_do_not_overlap(boxes: np.ndarray, scores: np.ndarray, limit: float) -> None:
    kept = decode.distinct(boxes, scores, limit, nested=True)
    common = decode.overlaps(boxes[kept], boxes[kept])[1]
    np.fill_diagonal(common, 0.0)
    assert common.max() < limit
    assert kept[0] == int(np.argmax(scores))


@given(st.floats(0.05, 0.4), st.floats(0.5, 0.95), st.integers(8, 200))
@settings(max_examples=30)
def test_a_ramp_resampled_is_the_same_ramp(low: float, high: float, length: int) -> None:
    ramp = (np.arange(length, dtype=np.float32) + 0.5) / length
    stack = np.tile(ramp[None, :, None], (length, 1, 1))
    out = decode.resample(stack, np.array([low, low, high, high]), 32)[0]
    expected = low + (high - low) * (np.arange(32) + 0.5) / 32
    inside = (expected > 1.5 / length) & (expected < 1 - 1.5 / length)
    step = 1 / length
    assert np.abs(out[16] - expected)[inside].max(initial=0.0) < step
