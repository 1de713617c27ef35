"""Register one upright scan of a room to another scan of the same room."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import irfft2, rfft2
from scipy.spatial import cKDTree

from momapos.core import InputError
from momapos.core.geometry import apply, pose, rotation_about
from momapos.model.records import UP, Cloud

if TYPE_CHECKING:
    from jaxtyping import Float

TURNS = tuple(np.pi / 2 * k for k in range(4))
"""Upright scans have walls along x and y, so they differ by quarter turns [rad]."""
MIN_HEIGHT = 0.05
"""Lower points are ignored, because all floors are alike [m]."""
CELL = 0.05
"""Edge length of the floor cells in which points are counted [m]."""
MAX_POINTS = 20_000
"""Maximum number of points of each scan [-]."""
ROUNDS = 30
"""Iterations of the fit [-]."""
MATCH_DISTANCES = (0.25, 0.04)
"""Maximum distance between matched points in the first and in the last iteration [m]."""
SAME_DISTANCE = 0.04
"""Points with a point of the other scan this close are in both [m]."""
MIN_COMMON = 0.6
"""Minimum share of one scan that is in the other, if they show one room [-]."""


def register(cloud: Cloud, other: Cloud) -> Float[np.ndarray, "4 4"]:
    """Estimate the pose of another upright scan of the same room.

    Args:
        cloud: One scan, upright.
        other: The other one, also upright; it may be turned about z by quarters, and moved.

    Returns:
        `T_cloud_other`; a rotation about z and a translation.

    Raises:
        InputError: They do not show one room.
    """
    points, normals = _standing(cloud)
    others, _ = _standing(other)
    tree = cKDTree(points)
    guesses = [np.eye(4), *(_shifted(points, others, turn) for turn in TURNS)]
    shares = [_share(tree, apply(T, others), 2 * CELL) for T in guesses]
    T = _fit(tree, normals, others, guesses[int(np.argmax(shares))])
    moved = apply(T, others)
    share = max(_share(tree, moved, SAME_DISTANCE), _share(cKDTree(moved), points, SAME_DISTANCE))
    if share < MIN_COMMON:
        raise InputError(
            f"the two scans do not show the same room: they share {share:.0%} of their points "
            f"above the floor, and need {MIN_COMMON:.0%}"
        )
    return T


def _standing(cloud: Cloud) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    keep = np.flatnonzero(cloud.points[:, 2] > MIN_HEIGHT)
    if not len(keep):
        raise InputError("a scan shows only the floor, so it cannot be registered")
    keep = keep[:: -(-len(keep) // MAX_POINTS)]
    return cloud.points[keep], cloud.normals[keep]


def _shifted(
    points: Float[np.ndarray, "n 3"],
    others: Float[np.ndarray, "m 3"],
    turn: float,
) -> Float[np.ndarray, "4 4"]:
    """Return the translation after a rotation for which two rooms overlap most, from above."""
    R = rotation_about(UP, np.array(turn))
    turned = others @ R.T
    low = np.minimum(points.min(0), turned.min(0))[:2]
    high = np.maximum(points.max(0), turned.max(0))[:2]
    shape = tuple((2 * np.ceil((high - low) / CELL).astype(int) + 2).tolist())

    def raster(xyz: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "w h"]:
        cells = np.floor((xyz[:, :2] - low) / CELL).astype(int)
        count = np.zeros(shape)
        np.add.at(count, (cells[:, 0], cells[:, 1]), 1.0)
        return np.sqrt(count)  # a high wall must not outweigh the rest

    match = irfft2(rfft2(raster(points)) * np.conj(rfft2(raster(turned))), shape)
    best = np.array(np.unravel_index(int(np.argmax(match)), shape))
    best = np.where(best > np.array(shape) // 2, best - shape, best)
    return pose(np.append(best * CELL, 0.0), R)


def _fit(
    tree: cKDTree,
    normals: Float[np.ndarray, "n 3"],
    others: Float[np.ndarray, "m 3"],
    T: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "4 4"]:
    """Fit x, y, z and yaw so that the points of one cloud lie in the planes of the other."""
    points = np.asarray(tree.data)
    for near in np.geomspace(*MATCH_DISTANCES, ROUNDS):
        moved = apply(T, others)
        away, index = tree.query(moved, distance_upper_bound=near)
        found = np.isfinite(away)
        if found.sum() < 4:
            return T
        p, q, n = moved[found], points[index[found]], normals[index[found]]
        J = np.column_stack([n, n[:, 1] * p[:, 0] - n[:, 0] * p[:, 1]])
        step = np.linalg.lstsq(J, np.sum(n * (q - p), axis=1), rcond=None)[0]
        T = pose(step[:3], rotation_about(UP, np.array(step[3]))) @ T
    return T


def _share(tree: cKDTree, points: Float[np.ndarray, "n 3"], near: float) -> float:
    """Return the share of points that have a point of a tree near them."""
    away, _ = tree.query(points, distance_upper_bound=near)
    return float(np.isfinite(away).mean())
