"""Choose the fewest base poses that together serve a set of tool poses.

Each base pose serves some of the tool poses, so this is the set cover problem, as in base placement
for drilling (MoboTSP: Nguyen et al. 2023). Base poses that serve no more than another one are left
out, and an integer program chooses among the rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MAX_CHOICES = 1_500
"""Number of base poses among which the integer program chooses [-]; the solver takes about 0.1 s
for 200 tool poses then. For each tool pose, the base poses that serve most are among them."""
MAX_SECONDS = 5.0
"""Time after which the integer program returns its best choice [s]."""


def fewest_serving_all(
    serves: Bool[np.ndarray, "n p"], cost: Float[np.ndarray, " n"]
) -> Int[np.ndarray, " k"]:
    """Return the fewest base poses that serve all tool poses, of these nearly the cheapest.

    Args:
        serves: Which tool poses each base pose serves; each is served by at least one.
        cost: A cost of each base pose, at least 0; one more base pose is never cheaper.
    """
    cost = cost / max(float(cost.max(initial=0.0)), 1e-9)
    all_served = np.flatnonzero(serves.all(1))
    if len(all_served):
        return all_served[[int(cost[all_served].argmin())]]
    rows = _choices(serves, cost)
    return rows[_program(serves[rows], cost[rows])]


def _choices(serves: Bool[np.ndarray, "n p"], cost: Float[np.ndarray, " n"]) -> np.ndarray:
    """Return base poses to choose among: the cheapest of each set, and no subset of another."""
    order = np.lexsort((cost, -serves.sum(1)))
    _, first = np.unique(np.packbits(serves[order], axis=1), axis=0, return_index=True)
    rows = order[np.sort(first)]
    if len(rows) > MAX_CHOICES:
        ranks = np.where(serves[rows], np.cumsum(serves[rows], axis=0), len(rows))
        # Of each tool pose in turn the base pose that serves most.
        rows = rows[np.argsort(ranks.min(1), kind="stable")[:MAX_CHOICES]]
        rows = rows[np.argsort(-serves[rows].sum(1), kind="stable")]
    chosen = serves[rows].astype(np.float32)
    shared, size = chosen @ chosen.T, chosen.sum(1)
    larger = (shared >= size[:, None]) & (size[None] > size[:, None])
    return rows[~larger.any(1)]


def _program(serves: Bool[np.ndarray, "n p"], cost: Float[np.ndarray, " n"]) -> np.ndarray:
    """Solve the set cover problem; the cost decides between choices of the same number."""
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csr_array

    greedy = _greedy(serves, cost)
    if len(greedy) <= 2:  # one was excluded before
        pairs = _pairs(serves, cost)
        return greedy if pairs is None else pairs
    found = milp(
        1.0 + cost / (len(greedy) + 1),
        integrality=np.ones(len(serves)), bounds=Bounds(0.0, 1.0),
        constraints=LinearConstraint(csr_array(serves.T.astype(float)), lb=1.0),
        options={"time_limit": MAX_SECONDS},
    )  # fmt: skip
    if found.x is None:
        return greedy
    rows = np.flatnonzero(found.x > 0.5)
    return rows if serves[rows].any(0).all() else greedy


def _pairs(serves: Bool[np.ndarray, "n p"], cost: Float[np.ndarray, " n"]) -> np.ndarray | None:
    """Return the cheapest pair that serves all; None without any."""
    missing = (~serves).astype(np.float32)
    both = (missing @ missing.T) == 0.0
    if not both.any():
        return None
    sums = np.where(both, cost[:, None] + cost[None], np.inf)
    return np.array(np.unravel_index(int(sums.argmin()), sums.shape))


def _greedy(serves: Bool[np.ndarray, "n p"], cost: Float[np.ndarray, " n"]) -> np.ndarray:
    """Take the base pose that serves most of the rest, again and again."""
    left, rows = np.ones(serves.shape[1], bool), []
    while left.any():
        gain = serves[:, left].sum(1)
        rows.append(int(np.lexsort((cost, -gain))[0]))
        left &= ~serves[rows[-1]]
    return np.array(rows)
