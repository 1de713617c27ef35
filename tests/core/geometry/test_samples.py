"""Sample points equal those of scipy and are evenly distributed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc

from momapos.core.geometry.points import halton, latin_hypercube


@pytest.mark.parametrize(("count", "dimensions"), [(1, 1), (7, 3), (512, 3), (1024, 3), (100, 8)])
def test_latin_hypercube_draws_the_same_numbers_as_scipy(count: int, dimensions: int) -> None:
    for seed in range(5):
        ours, theirs = np.random.default_rng(seed), np.random.default_rng(seed)
        for _ in range(2):
            expected = qmc.LatinHypercube(dimensions, rng=theirs).random(count)
            np.testing.assert_array_equal(latin_hypercube(ours, count, dimensions), expected)
        assert ours.random() == theirs.random()


@pytest.mark.parametrize(("count", "dimensions"), [(1, 1), (65, 6), (257, 8), (5000, 40)])
def test_halton_returns_the_same_sequence_as_scipy(count: int, dimensions: int) -> None:
    expected = qmc.Halton(dimensions, scramble=False).random(count)
    np.testing.assert_array_equal(halton(count, dimensions), expected)


def test_each_slice_of_a_latin_hypercube_contains_one_point() -> None:
    points = latin_hypercube(np.random.default_rng(0), 50, 4)
    for column in points.T:
        assert sorted(np.floor(column * 50).astype(int)) == list(range(50))
