"""Dexterity of arm states (distance from singularities), and joint travel of arm paths."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

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


def least_dexterity(chain: Chain, q: Float[np.ndarray, "m n"], length: float) -> float:
    """Return the smallest dexterity over some states, in [0, 1]; 0 if a state is singular.

    The dexterity is the smallest singular value of the Jacobian over the largest, the inverse of
    its condition number (Salisbury and Craig 1982). Arguments as for `jacobians`.
    """
    values = np.linalg.svd(jacobians(chain, q, length), compute_uv=False)
    return float((values[:, -1] / values[:, 0]).min())


def travel_of_arm(chain: Chain, q: Float[np.ndarray, "m n"], length: float) -> float:
    """Return the total travel of all joints over some states [rad].

    A prismatic joint that moves by `length` counts as 1 rad. Arguments as for `jacobians`.
    """
    return float((np.abs(np.diff(q, axis=0)).sum(0) / np.where(chain.prismatic, length, 1.0)).sum())
