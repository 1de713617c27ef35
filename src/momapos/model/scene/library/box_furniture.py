"""Furniture made of boxes: what its parts are, how they move, and what they hit.

Frame of a piece: x right, y to its back, z up, as seen from in front of it. All its parts are
axis-aligned boxes in that frame while its joints are closed (0).
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

TOUCH = 5e-4  # [m] of overlap that still counts as touching
BAR, STAND_OFF = 0.02, 0.04  # [m] thickness of a handle, and its distance from the door

Vec = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """An axis-aligned box in the frame of its piece, at the closed state."""

    name: str
    low: Vec
    """Lowest corner [m]."""
    high: Vec
    """Highest corner [m]."""


@dataclass(frozen=True)
class JointMotion:
    """How a part moves against the body; the closed state is 0."""

    kind: Literal["revolute", "prismatic"]
    pivot: Vec
    """A point on the axis, in the frame of the piece [m]."""
    axis: Vec
    """Unit vector along a coordinate axis of the piece."""
    upper: float
    """Where it ends [rad] or [m]."""


@dataclass(frozen=True)
class FurniturePart:
    """What moves as one: the body, a door, a drawer."""

    name: str
    boxes: tuple[Box, ...]
    motion: JointMotion | None = None
    """None: fixed to the body."""
    handle: tuple[Box, ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()
    """Ways in which it may move, the likeliest first, which is its motion; empty where that is
    known."""
    confidence: float | None = None
    """That it is there and moves so, in [0, 1]; None where that is known."""
    handle_confidence: float | None = None
    """That its handle is there, in [0, 1]; None where that is known, or there is none."""
    value: float = 0.0
    """How far it is open in the room [rad] or [m]."""


@dataclass(frozen=True)
class Piece:
    """A piece of furniture; its first part is the body."""

    name: str
    category: str
    xyz: Vec
    """Origin of its frame in the world [m]."""
    yaw: float
    """Turn of its frame about the world's z axis [rad]."""
    parts: tuple[FurniturePart, ...]


def vec(values: Iterable[float]) -> Vec:
    """Make a triple of plain floats, to 10 micrometers and without negative zeros."""
    x, y, z = (round(float(value), 5) + 0.0 for value in values)
    return x, y, z


def union(name: str, boxes: Sequence[Box]) -> Box:
    """Bound boxes by one."""
    low = np.min([box.low for box in boxes], axis=0)
    high = np.max([box.high for box in boxes], axis=0)
    return Box(name, vec(low), vec(high))


def solid(name: str, category: str, size: Vec, center: Vec, yaw: float = 0.0) -> Piece:
    """A piece that is one box, its frame in the center."""
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
    bar: float = BAR,
    stand_off: float = STAND_OFF,
) -> tuple[Box, ...]:
    """A bar on two posts.

    Args:
        part: Name of the part that it is on.
        x: Its center [m].
        z: Its center [m].
        length: Of the bar [m].
        upright: Along z; else along x.
        front: The y coordinate of the surface that it stands on [m].
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


# ---------------------------------------------------------------- where the boxes are


def part_poses(
    piece: Piece, part: FurniturePart, values: Float[np.ndarray, " s"]
) -> Float[np.ndarray, "s 4 4"]:
    """Motion of a part in the world: maps where its points are when closed, in the piece's frame.

    Args:
        piece: The piece of furniture.
        part: One of its parts.
        values: Joint values [rad] or [m]; without effect on a part that does not move.
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
    """Centers and half sizes of boxes [m], in the frame of their piece."""
    low, high = np.array([b.low for b in boxes]), np.array([b.high for b in boxes])
    return (low + high) / 2, (high - low) / 2


@dataclass(frozen=True)
class Obstacles:
    """Boxes in the world."""

    R: Float[np.ndarray, "n 3 3"]
    centers: Float[np.ndarray, "n 3"]
    halves: Float[np.ndarray, "n 3"]

    def bounds(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Lowest and highest corners of the axis-aligned boxes around them [m]."""
        half = np.einsum("nij,nj->ni", np.abs(self.R), self.halves)
        return self.centers - half, self.centers + half


def obstacles(pieces: Iterable[Piece], without: tuple[str, str] | None = None) -> Obstacles:
    """Collect all boxes of closed furniture, but for one part given by piece and name."""
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
    """Whether a part overlaps other boxes at each joint value [rad] or [m].

    Only the boxes' own axes are tried as separating ones. That decides exactly where two boxes
    share an axis, as everything does here but a few small objects; for these it errs to a hit.
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
    return np.any(np.minimum(own.min(-1), other.min(-1)) > TOUCH, axis=(1, 2))


def ending_before_hits(piece: Piece, pieces: Sequence[Piece], least: Mapping[str, float]) -> Piece:
    """End each joint of a piece before its part hits anything that stands closed.

    A part that cannot be opened as far as `least` [rad, m] says for its kind of joint is fixed
    instead, and loses its handle.
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
