"""How far an arm is from states in which it cannot move every way, and how much it moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .chain import Chain

if TYPE_CHECKING:
    from jaxtyping import Float

_STEP = 1e-6
"""Of the differences that make up a Jacobian [rad] or [m]."""


def jacobians(
    chain: Chain, q: Float[np.ndarray, "m n"], length: float
) -> Float[np.ndarray, "m 6 n"]:
    """Jacobians without units: lengths, also those of joints that slide, count in `length` [m].

    Args:
        chain: The arm.
        q: Its degrees of freedom at each state.
        length: How far the arm reaches.

    Returns:
        Velocity of the tool's origin, then its turning, for each degree of freedom; by differences.
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
    """The smallest dexterity over some states, in [0, 1]; 0 where the arm is singular.

    The dexterity is the smallest singular value of the Jacobian over the largest, the inverse of
    its condition number (Salisbury and Craig 1982).

    Args:
        chain: The arm.
        q: Its degrees of freedom at each state.
        length: How far it reaches [m]; makes the Jacobian free of units.
    """
    values = np.linalg.svd(jacobians(chain, q, length), compute_uv=False)
    return float((values[:, -1] / values[:, 0]).min())


def travel_of_arm(chain: Chain, q: Float[np.ndarray, "m n"], length: float) -> float:
    """How far all joints move along some states, in sum [rad].

    A joint that slides by the arm's reach counts as one that turns by a radian.

    Args:
        chain: The arm.
        q: Its degrees of freedom at each state.
        length: How far it reaches [m].
    """
    return float((np.abs(np.diff(q, axis=0)).sum(0) / np.where(chain.prismatic, length, 1.0)).sum())
