"""Arm states near given ones that reach tool poses: damped least squares for all states at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert

from .chain import Chain
from .dexterity import jacobians

if TYPE_CHECKING:
    from jaxtyping import Float

_STEPS, _DAMPING = 30, 1e-3
"""Newton steps, and the damping of their normal equations [-]; a state near its start needs four.
"""
MAX_ERROR = 1e-4
"""Largest error of a tool pose, in position [m] and in rotation [rad]."""


def track_tools(
    chain: Chain,
    q: Float[np.ndarray, "m n"],
    Ts_base_tool: Float[np.ndarray, "m 4 4"],
    max_error: float = MAX_ERROR,
) -> Float[np.ndarray, "m n"] | None:
    """Return arm states near given ones that reach tool poses (Wampler, damped inverse, 1986).

    The states stay on the branch on which they start, so continuous states stay continuous.

    Args:
        chain: The arm.
        q: Values of its degrees of freedom from which each search starts [rad] or [m].
        Ts_base_tool: The tool poses in the base frame.
        max_error: Largest error of a tool pose, in position [m] and in rotation [rad].

    Returns:
        The values; None if a tool pose is not reached within the joint limits.
    """
    identity = _DAMPING**2 * np.eye(q.shape[1])
    for _ in range(_STEPS):
        J, e = jacobians(chain, q, 1.0), _errors(chain, q, Ts_base_tool)
        J_t = np.swapaxes(J, 1, 2)
        change = np.linalg.solve(J_t @ J + identity, J_t @ e[..., None])[..., 0]
        q = np.clip(q + change, chain.lower, chain.upper)
        if np.abs(change).max(initial=0.0) < 1e-9:
            break
    return q if np.abs(_errors(chain, q, Ts_base_tool)).max(initial=0.0) < max_error else None


def _errors(
    chain: Chain, q: Float[np.ndarray, "m n"], Ts_base_tool: Float[np.ndarray, "m 4 4"]
) -> Float[np.ndarray, "m 6"]:
    """Return position errors [m] and rotation errors, the sines of the angles [-], base frame."""
    T = chain.tool_poses(q)
    R = (Ts_base_tool @ invert(T))[:, :3, :3]
    skew = (R - np.swapaxes(R, 1, 2)) / 2.0
    around = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=-1)
    return np.concatenate([Ts_base_tool[:, :3, 3] - T[:, :3, 3], around], axis=1)
