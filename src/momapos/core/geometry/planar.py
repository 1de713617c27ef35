"""Planar poses (x [m], y [m], yaw [rad]) and points on the floor: SE(2).

`T_a_b` of three dimensions is `transforms.pose_planar`; here points and poses stay rows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .transforms import wrap_angle

if TYPE_CHECKING:
    from jaxtyping import Float


def rotation(yaw: float | Float[np.ndarray, " *batch"]) -> Float[np.ndarray, "*batch 2 2"]:
    """Return rotation matrices for counterclockwise angles [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def place_points(
    poses: Float[np.ndarray, "n 3"], points: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, "n k 2"]:
    """Map points from a planar frame to the world, for each pose of the frame."""
    return np.einsum("nij,kj->nki", rotation(poses[:, 2]), points) + poses[:, None, :2]


def local_points(
    pose: Float[np.ndarray, "3"], points: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, "k 2"]:
    """Map points from the world to a planar frame, the inverse of `place_points`."""
    return (points - pose[:2]) @ rotation(pose[2])


def compose(
    frame: Float[np.ndarray, "*#frames 3"], poses: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Map poses from one planar frame, or from one frame each, to the world."""
    at_x, at_y, turn = frame.T
    c, s = np.cos(turn), np.sin(turn)
    x, y, yaw = poses.T
    return np.stack([at_x + c * x - s * y, at_y + s * x + c * y, wrap_angle(turn + yaw)], -1)
