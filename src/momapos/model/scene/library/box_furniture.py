"""Furniture made of boxes: parts, motions and collisions.

Frame of a piece: x right, y to its back, z up, seen from the front. With closed joints (0), all
parts are axis-aligned boxes in that frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core.geometry import apply, pose, rotation_about
from momapos.model.records import Hypothesis

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MAX_TOUCH_OVERLAP = 5e-4  # maximum overlap that counts as touching [m]
HANDLE_THICKNESS, HANDLE_STAND_OFF = (
    0.02,
    0.04,
)  # thickness of a handle, and its distance from the door [m]

Vec = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """An axis-aligned box in the frame of its closed piece."""

    name: str
    low: Vec
    """Lower corner [m]."""
    high: Vec
    """Upper corner [m]."""


@dataclass(frozen=True)
class JointMotion:
    """Motion of a part relative to the body; 0 is closed."""

    kind: Literal["revolute", "prismatic"]
    pivot: Vec
    """Point on the axis, in the frame of the piece [m]."""
    axis: Vec
    """Unit vector along a coordinate axis of the piece."""
    upper: float
    """Upper joint limit [rad] or [m]."""


@dataclass(frozen=True)
class FurniturePart:
    """A rigid part: the body, a door, a drawer."""

    name: str
    boxes: tuple[Box, ...]
    motion: JointMotion | None = None
    """None for a part fixed to the body."""
    handle: tuple[Box, ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()
    """Possible motions, the most probable first, which is `motion`; empty if the motion is
    known."""
    confidence: float | None = None
    """Confidence in the part and its motion, in [0, 1]; None if known."""
    handle_confidence: float | None = None
    """Confidence in the handle, in [0, 1]; None if known, or without a handle."""
    value: float = 0.0
    """Opening in the room [rad] or [m]."""


@dataclass(frozen=True)
class Piece:
    """A piece of furniture; its first part is the body."""

    name: str
    category: str
    xyz: Vec
    """Origin of its frame in the world [m]."""
    yaw: float
    """Rotation of its frame about the world's z axis [rad]."""
    parts: tuple[FurniturePart, ...]


def vec(values: Iterable[float]) -> Vec:
    """Return a triple of plain floats, rounded to 10 micrometers, without negative zeros."""
    x, y, z = (round(float(value), 5) + 0.0 for value in values)
    return x, y, z


def union(name: str, boxes: Sequence[Box]) -> Box:
    """Return the bounding box of boxes."""
    low = np.min([box.low for box in boxes], axis=0)
    high = np.max([box.high for box in boxes], axis=0)
    return Box(name, vec(low), vec(high))


def solid(name: str, category: str, size: Vec, center: Vec, yaw: float = 0.0) -> Piece:
    """Return a piece of one box, with its frame at the center."""
    half = tuple(value / 2 for value in size)
    box = Box(name, vec(-value for value in half), vec(half))
    return Piece(name, category, center, yaw, (FurniturePart("body", (box,)),))


def bar_handle(
    part: str,
    x: float,
    z: float,
    length: float,
    *,
    upright: bool,
    front: float,
    bar: float = HANDLE_THICKNESS,
    stand_off: float = HANDLE_STAND_OFF,
) -> tuple[Box, ...]:
    """Return a bar on two posts.

    Args:
        part: Name of its part.
        x: Center [m].
        z: Center [m].
        length: Length of the bar [m].
        upright: Along z; otherwise along x.
        front: y coordinate of the mounting surface [m].
        bar: Thickness of the bar [m].
        stand_off: Distance of the bar from the surface [m].
    """
    along = np.array([0.0, 0.0, 1.0] if upright else [1.0, 0.0, 0.0])
    across = np.array([1.0, 0.0, 0.0] if upright else [0.0, 0.0, 1.0])
    center = np.array([x, front - stand_off - bar / 2, z])
    half = along * length / 2 + across * bar / 2 + np.array([0.0, bar / 2, 0.0])
    post = min(0.0075, bar / 2)
    boxes = [Box(f"{part}_handle_bar", vec(center - half), vec(center + half))]
    for end, sign in (("a", -1.0), ("b", 1.0)):
        foot = np.array([x, front - stand_off / 2, z]) + sign * along * (length / 2 - bar)
        half = np.array([post, stand_off / 2, post])
        boxes.append(Box(f"{part}_handle_post_{end}", vec(foot - half), vec(foot + half)))
    return tuple(boxes)


def part_poses(
    piece: Piece, part: FurniturePart, values: Float[np.ndarray, " s"]
) -> Float[np.ndarray, "s 4 4"]:
    """Return the transforms from a part's closed points in the piece's frame to the world.

    Args:
        piece: The piece of furniture.
        part: One of its parts.
        values: Joint values [rad] or [m]; without effect on a fixed part.
    """
    T_world_piece = pose(piece.xyz, rotation_about(np.array([0.0, 0.0, 1.0]), piece.yaw))
    Ts_piece_part = np.tile(np.eye(4), (len(values), 1, 1))
    if part.motion is not None and part.motion.kind == "prismatic":
        Ts_piece_part[:, :3, 3] = values[:, None] * np.asarray(part.motion.axis)
    elif part.motion is not None:
        R, pivot = (
            rotation_about(np.asarray(part.motion.axis), values),
            np.asarray(part.motion.pivot),
        )
        Ts_piece_part[:, :3, :3] = R
        Ts_piece_part[:, :3, 3] = pivot - R @ pivot
    return T_world_piece @ Ts_piece_part


def centers_and_halves(
    boxes: Sequence[Box],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return the centers and half sizes of boxes [m], in the frame of their piece."""
    low, high = np.array([b.low for b in boxes]), np.array([b.high for b in boxes])
    return (low + high) / 2, (high - low) / 2


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Boxes in the world."""

    R: Float[np.ndarray, "n 3 3"]
    centers: Float[np.ndarray, "n 3"]
    halves: Float[np.ndarray, "n 3"]

    def bounds(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Return the lower and upper corners of their world-aligned bounding boxes [m]."""
        half = np.einsum("nij,nj->ni", np.abs(self.R), self.halves)
        return self.centers - half, self.centers + half


def obstacles(pieces: Iterable[Piece], without: tuple[str, str] | None = None) -> Obstacles:
    """Collect the boxes of closed furniture, except one part given by piece and name."""
    Rs, centers, halves = [], [], []
    for piece in pieces:
        for part in piece.parts:
            boxes = (*part.boxes, *part.handle)
            if boxes and (piece.name, part.name) != without:
                T = part_poses(piece, part, np.zeros(1))[0]
                center, half = centers_and_halves(boxes)
                Rs.append(np.tile(T[:3, :3], (len(boxes), 1, 1)))
                centers.append(apply(T, center))
                halves.append(half)
    return Obstacles(np.concatenate(Rs), np.concatenate(centers), np.concatenate(halves))


def hits(
    piece: Piece, part: FurniturePart, values: Float[np.ndarray, " s"], others: Obstacles
) -> Bool[np.ndarray, " s"]:
    """Return whether a part overlaps other boxes at each joint value [rad] or [m].

    Only the boxes' own axes are tested as separating axes. This is exact for boxes that share an
    axis, as all do here except a few small objects; for these it may report false hits.
    """
    Ts = part_poses(piece, part, values)
    center, h = centers_and_halves((*part.boxes, *part.handle))
    R, c = Ts[:, :3, :3], apply(Ts, center)
    reach = np.einsum("sij,mj->smi", np.abs(R), h)
    low, high = others.bounds()
    near = np.all((low < (c + reach).max((0, 1))) & (high > (c - reach).min((0, 1))), axis=1)
    R2, c2, h2 = others.R[near], others.centers[near], others.halves[near]
    t = c2 - c[:, :, None]
    A = np.abs(np.einsum("sji,njk->snik", R, R2))
    own = h[:, None] + np.einsum("snij,nj->sni", A, h2)[:, None]
    own = own - np.abs(np.einsum("sji,smnj->smni", R, t))
    other = h2 + np.einsum("snji,mj->smni", A, h) - np.abs(np.einsum("nji,smnj->smni", R2, t))
    return np.any(np.minimum(own.min(-1), other.min(-1)) > MAX_TOUCH_OVERLAP, axis=(1, 2))


def limit_joints_before_hits(
    piece: Piece, pieces: Sequence[Piece], least: Mapping[str, float]
) -> Piece:
    """Limit each joint of a piece so that its part hits no closed furniture.

    A part that opens less than `least` [rad] or [m] for its kind of joint is fixed instead, and
    loses its handle.
    """
    parts = []
    for part in piece.parts:
        motion, handle = part.motion, part.handle
        if motion is not None:
            values = np.linspace(0.0, motion.upper, 121)
            hit = hits(piece, part, values, obstacles(pieces, without=(piece.name, part.name)))
            if hit.any():
                motion = replace(motion, upper=float(values[max(int(np.argmax(hit)) - 3, 0)]))
            if motion.upper < least[motion.kind]:
                motion, handle = None, ()
        parts.append(replace(part, motion=motion, handle=handle))
    return replace(piece, parts=tuple(parts))
