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
    from scipy.ndimage import gaussian_filter1d

    targets = arm.chain.tool_poses(q)
    for spread in SPREADS:
        more = min(len(q) - 1, int(4 * spread))
        # Reflected at its ends, the path keeps them.
        padded = np.pad(q, ((more, more), (0, 0)), mode="reflect", reflect_type="odd")
        near = gaussian_filter1d(padded, spread, axis=0)[more:-more]
        found = follow(arm, np.clip(near, arm.chain.lower, arm.chain.upper), targets)
        if found is not None:
            found[[0, -1]] = q[[0, -1]]
            return found
    return None
