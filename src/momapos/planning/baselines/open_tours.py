"""Open tours over candidates, as MoMa-Pos orders them."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int

EXACT_UP_TO = 10
"""Largest group for which the open tour is solved exactly [-]."""


def open_tour(
    start: Float[np.ndarray, "2"],
    positions: Float[np.ndarray, "n 2"],
    potential: Float[np.ndarray, " n"],
    *,
    k_distance: float,
    k_potential: float,
) -> Int[np.ndarray, " n"]:
    """The order of one group of candidates: an open tour from the start.

    The edge weight is `k1 dist(i, j) + k1' (F(j) - F(i))` as printed. The second term
    telescopes: along a tour it adds up to `k1' (F_last - F_first)`, so it only decides which
    candidate comes last, and as printed the worst does.

    Source: MoMa-Pos, section III-D.

    Args:
        start: Where the robot is [m].
        positions: Candidates [m]; exact up to `EXACT_UP_TO` of them, local search above.
        potential: Their potential.
        k_distance, k_potential: k1 and k1'.
    """
    if len(positions) <= 1:
        return np.arange(len(positions))
    points = np.vstack([start, positions])
    field = np.concatenate([[0.0], potential])
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    weight = k_distance * distance + k_potential * (field[None] - field[:, None])
    if len(positions) <= EXACT_UP_TO:
        return _exact(weight[0, 1:], weight[1:, 1:])
    weight[:, 0] = 0.0  # nobody drives back: the tour is open
    np.fill_diagonal(weight, 0.0)
    return _local_search(weight)


def _exact(first: Float[np.ndarray, " n"], weight: Float[np.ndarray, "n n"]) -> np.ndarray:
    """The cheapest order (Held and Karp 1962), over the sets of what has been visited by size.

    The library's takes tens of milliseconds for ten candidates, this one two.

    Args:
        first: Weight from the start to each.
        weight: Weight from each to each.
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
            ways = cost[visited ^ (1 << last)] + weight[:, last]
            before[visited, last] = ways.argmin(1)
            cost[visited, last] = ways.min(1)
    visited, last = 2**count - 1, int(cost[-1].argmin())
    tour = []
    for _ in range(count):
        tour.append(last)
        visited, last = visited ^ (1 << last), int(before[visited, last])
    return np.array(tour[::-1])


def _local_search(weight: Float[np.ndarray, "m m"]) -> np.ndarray:
    """A short tour from the first point."""
    from python_tsp.heuristics import solve_tsp_local_search

    # The library draws from the global generator: lend it a seeded one, and put it back.
    state = random.getstate()
    random.seed(len(weight))
    try:
        tour, _ = solve_tsp_local_search(weight, x0=list(range(len(weight))))
    finally:
        random.setstate(state)
    return np.array(tour[1:]) - 1
