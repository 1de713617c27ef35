"""Fit base poses to arms of few joints, which follow a motion only from isolated base poses."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import look

from .area import PlacementGeometry, within_reach

if TYPE_CHECKING:
    from jaxtyping import Float, Int

FitPoses: TypeAlias = (
    "Callable[[Float[np.ndarray, 'n 3']], tuple[Float[np.ndarray, 'n 3'], Int[np.ndarray, ' n']]]"
)
"""Move base poses to feasible ones nearby; return them and the grasp mode of each, or -1."""
_BLOCK = 512
"""Poses fitted between two checks of the time limit [-]."""


def fitted(
    fit: FitPoses | None,
    geometry: PlacementGeometry,
    poses: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"] | None]:
    """Fit the base poses within the arm's reach; return them unchanged if `fit` is None.

    Returns:
        The fitted poses and the grasp mode of each (-1: none found; None: not fitted).
    """
    if fit is None:
        return poses, None
    poses, own = poses.copy(), np.full(len(poses), -1)
    near = np.flatnonzero(within_reach(geometry, poses))
    for first in range(0, len(near), _BLOCK):
        look()
        rows = near[first : first + _BLOCK]
        poses[rows], own[rows] = fit(poses[rows])
    return poses, own
