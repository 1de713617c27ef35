"""Order base poses by expected cost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int


def by_expected_cost(
    known: Float[np.ndarray, " n"], odds: Float[np.ndarray, " n"], *, miss: float
) -> Int[np.ndarray, " m"]:
    """Return the order by known cost plus expected cost of a miss, cheapest first.

    Args:
        known: Cost of each pose before it has a path; poses of infinite cost are left out.
        odds: Estimated probability that it works, in [0, 1].
        miss: Cost of a certain miss, in meters of driving of weight 1 [m].
    """
    key = known + miss * (1.0 - odds)
    order = np.argsort(key, kind="stable")
    return order[np.isfinite(key[order])]
