"""Take grasps from a user's own source: poses at which the hand closes like at any other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError, owner_cache
from momapos.model.robots import Robot

from .config import MAX_GRASPS
from .part_grasps import poses_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

TOLERANCE = 1e-3
"""Largest deviation of a rotation from an orthonormal one [-]; sources compute in single
precision."""


@owner_cache()
def own_poses(robot: Robot, name: str, joint: str | None) -> Float[np.ndarray, "g 4 4"]:
    """Return the poses of a robot's own source of grasps, once; none without a source.

    Args:
        robot: The robot.
        name: The object.
        joint: Its joint that the task moves; None for a rigid object.

    Raises:
        InputError: The source returns anything but poses of the tool.
    """
    if robot.own_grasps is None:
        return np.zeros((0, 4, 4))
    what = f"the grasps of your own for {name if joint is None else f'{name}/{joint}'}"
    found = np.asarray(robot.own_grasps(name, joint))
    if found.dtype.kind not in "fiu" or found.shape[1:] != (4, 4) or found.ndim != 3:
        raise InputError(
            f"{what} must be poses of shape (g, 4, 4), not an array of {found.dtype} of shape "
            f"{found.shape}"
        )
    if len(found) > MAX_GRASPS:
        raise InputError(f"{what} must be at most {MAX_GRASPS:,}, not {len(found):,}")
    poses = found.astype(float)
    if not np.isfinite(poses).all():
        raise InputError(f"{what} must be finite; pose {_first(~np.isfinite(poses))} is not")
    R = poses[:, :3, :3]
    off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max((1, 2)) > TOLERANCE
    off |= np.linalg.det(R) < 0.0
    off |= np.abs(poses[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(1) > TOLERANCE
    if off.any():
        raise InputError(
            f"{what} must be rigid transforms; pose {_first(off)} is no pose of a hand"
        )
    U, _, Vt = np.linalg.svd(R)
    return poses_of(U @ Vt, poses[:, :3, 3])


SAME_LINE = 1e-3
"""Difference below which lines of the hand and openings are the same [m] or [-]."""


def shifted_along(
    Ts: Float[np.ndarray, "g 4 4"], others: Float[np.ndarray, "h 4 4"], axis: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, " g"]:
    """Return which tool poses differ from one of others at most by a shift along a tool axis."""
    return nearest_shifted(Ts, others, axis) >= 0


def nearest_shifted(
    Ts: Float[np.ndarray, "g 4 4"], others: Float[np.ndarray, "h 4 4"], axis: Float[np.ndarray, "3"]
) -> Int[np.ndarray, " g"]:
    """Return from which of others each tool pose differs at most by such a shift; -1 for none."""
    from scipy.spatial import cKDTree

    lines = []
    for R, p in ((T[:, :3, :3], T[:, :3, 3]) for T in (Ts, others)):
        along = R @ axis
        foot = p - np.einsum("gi,gi->g", p, along)[:, None] * along
        lines.append(np.concatenate([R.reshape(-1, 9), foot], axis=1))
    away, nearest = cKDTree(lines[1]).query(lines[0], p=np.inf, distance_upper_bound=SAME_LINE)
    return np.where(np.isfinite(away), nearest, -1)


def _first(bad: np.ndarray) -> int:
    return int(np.flatnonzero(bad.reshape(len(bad), -1).any(1))[0])
