"""In which order candidates are tried."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int


def by_expected_cost(
    known: Float[np.ndarray, " n"], odds: Float[np.ndarray, " n"], *, miss: float
) -> Int[np.ndarray, " m"]:
    """Ours: what is known of the cost plus what a likely miss costs, cheapest first.

    Args:
        known: What each candidate costs before it has a path; those at infinity are left out.
        odds: Chance that it works, in [0, 1].
        miss: What a certain miss costs, in meters of driving of weight 1 [m].
    """
    key = known + miss * (1.0 - odds)
    order = np.argsort(key, kind="stable")
    return order[np.isfinite(key[order])]
