"""Find the parts of a piece that stand open in a single scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert, pose, rotation_about
from momapos.model.records import OpenLeaf
from momapos.model.scene.library import FurniturePart, JointMotion, Piece, vec

from .seen_motion import SeenMotion, with_observed_joint

if TYPE_CHECKING:
    from jaxtyping import Float

MIN_IOU = 0.5
"""Overlap of a leaf and the part that it is [-]."""
MAX_FRONT_DISTANCE = 0.15
"""Between the fronts of a leaf and of the part [m]."""


def opened_piece(piece: Piece, leaves: Sequence[OpenLeaf]) -> tuple[Piece, dict[str, SeenMotion]]:
    """Replace the joints of parts that stand open by the observed ones.

    Args:
        piece: The furniture, with its parts closed.
        leaves: All open leaves of the room, in the world.

    Returns:
        The piece with these joints and its parts as open as observed; and the observed motion of
        each open part, by its name.
    """
    T = invert(pose(piece.xyz, rotation_about(np.array([0.0, 0.0, 1.0]), np.array(piece.yaw))))
    parts, seen = list(piece.parts), {}
    for leaf in leaves:
        front = _front(leaf, T)
        shares = [_overlap(part, front) for part in parts]
        best = int(np.argmax(shares))
        if shares[best] >= MIN_IOU:
            part = parts[best]
            axis = T[:3, :3] @ leaf.axis
            pivot = apply(T, leaf.pivot[None])[0]
            motion = JointMotion("revolute", vec(pivot), vec(axis), leaf.value)
            seen[part.name] = SeenMotion(leaf.kind, motion, leaf.value)
            parts[best] = with_observed_joint(part, seen[part.name])
    return replace(piece, parts=tuple(parts)), seen


def _front(leaf: OpenLeaf, T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "2 3"]:
    """Return the corners of a leaf's closed outer face, in the frame of a piece [m]."""
    corners = np.array([[0.0, 0.0, 0.0], [leaf.size[0], 0.0, leaf.size[1]]])
    there = apply(T, leaf.world(corners))
    return np.stack([there.min(0), there.max(0)])


def _overlap(part: FurniturePart, front: Float[np.ndarray, "2 3"]) -> float:
    """Return the IoU of a part's front and a leaf, seen from the front; 0 if far apart [-]."""
    if part.motion is None:
        return 0.0
    low, high = np.array(part.boxes[0].low), np.array(part.boxes[0].high)
    if (
        np.ptp(front[:, 1]) > MAX_FRONT_DISTANCE
        or abs(low[1] - front[:, 1].mean()) > MAX_FRONT_DISTANCE
    ):
        return 0.0
    common = np.minimum(high, front[1]) - np.maximum(low, front[0])
    shared = float(np.prod(np.maximum(common[[0, 2]], 0.0)))
    both = float(np.prod((high - low)[[0, 2]]) + np.prod((front[1] - front[0])[[0, 2]]))
    return shared / (both - shared)
