"""Laws of short orders: exact for few points, and no better by one change for many."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from momapos.core.short_paths import MAX_EXACT, improved_order, path_length, shortest_order


def lengths(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return lengths from a start, between points, and to an end, of drawn points."""
    points = np.random.default_rng(seed).uniform(size=(count + 2, 2))
    D = np.linalg.norm(points[:, None] - points, axis=-1)
    return D[0, 1:-1], D[1:-1, 1:-1], D[-1, 1:-1]


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_no_order_of_few_points_is_shorter(count: int) -> None:
    given = lengths(count, count)
    least = min(path_length(np.array(one), *given) for one in permutations(range(count)))
    assert path_length(shortest_order(*given), *given) == pytest.approx(least)


def test_an_order_of_many_points_has_each_once_and_no_shorter_reversal() -> None:
    given = lengths(MAX_EXACT + 20, 0)
    order = shortest_order(*given)
    assert sorted(order) == list(range(len(order)))
    found = path_length(order, *given)
    for i in range(len(order)):
        for j in range(i + 2, len(order) + 1):
            other = np.concatenate([order[:i], order[i:j][::-1], order[j:]])
            assert path_length(other, *given) >= found - 1e-9


def test_an_improved_order_is_not_longer() -> None:
    for seed in range(5):
        given = lengths(15, seed)
        order = np.random.default_rng(seed).permutation(15)
        better = improved_order(order, *given)
        assert path_length(better, *given) <= path_length(order, *given)


def test_without_points_the_order_is_empty() -> None:
    assert len(shortest_order(np.zeros(0), np.zeros((0, 0)), np.zeros(0))) == 0
