"""A room's cloud as it would be if the leaves that stand open in it were shut."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import between
from momapos.model.records import Cloud, OpenLeaf

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

RIM = 0.03
"""What is this near to a leaf's edges belongs to it [m]."""
HANDLE = 0.1
"""Handles stand out by less, and leaves are less thick [m]."""
STANDS_OUT = 0.015
"""What is farther before the outer face is a handle [m]."""
INSIDE = 0.8
"""What lies nearer behind a shut leaf is seen through the opening alone [m] ..."""
AWAY = -0.5
"""... unless it faces the other way: the back of an island. Cosine between the normals [-]."""


def shut_cloud(cloud: Cloud, leaves: Sequence[OpenLeaf], spacing: float) -> Cloud:
    """Shut every leaf, and leave out what is behind it.

    Args:
        cloud: The room as it was seen.
        leaves: The leaves that stand open in it.
        spacing: Between the points of a shut leaf [m].
    """
    for leaf in leaves:
        cloud = _shut(cloud, leaf, spacing)
    return cloud


def _shut(cloud: Cloud, leaf: OpenLeaf, spacing: float) -> Cloud:
    on, handle = on_leaf(leaf, cloud.points)
    place = leaf.local(cloud.points)
    width, height = leaf.size
    behind = between(place, (0.0, -INSIDE, 0.0), (width, 0.0, height))
    behind &= cloud.normals @ leaf.out > AWAY
    keep = ~on & ~behind
    T = leaf.T_shut_open
    moved = leaf.shut(cloud.points[handle])
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
    )


def on_leaf(
    leaf: OpenLeaf, points: Float[np.ndarray, "n 3"]
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Which points belong to an open leaf, and which of these stand out of its outer face."""
    place = leaf.shut(points)
    width, height = leaf.size
    on = (place > [-RIM, -HANDLE, -RIM]).all(1) & (place < [width + RIM, HANDLE, height + RIM]).all(
        1
    )
    # Near the hinge what is not in its plane is of the furniture, unless it stands before that.
    slab = (place[:, 1] > -leaf.thickness - STANDS_OUT) & (place[:, 1] < STANDS_OUT)
    on &= slab | (leaf.local(points)[:, 1] > STANDS_OUT)
    return on, on & (place[:, 1] > STANDS_OUT)


def _grid(leaf: OpenLeaf, spacing: float) -> Float[np.ndarray, "n 3"]:
    """Points all over the outer face of a shut leaf [m]."""
    x, z = (np.arange(spacing / 2, side, spacing) for side in leaf.size)
    place = np.stack(np.meshgrid(x, [0.0], z, indexing="ij"), -1).reshape(-1, 3)
    return leaf.world(place)
