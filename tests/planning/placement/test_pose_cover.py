"""Laws of the fewest base poses that serve all tool poses."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from momapos.planning.placement.pose_cover import cover_choices, fewest_serving_all


def drawn(seed: int, bases: int = 14, poses: int = 9) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    serves = rng.uniform(size=(bases, poses)) < 0.35
    serves[rng.integers(bases, size=poses), np.arange(poses)] = True
    return serves, rng.uniform(size=bases)


@pytest.mark.parametrize("seed", range(12))
def test_no_fewer_base_poses_serve_all(seed: int) -> None:
    serves, cost = drawn(seed)
    found = fewest_serving_all(serves, cost)
    assert serves[found].any(0).all()
    fewer = combinations(range(len(serves)), len(found) - 1)
    assert not any(serves[list(rows)].any(0).all() for rows in fewer if rows)


def test_one_base_pose_that_serves_all_is_the_cheapest_of_these() -> None:
    serves = np.array([[1, 0], [1, 1], [1, 1]], bool)
    assert fewest_serving_all(serves, np.array([0.0, 2.0, 1.0])).tolist() == [2]


@pytest.mark.parametrize("seed", range(5))
def test_the_choices_serve_all_and_no_set_is_within_another(seed: int) -> None:
    serves, cost = drawn(seed, bases=60)
    rows = cover_choices(serves, cost)
    assert serves[rows].any(0).all()
    for a in rows:
        assert not any((serves[a] <= serves[b]).all() for b in rows if b != a)


def test_of_equal_sets_the_cheapest_is_a_choice() -> None:
    serves = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]], bool)
    assert sorted(cover_choices(serves, np.array([3.0, 1.0, 2.0]))) == [1, 2]
