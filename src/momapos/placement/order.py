"""In which order candidates are tried."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int


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
