"""Test open tours."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from momapos.planning.baselines.paper_placer import open_tour


@pytest.mark.parametrize("count", [0, 1, 2, 9, 10, 13])
def test_an_open_tour_visits_every_candidate_once(count: int) -> None:
    rng = np.random.default_rng(2)
    positions, potential = rng.uniform(0, 5, (count, 2)), rng.uniform(0, 1, count)
    orders = [
        open_tour(np.zeros(2), positions, potential, k_distance=5 / 6, k_potential=1 / 6)
        for _ in range(2)
    ]
    assert sorted(orders[0].tolist()) == list(range(count))
    np.testing.assert_array_equal(*orders)


def test_the_exact_open_tour_is_the_cheapest() -> None:
    rng = np.random.default_rng(3)
    positions, potential = rng.uniform(0, 5, (6, 2)), rng.uniform(0, 1, 6)
    k_d, k_p = 0.8, 0.2
    order = open_tour(np.zeros(2), positions, potential, k_distance=k_d, k_potential=k_p)

    def cost(tour: tuple[int, ...]) -> float:
        points = np.vstack([np.zeros(2), positions[list(tour)]])
        field = np.concatenate([[0.0], potential[list(tour)]])
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        return float(k_d * length + k_p * (field[-1] - field[0]))

    best = min(cost(p) for p in permutations(range(6)))
    assert cost(tuple(order.tolist())) == pytest.approx(best)
