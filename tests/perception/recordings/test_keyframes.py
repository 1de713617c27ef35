"""Choice of the frames of a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy import ndimage

from momapos.core.errors import FileFormatError, InputError
from momapos.perception.recordings.images import (
    choose,
    laplacian_variance,
    read_small_gray,
    sharpness_of,
)


def walk(steps: list[float]) -> np.ndarray:
    """Return a straight walk by steps [m]."""
    poses = np.tile(np.eye(4), (len(steps) + 1, 1, 1))
    poses[1:, 0, 3] = np.cumsum(steps)
    return poses


@given(st.lists(st.floats(0, 0.1), min_size=1, max_size=300), st.integers(1, 60))
def test_chosen_frames_are_unique_in_order_and_within_the_limit(
    steps: list[float], limit: int
) -> None:
    chosen = choose(walk(steps), limit)
    assert len(chosen) <= min(limit, len(steps) + 1)
    assert chosen == sorted(set(chosen))
    if len(steps) + 1 <= limit:
        assert chosen == list(range(len(steps) + 1))


def test_frames_of_an_even_walk_are_chosen_evenly() -> None:
    assert choose(walk([0.1] * 20), 5) == [0, 5, 10, 15, 20]
    with pytest.raises(InputError, match="at least 1"):
        choose(walk([0.1]), 0)


def test_few_frames_are_chosen_while_the_camera_rests() -> None:
    poses = walk([0.0] * 500 + [0.01] * 500)
    chosen = np.array(choose(poses, 100))
    assert (chosen < 500).sum() < 15
    turning = np.tile(np.eye(4), (1001, 1, 1))
    c, s = np.cos(np.linspace(0, 3, 501)), np.sin(np.linspace(0, 3, 501))
    turning[500:, 0, 0], turning[500:, 0, 2] = c, s
    turning[500:, 2, 0], turning[500:, 2, 2] = -s, c
    assert (np.array(choose(turning, 100)) < 500).sum() < 15


def test_the_sharpest_of_neighboring_frames_is_chosen() -> None:
    poses = walk([0.005] * 999)
    sharp = set(range(3, 1000, 5))
    chosen = choose(poses, 50, lambda k: float(k in sharp))
    assert len(chosen) == 50
    assert np.mean([k in sharp for k in chosen]) > 0.5
    assert np.mean([k in sharp for k in choose(poses, 50)]) < 0.4


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_blur_is_detected_in_small_decoded_images(suffix: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    scene = np.kron(rng.integers(0, 256, (24, 32, 3)), np.ones((20, 20, 1)))
    files = []
    for k, blur in enumerate((0, 4, 16)):
        image = ndimage.uniform_filter1d(scene, blur, axis=1) if blur else scene
        files.append(tmp_path / f"{k}.{suffix}")
        Image.fromarray(image.astype(np.uint8)).save(files[-1])
    assert max(read_small_gray(files[0]).shape) <= 320
    sharpness = sharpness_of([*files, tmp_path / "none.jpg"])
    values = [sharpness(k) for k in range(4)]
    assert values == sorted(values, reverse=True)
    assert values[3] == -np.inf
    with pytest.raises(FileFormatError):
        read_small_gray(tmp_path / "none.jpg")


def test_a_flat_image_has_no_edges() -> None:
    assert laplacian_variance(np.full((9, 9), 7.0)) == 0.0
    assert laplacian_variance(np.eye(2)) == 0.0
