"""Parts of a piece that stand open in the only scan there is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert, pose, rotation_about
from momapos.model.records import OpenLeaf
from momapos.model.scene.library import FurniturePart, JointMotion, Piece, vec

from .seen_motion import SeenMotion, as_seen

if TYPE_CHECKING:
    from jaxtyping import Float

SAME = 0.5
"""Overlap (IoU) of a leaf and of the part that it is, at least [-]."""
NEAR = 0.15
"""Distance between their fronts, at most [m]."""


def opened_piece(piece: Piece, leaves: Sequence[OpenLeaf]) -> tuple[Piece, dict[str, SeenMotion]]:
    """Give the parts of a piece that stand open the joints that these show.

    Args:
        piece: The furniture, its parts shut.
        leaves: All leaves that stand open in the room, in the world.

    Returns:
        The piece with these joints, its parts as open as they were seen; and what was seen of each
        part that stands open, by its name.
    """
    T = invert(pose(piece.xyz, rotation_about(np.array([0.0, 0.0, 1.0]), np.array(piece.yaw))))
    parts, seen = list(piece.parts), {}
    for leaf in leaves:
        front = _front(leaf, T)
        shares = [_overlap(part, front) for part in parts]
        best = int(np.argmax(shares))
        if shares[best] >= SAME:
            part = parts[best]
            axis = T[:3, :3] @ leaf.axis
            pivot = apply(T, leaf.pivot[None])[0]
            motion = JointMotion("revolute", vec(pivot), vec(axis), leaf.value)
            seen[part.name] = SeenMotion(leaf.kind, motion, leaf.value)
            parts[best] = as_seen(part, seen[part.name])
    return replace(piece, parts=tuple(parts)), seen


def _front(leaf: OpenLeaf, T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "2 3"]:
    """Low and high corner of a leaf's outer face, shut, in the frame of a piece [m]."""
    corners = np.array([[0.0, 0.0, 0.0], [leaf.size[0], 0.0, leaf.size[1]]])
    there = apply(T, leaf.world(corners))
    return np.stack([there.min(0), there.max(0)])


def _overlap(part: FurniturePart, front: Float[np.ndarray, "2 3"]) -> float:
    """IoU of a part's front and a leaf, seen from before them; 0 where these are apart [-]."""
    if part.motion is None:
        return 0.0
    low, high = np.array(part.boxes[0].low), np.array(part.boxes[0].high)
    if np.ptp(front[:, 1]) > NEAR or abs(low[1] - front[:, 1].mean()) > NEAR:
        return 0.0
    common = np.minimum(high, front[1]) - np.maximum(low, front[0])
    shared = float(np.prod(np.maximum(common[[0, 2]], 0.0)))
    both = float(np.prod((high - low)[[0, 2]]) + np.prod((front[1] - front[0])[[0, 2]]))
    return shared / (both - shared)
