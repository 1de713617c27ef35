"""Seams between doors are more distinct than the grain of the wood."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.core.geometry.line_detection import dark_lines


@pytest.fixture
def wood() -> np.ndarray:
    """A dark front with noise and an upright grain, without a seam."""
    rng = np.random.default_rng(0)
    grain = rng.normal(0.0, 1.5, (1, 300)) + rng.normal(0.0, 4.0, (200, 300))
    return np.clip(70.0 + grain, 0, 255)[..., None].repeat(3, axis=-1).astype(np.uint8)


def test_a_seam_hardly_darker_than_the_grain_has_the_highest_contrast(wood: np.ndarray) -> None:
    wood[:, 120] -= np.uint8(14)
    lines = dark_lines(wood, 1)
    column = lines.mean(axis=0)
    assert column.argmax() == 120
    assert column[120] > 2 * np.delete(column, 120).max()
    assert dark_lines(wood, 0).max() < column[120]


def test_lines_transpose_and_mirror_with_the_image(wood: np.ndarray) -> None:
    lines = dark_lines(wood, 1)
    np.testing.assert_allclose(dark_lines(wood.swapaxes(0, 1), 0), lines.T, atol=1e-5)
    np.testing.assert_allclose(dark_lines(wood[:, ::-1], 1), lines[:, ::-1], atol=1e-5)


def test_a_step_in_brightness_is_not_a_line() -> None:
    step = np.full((60, 60, 3), 40, np.uint8)
    step[:, 30:] = 200
    assert dark_lines(step, 1).max() == 0.0
    assert dark_lines(step, 0).max() == 0.0
