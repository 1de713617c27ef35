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

MAX_CHOICES = 500
"""Number of base poses among which the integer program chooses [-]. With 1,500 it takes 4 times as
long for 300 tool poses, and finds as few stops on drawn sets."""
MAX_SECONDS = 5.0
"""Time after which the integer program returns its best choice [s]."""


def cover_choices(
    serves: Bool[np.ndarray, "n p"], cost: Float[np.ndarray, " n"]
) -> Int[np.ndarray, " k"]:
    """Return base poses to choose among: the cheapest of each set, and no subset of another.

    Of too many, for each tool pose those that serve most.
    """
    order = np.lexsort((cost, -serves.sum(1)))
    order = order[serves[order].any(1)]
    _, first = np.unique(_hashes(serves[order]), return_index=True)
    rows = order[np.sort(first)]
    if len(rows) > MAX_CHOICES:
        ranks = np.where(serves[rows], np.cumsum(serves[rows], axis=0), len(rows))
        kept = np.argsort(ranks.min(1), kind="stable")[:MAX_CHOICES]
        rows = rows[np.sort(kept)]
    chosen = serves[rows].astype(np.float32)
    shared, size = chosen @ chosen.T, chosen.sum(1)
    larger = (shared >= size[:, None]) & (size[None] > size[:, None])
    return rows[~larger.any(1)]


def _hashes(sets: Bool[np.ndarray, "n p"]) -> Int[np.ndarray, " n"]:
    """Return a number for each set, equal for equal sets (Zobrist 1970)."""
    packed = np.packbits(sets, axis=1)
    rng = np.random.default_rng(0)
    table = rng.integers(0, 1 << 63, (packed.shape[1], 256), dtype=np.int64)
    return np.bitwise_xor.reduce(table[np.arange(packed.shape[1]), packed], axis=1)


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
    return _program(serves, cost)


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
        # Of the sum, the number of base poses is exact then.
        options={"time_limit": MAX_SECONDS, "mip_rel_gap": 0.5 / len(greedy)},
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
