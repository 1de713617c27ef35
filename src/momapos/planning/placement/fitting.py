"""Base poses for arms of few joints, which follow a motion from places of no size."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from .area import PlacementGeometry, within_reach

if TYPE_CHECKING:
    from jaxtyping import Float, Int

FitPoses: TypeAlias = (
    "Callable[[Float[np.ndarray, 'n 3']], tuple[Float[np.ndarray, 'n 3'], Int[np.ndarray, ' n']]]"
)
"""Move base poses to some beside them, and tell by which way of holding the task can be done from
each; -1: none was found."""
_BLOCK = 512
"""Poses that are fitted together [-]."""


def fitted(
    fit: FitPoses | None,
    geometry: PlacementGeometry,
    poses: Float[np.ndarray, "n 3"],
    out_of_time: Callable[[], bool],
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"] | None] | None:
    """Fit the base poses from which the arm is long enough; leave them where it needs no fit.

    Returns:
        Where each has come to, and its way of holding, or -1, where they are fitted; None: out of
        time.
    """
    if fit is None:
        return poses, None
    poses, own = poses.copy(), np.full(len(poses), -1)
    near = np.flatnonzero(within_reach(geometry, poses))
    for first in range(0, len(near), _BLOCK):
        if out_of_time():
            return None
        rows = near[first : first + _BLOCK]
        poses[rows], own[rows] = fit(poses[rows])
    return poses, own
