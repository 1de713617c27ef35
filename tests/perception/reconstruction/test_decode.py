"""Network inputs and part odds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from momapos.model.records.scans import FaceImage, Part, PartKind
from momapos.perception.reconstruction import decode


@pytest.fixture
def wood() -> np.ndarray:
    """Return a dark front with noise and an upright grain, without a seam."""
    rng = np.random.default_rng(0)
    grain = rng.normal(0.0, 1.5, (1, 300)) + rng.normal(0.0, 4.0, (200, 300))
    return np.clip(70.0 + grain, 0, 255)[..., None].repeat(3, axis=-1).astype(np.uint8)


def test_heights_are_relative_to_the_fronts_and_not_to_the_box(wood: np.ndarray) -> None:
    height_map = np.zeros(wood.shape[:2], np.float32)
    height_map[90:110, 40:60] = 0.04
    near, far = (
        decode.planes(FaceImage(wood, height_map + np.float32(off), 0.9, 0.6))
        for off in (0.0, -0.1)
    )
    np.testing.assert_allclose(near, far, atol=1e-5)
    assert near[100, 50, 3] == pytest.approx(0.5, abs=1e-4)


def test_a_face_without_depth_has_zero_heights(wood: np.ndarray) -> None:
    stack = decode.planes(FaceImage(wood, np.full(wood.shape[:2], np.nan, np.float32), 0.9, 0.6))
    assert stack.shape == (200, 300, 7)
    assert np.isfinite(stack).all()
    assert not stack[..., 3:5].any()


@pytest.mark.parametrize("kind", decode.KINDS)
def test_doubt_gives_every_kind_a_probability_and_keeps_the_most_probable_one(
    kind: PartKind,
) -> None:
    sure = Part(kind, (0.0, 0.0, 1.0, 1.0), 0.9, None, ((kind, 1.0),))
    odds = decode.with_doubt(sure).odds
    assert {name for name, _ in odds} == set(decode.KINDS)
    assert sum(share for _, share in odds) == pytest.approx(1.0)
    assert odds[0][0] == kind
    assert min(share for _, share in odds) == pytest.approx(decode.DOUBT / len(decode.KINDS))
    assert decode.with_doubt(replace(sure, odds=())).odds == ()
