"""In which order candidates are tried."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int

EXACT_UP_TO = 10
"""Largest group for which the open tour is solved exactly [-]."""


def by_expected_cost(
    travel: Float[np.ndarray, " n"], odds: Float[np.ndarray, " n"], *, miss: float
) -> Int[np.ndarray, " m"]:
    """Ours: driving length plus what a likely miss costs, cheapest first.

    Args:
        travel: Driving length to each candidate [m]; those out of reach are left out.
        odds: Chance that it works, in [0, 1].
        miss: Driving length that a certain miss is worth [m].
    """
    key = travel + miss * (1.0 - odds)
    order = np.argsort(key, kind="stable")
    return order[np.isfinite(key[order])]


def open_tours(
    start: Float[np.ndarray, "2"],
    positions: Float[np.ndarray, "n 2"],
    potential: Float[np.ndarray, " n"],
    *,
    group: int,
    k_distance: float,
    k_potential: float,
) -> Int[np.ndarray, " n"]:
    """The paper: groups of T, each visited by an open tour from the start.

    The edge weight is `k1 dist(i, j) + k1' (F(j) - F(i))` as printed. The second term
    telescopes: along a tour it adds up to `k1' (F_last - F_first)`, so it only decides which
    candidate comes last, and as printed the worst does. It is kept so for comparison.

    Source: MoMa-Pos, section III-D.

    Args:
        start: Where the robot is [m].
        positions: Candidates [m], in the order in which they are grouped.
        potential: Their potential.
        group: T, the size of a group [-]; exact up to `EXACT_UP_TO`, local search above.
        k_distance, k_potential: k1 and k1'.
    """
    order = []
    for first in range(0, len(positions), group):
        members = np.arange(first, min(first + group, len(positions)))
        tour = _open_tour(start, positions[members], potential[members], k_distance, k_potential)
        order.append(members[tour])
    return np.concatenate(order) if order else np.zeros(0, int)


def _open_tour(
    start: np.ndarray, positions: np.ndarray, potential: np.ndarray, k_d: float, k_p: float
) -> np.ndarray:
    from python_tsp.exact import solve_tsp_dynamic_programming
    from python_tsp.heuristics import solve_tsp_local_search

    points = np.vstack([start, positions])
    field = np.concatenate([[0.0], potential])
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    weight = k_d * distance + k_p * (field[None] - field[:, None])
    weight[:, 0] = 0.0  # nobody drives back: the tour is open
    np.fill_diagonal(weight, 0.0)
    if len(points) <= 2:
        return np.arange(len(positions))
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
