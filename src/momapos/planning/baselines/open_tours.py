"""Order candidates by open tours, as MoMa-Pos does."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int

MAX_EXACT = 10
"""Largest group whose open tour is solved exactly [-]."""


def open_tour(
    start: Float[np.ndarray, "2"],
    positions: Float[np.ndarray, "n 2"],
    potential: Float[np.ndarray, " n"],
    *,
    k_distance: float,
    k_potential: float,
) -> Int[np.ndarray, " n"]:
    """Order one group of candidates by an open tour from the start.

    The edge weight is `k1 dist(i, j) + k1' (F(j) - F(i))` as printed. The second term
    telescopes to `k1' (F_last - F_first)` along a tour. So it only decides which candidate comes
    last, and as printed this is the worst one.

    Source: MoMa-Pos, section III-D.

    Args:
        start: Position of the robot [m].
        positions: Candidates [m]; more than `MAX_EXACT` are ordered by local search.
        potential: Potential of each.
        k_distance, k_potential: k1 and k1'.
    """
    if len(positions) <= 1:
        return np.arange(len(positions))
    points = np.vstack([start, positions])
    field = np.concatenate([[0.0], potential])
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    weight = k_distance * distance + k_potential * (field[None] - field[:, None])
    if len(positions) <= MAX_EXACT:
        return _exact(weight[0, 1:], weight[1:, 1:])
    weight[:, 0] = 0.0  # no cost to return: the tour is open
    np.fill_diagonal(weight, 0.0)
    return _local_search(weight)


def _exact(first: Float[np.ndarray, " n"], weight: Float[np.ndarray, "n n"]) -> np.ndarray:
    """Solve for the cheapest order by dynamic programming over visited sets (Held and Karp 1962).

    Takes 2 ms for ten candidates; the library function takes tens of milliseconds.

    Args:
        first: Weight from the start to each candidate.
        weight: Weight between candidates.
    """
    count = len(first)
    sets = np.arange(2**count)
    sizes = (sets[:, None] >> np.arange(count) & 1).sum(1)
    cost = np.full((2**count, count), np.inf)
    before = np.zeros((2**count, count), int)
    cost[1 << np.arange(count), np.arange(count)] = first
    for size in range(2, count + 1):
        of_size = sets[sizes == size]
        for last in range(count):
            visited = of_size[of_size >> last & 1 == 1]
            costs = cost[visited ^ (1 << last)] + weight[:, last]
            before[visited, last] = costs.argmin(1)
            cost[visited, last] = costs.min(1)
    visited, last = 2**count - 1, int(cost[-1].argmin())
    tour = []
    for _ in range(count):
        tour.append(last)
        visited, last = visited ^ (1 << last), int(before[visited, last])
    return np.array(tour[::-1])


def _local_search(weight: Float[np.ndarray, "m m"]) -> np.ndarray:
    from python_tsp.heuristics import solve_tsp_local_search

    # The library draws from the global generator: seed it and restore its state.
    state = random.getstate()
    random.seed(len(weight))
    try:
        tour, _ = solve_tsp_local_search(weight, x0=list(range(len(weight))))
    finally:
        random.setstate(state)
    return np.array(tour[1:]) - 1
