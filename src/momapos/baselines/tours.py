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
    from python_tsp.exact import solve_tsp_dynamic_programming
    from python_tsp.heuristics import solve_tsp_local_search

    if len(positions) <= 1:
        return np.arange(len(positions))
    points = np.vstack([start, positions])
    field = np.concatenate([[0.0], potential])
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    weight = k_distance * distance + k_potential * (field[None] - field[:, None])
    weight[:, 0] = 0.0  # nobody drives back: the tour is open
    np.fill_diagonal(weight, 0.0)
    if len(positions) <= EXACT_UP_TO:
        tour, _ = solve_tsp_dynamic_programming(weight)
    else:
        # The library draws from the global generator: lend it a seeded one, and put it back.
        state = random.getstate()
        random.seed(len(points))
        try:
            tour, _ = solve_tsp_local_search(weight, x0=list(range(len(points))))
        finally:
            random.setstate(state)
    return np.array(tour[1:]) - 1
