"""Smooth the posture of an arm with more joints than the tool's pose needs.

The path search chooses a posture at each waypoint, so that joints turn back and forth between them
while the tool moves evenly; the arm would stop at each turn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.planning.grasps import FULL_DOF

from .arm_path import follow

if TYPE_CHECKING:
    from jaxtyping import Float

    from .arm_models import ArmModel

SPREADS = (6.0, 3.0)
"""Standard deviations of the filter that are tried, in steps. Waypoints are four steps apart."""


def smooth_posture(arm: ArmModel, q: Float[np.ndarray, "d n"]) -> Float[np.ndarray, "d n"] | None:
    """Return states with the same tool poses and ends whose joints move more evenly.

    Args:
        arm: The arm.
        q: States, close together.

    Returns:
        The states; None for an arm without spare joints, or if it does not get there.
    """
    if arm.chain.size <= FULL_DOF or len(q) < 4:
        return None
    targets = arm.chain.tool_poses(q)
    for spread in SPREADS:
        near = np.clip(_smoothed(q, spread), arm.chain.lower, arm.chain.upper)
        found = follow(arm, near, targets)
        if found is not None:
            found[[0, -1]] = q[[0, -1]]
            return found
    return None


def _smoothed(q: Float[np.ndarray, "d n"], spread: float) -> Float[np.ndarray, "d n"]:
    """Filter states by a Gaussian that ends at four standard deviations (`spread`, in steps)."""
    radius = int(4 * spread)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / spread) ** 2)
    more = min(len(q) - 1, radius)
    # Reflected at its ends, the path keeps them.
    padded = np.pad(q, ((more, more), (0, 0)), mode="reflect", reflect_type="odd")
    padded = np.pad(padded, ((radius - more,) * 2, (0, 0)), mode="symmetric")
    windows = np.lib.stride_tricks.sliding_window_view(padded, len(weights), axis=0)
    return np.asarray(windows @ (weights / weights.sum()))
