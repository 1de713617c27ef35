"""Edit a room's cloud so that its open doors and flaps are closed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import between
from momapos.model.records import Cloud, OpenLeaf

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

RIM = 0.03
"""Points this close to a leaf's edges belong to it [m]."""
MAX_THICKNESS = 0.1
"""Upper bound of leaf thickness and handle protrusion [m]."""
MIN_PROTRUSION = 0.015
"""Points farther in front of the outer face belong to a handle [m]."""
MAX_DEPTH = 0.8
"""Points up to this far behind a closed leaf are removed ... [m]"""
MIN_COSINE = -0.5
"""... unless they face the other way, like the back of an island. Cosine between normals [-]."""


def close_in_cloud(cloud: Cloud, leaves: Sequence[OpenLeaf], spacing: float) -> Cloud:
    """Close every leaf, and remove the points behind it.

    Args:
        cloud: The room as scanned.
        leaves: Its open leaves.
        spacing: Point spacing of a closed leaf [m].
    """
    for leaf in leaves:
        cloud = _closed(cloud, leaf, spacing)
    return cloud


def _closed(cloud: Cloud, leaf: OpenLeaf, spacing: float) -> Cloud:
    on, handle = on_leaf(leaf, cloud.points)
    place = leaf.local(cloud.points)
    width, height = leaf.size
    behind = between(place, (0.0, -MAX_DEPTH, 0.0), (width, 0.0, height))
    behind &= cloud.normals @ leaf.out > MIN_COSINE
    keep = ~on & ~behind
    T = leaf.T_closed_open
    moved = leaf.to_closed(cloud.points[handle])
    face = _grid(leaf, spacing)
    color = np.median(cloud.colors[on], axis=0) if on.any() else np.full(3, 127.0)
    return Cloud(
        np.concatenate([cloud.points[keep], face, leaf.world(moved)]),
        np.concatenate(
            [
                cloud.normals[keep],
                np.tile(leaf.out, (len(face), 1)),
                cloud.normals[handle] @ T[:3, :3].T,
            ]
        ),
        np.concatenate(
            [
                cloud.colors[keep],
                np.tile(color.astype(np.uint8), (len(face), 1)),
                cloud.colors[handle],
            ]
        ),
        _rows_left(cloud, keep),
    )


def _rows_left(cloud: Cloud, keep: Bool[np.ndarray, " n"]) -> Int[np.ndarray, " file"] | None:
    """Return the rows of a cloud of which only some points are kept."""
    if cloud.rows is None:
        return None
    new = np.where(keep, np.cumsum(keep) - 1, -1)
    return np.where(cloud.rows >= 0, new[cloud.rows], -1)


def on_leaf(
    leaf: OpenLeaf, points: Float[np.ndarray, "n 3"]
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Tell which points belong to an open leaf, and which of these to its handle."""
    place = leaf.to_closed(points)
    width, height = leaf.size
    low, high = [-RIM, -MAX_THICKNESS, -RIM], [width + RIM, MAX_THICKNESS, height + RIM]
    on = (place > low).all(1) & (place < high).all(1)
    # Near the hinge, points outside the leaf's plane belong to the furniture behind the front.
    slab = (place[:, 1] > -leaf.thickness - MIN_PROTRUSION) & (place[:, 1] < MIN_PROTRUSION)
    on &= slab | (leaf.local(points)[:, 1] > MIN_PROTRUSION)
    return on, on & (place[:, 1] > MIN_PROTRUSION)


def _grid(leaf: OpenLeaf, spacing: float) -> Float[np.ndarray, "n 3"]:
    x, z = (np.arange(spacing / 2, side, spacing) for side in leaf.size)
    place = np.stack(np.meshgrid(x, [0.0], z, indexing="ij"), -1).reshape(-1, 3)
    return leaf.world(place)
