"""Track tool poses with a nearby arm state, and measure dexterity and joint travel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert

from .chain import Chain

if TYPE_CHECKING:
    from jaxtyping import Float


_STEP = 1e-6
"""Step of the finite differences of Jacobians [rad] or [m]."""


def jacobians(
    chain: Chain, q: Float[np.ndarray, "m n"], length: float
) -> Float[np.ndarray, "m 6 n"]:
    """Compute dimensionless Jacobians by finite differences; lengths are in units of `length`.

    Args:
        chain: The arm.
        q: Values of the degrees of freedom at each state.
        length: Reach of the arm [m].

    Returns:
        Velocity of the tool's origin, then angular velocity, for each degree of freedom.
    """
    scale = np.where(chain.prismatic, length, 1.0)
    moved = q[:, None] + _STEP * np.diag(scale)
    T, Ts = chain.tool_poses(q)[:, None], chain.tool_poses(moved)
    turn = Ts[..., :3, :3] @ np.swapaxes(T[..., :3, :3], -1, -2)
    skew = (turn - np.swapaxes(turn, -1, -2)) / 2.0
    around = np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)
    along = (Ts[..., :3, 3] - T[..., :3, 3]) / length
    return np.swapaxes(np.concatenate([along, around], axis=-1) / _STEP, -1, -2)


def dexterities(
    chain: Chain, q: Float[np.ndarray, "m n"], length: float
) -> Float[np.ndarray, " m"]:
    """Return the dexterity of each state, in [0, 1]; 0 if it is singular.

    This is the smallest singular value of the Jacobian over the largest, the inverse of its
    condition number (Salisbury and Craig 1982). Arguments as for `jacobians`.
    """
    values = np.linalg.svd(jacobians(chain, q, length), compute_uv=False)
    return np.asarray(values[:, -1] / values[:, 0])


def least_dexterity(chain: Chain, q: Float[np.ndarray, "m n"], length: float) -> float:
    """Return the smallest dexterity over some states, see `dexterities`."""
    return float(dexterities(chain, q, length).min())


def travel_of_arm(chain: Chain, q: Float[np.ndarray, "m n"], length: float) -> float:
    """Return the total travel of all joints over some states [rad].

    A prismatic joint that moves by `length` counts as 1 rad. Arguments as for `jacobians`.
    """
    return float((np.abs(np.diff(q, axis=0)).sum(0) / np.where(chain.prismatic, length, 1.0)).sum())


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
