"""How a part moved between two scans of a room: from where its front was to where it is.

Everything is in the frame of the piece of furniture: x right, y to the back, z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.spatial import cKDTree

from momapos.core.geometry import apply, invert, pose, rotation_about
from momapos.model.records import Cloud, Hypothesis, PartKind
from momapos.model.scene.library import FurniturePart, JointMotion, Piece, Vec, vec

if TYPE_CHECKING:
    from jaxtyping import Float

UP = np.array([0.0, 0.0, 1.0])
FRONT = np.array([0.0, -1.0, 0.0])
AXES: dict[PartKind, Vec] = {
    "door_left": (0.0, 0.0, -1.0),
    "door_right": (0.0, 0.0, 1.0),
    "door_down": (1.0, 0.0, 0.0),
    "door_up": (-1.0, 0.0, 0.0),
    "drawer": (0.0, -1.0, 0.0),
}
"""About or along what a kind of part opens with a positive value."""
FREE = {"door_left": 1.0, "door_right": -1.0, "door_down": 1.0, "door_up": -1.0}
"""Toward which side, right or up, the edge lies that is opposite to the hinge."""


@dataclass(frozen=True)
class SeenMotionConfig:
    """How parts that moved are found."""

    near: float = 0.03
    """A surface is where another was when it is this near [m]."""
    gone: float = 0.3
    """A part may have moved when so much of its front is not where it was [-]; a drawer shows its
    tray there."""
    fewest: int = 40
    """Points of a front that are needed to tell [-]."""
    support: float = 0.5
    """And when so much of it is found elsewhere [-]."""
    turns: tuple[float, float, float] = (np.radians(10.0), np.radians(130.0), np.radians(5.0))
    """Turns that are tried: from, to, in steps of [rad]."""
    slides: tuple[float, float, float] = (0.04, 0.7, 0.02)
    """Ways of drawers likewise [m]."""
    facing: float = 0.9
    """Cosine between the normals of one surface before and after [-]."""
    straight: float = 0.95
    """The same for the fit, which shall hold nothing that did not move [-]."""
    margin: float = 0.06
    """How far what belongs to the front lies beyond where it is expected [m]."""
    layer: float = 0.04
    """How far before or behind [m]."""
    edge_error: float = 0.008
    """How far off an edge is found [m]."""
    axis_error: float = 0.015
    """And an axis believed [m]."""
    rounds: int = 6
    """Steps of the fit [-]."""


@dataclass(frozen=True, eq=False)
class Side:
    """The front or the inside of a shut part."""

    points: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "3"]
    free_end: float
    """Where the edge opposite to the hinge is, along the front [m]."""


@dataclass(frozen=True)
class SeenMotion:
    """A part that stands elsewhere in the second scan, or stands open in the only one."""

    kind: PartKind
    motion: JointMotion
    value: float
    """How far it is open there [rad] or [m]."""


def moved_piece(
    piece: Piece, before: Cloud, after: Cloud, config: SeenMotionConfig | None = None
) -> tuple[Piece, dict[str, SeenMotion]]:
    """Give the parts of a piece that moved between two scans the joints that these show.

    Args:
        piece: The furniture as modeled from the first scan, its parts shut.
        before: The first scan.
        after: The second one, in the same frame.
        config: Constants.

    Returns:
        The piece with these joints, its parts where the second scan shows them; and what was seen
        of each part that moved, by its name.
    """
    config = config or SeenMotionConfig()
    T = invert(pose(piece.xyz, rotation_about(UP, np.array(piece.yaw))))
    reach = float(
        np.linalg.norm([box.high for part in piece.parts for box in part.boxes], axis=1).max()
    )
    there = [_local(cloud, T, 2.0 * reach + config.slides[1]) for cloud in (before, after)]
    new = _elsewhere(there[1], there[0], config.near)
    parts, seen = [], {}
    for part in piece.parts:
        found = None
        if part.motion is not None:
            found = _moved(part, there[0], there[1], new, config)
        if found is not None:
            seen[part.name] = found
        parts.append(part if found is None else as_seen(part, found))
    return replace(piece, parts=tuple(parts)), seen


def as_seen(part: FurniturePart, seen: SeenMotion) -> FurniturePart:
    """The part with a joint that is known, as open as it was seen; a leaf alone where what was
    modeled slides and it turns, or the other way round."""
    assert part.motion is not None
    same = part.motion.kind == seen.motion.kind
    motion = replace(seen.motion, upper=max(part.motion.upper if same else 0.0, seen.value))
    way = Hypothesis(seen.kind, 1.0, motion.pivot, motion.axis, motion.upper)
    boxes = part.boxes if same else part.boxes[:1]
    return replace(part, boxes=boxes, motion=motion, hypotheses=(way,), value=seen.value)


def _moved(
    part: FurniturePart, before: Cloud, after: Cloud, new: Cloud, config: SeenMotionConfig
) -> SeenMotion | None:
    """How a part moved; None where it is where it was, or is not found elsewhere."""
    assert part.motion is not None
    leaf = part.boxes[0]
    low, high = np.array(leaf.low), np.array(leaf.high)
    points = before.points
    on = ((points[:, [0, 2]] > low[[0, 2]]) & (points[:, [0, 2]] < high[[0, 2]])).all(1)
    on &= (np.abs(points[:, 1] - low[1]) < config.near) & (before.normals @ FRONT > config.facing)
    if on.sum() < config.fewest or len(new.points) < config.fewest:
        return None
    front = points[on]
    away, _ = cKDTree(after.points).query(front, distance_upper_bound=config.near)
    if np.isinf(away).mean() < config.gone:
        return None
    tree = cKDTree(new.points)
    inside = front + np.array([0.0, high[1] - low[1], 0.0])
    best, seen = config.support, None
    for kind, axis in AXES.items():
        edge = _edge(kind, low, high)
        end = _free_end(kind, low, high)
        for side in (Side(front, FRONT, end), Side(inside, -FRONT, end)):
            value = _roughly(kind, edge, side, tree, new, config)
            fitted = _fitted(kind, side, after, _transform(kind, edge, axis, value), config)
            if fitted is None:
                continue
            share = _support(tree, new, side, _transform(kind, fitted[0], axis, fitted[1]), config)
            if share < best:
                continue
            pivot = np.array(part.motion.pivot if part.motion.axis == axis else edge)
            if side.normal @ FRONT > 0.0:  # an inside is as far from the front as a leaf is thick
                pivot += _trust(kind, fitted[1], config) * (fitted[0] - pivot)
            name: Literal["prismatic", "revolute"] = "prismatic" if kind == "drawer" else "revolute"
            best = share
            seen = SeenMotion(kind, JointMotion(name, vec(pivot), axis, fitted[1]), fitted[1])
    return seen


def _roughly(
    kind: PartKind,
    edge: Float[np.ndarray, "3"],
    side: Side,
    tree: cKDTree,
    new: Cloud,
    config: SeenMotionConfig,
) -> float:
    """How far a part would be open if it were of a kind: where most of it is found."""
    values = np.arange(*(config.slides if kind == "drawer" else config.turns))
    shares = [
        _support(tree, new, side, _transform(kind, edge, AXES[kind], v), config) for v in values
    ]
    return float(values[int(np.argmax(shares))])


def _trust(kind: PartKind, value: float, config: SeenMotionConfig) -> float:
    """Weight of the axis as seen against the one as believed: a small turn shows little [-]."""
    if kind == "drawer":
        return 1.0
    seen = config.edge_error / (2.0 * np.sin(value / 2.0))
    return float(config.axis_error**2 / (config.axis_error**2 + seen**2))


def _edge(
    kind: PartKind, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """A point on the edge of a front about which a kind of part turns, about where."""
    return {
        "door_left": np.array([low[0], low[1], 0.0]),
        "door_right": np.array([high[0], low[1], 0.0]),
        "door_down": np.array([0.0, low[1], low[2]]),
        "door_up": np.array([0.0, low[1], high[2]]),
        "drawer": np.zeros(3),
    }[kind]


def _free_end(kind: PartKind, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> float:
    """Where the edge of a front is that is opposite to the hinge, along the front [m]."""
    axis = 2 if kind in ("door_down", "door_up") else 0
    return float((high if FREE.get(kind, 1.0) > 0.0 else low)[axis])


def _transform(
    kind: PartKind, pivot: Float[np.ndarray, "3"], axis: Sequence[float], value: float
) -> Float[np.ndarray, "4 4"]:
    """How a part moves when it opens by a value [rad] or [m]."""
    if kind == "drawer":
        return pose(value * np.array(axis))
    R = rotation_about(np.array(axis), np.array(value))
    return pose(pivot - R @ pivot, R)


def _support(
    tree: cKDTree,
    new: Cloud,
    side: Side,
    T: Float[np.ndarray, "4 4"],
    config: SeenMotionConfig,
) -> float:
    """Share of a side, moved, that lies on a new surface that faces the same way."""
    away, index = tree.query(apply(T, side.points), distance_upper_bound=config.near)
    found = np.isfinite(away)
    facing = new.normals[index[found]] @ (T[:3, :3] @ side.normal) > config.facing
    return float(facing.sum() / len(side.points))


def _fitted(
    kind: PartKind,
    side: Side,
    after: Cloud,
    T: Float[np.ndarray, "4 4"],
    config: SeenMotionConfig,
) -> tuple[Float[np.ndarray, "3"], float] | None:
    """A point on the axis and the value that bring a side of a part to where it is seen.

    The side's plane after the motion gives the turn and one shift, its free edge the other shift;
    the axis of a turn is what stays where it is.
    """
    axis, front = np.array(AXES[kind]), side.points
    slides = kind == "drawer"
    u, v = _across(kind)  # along the front, and out of it, in the plane that the part moves in
    middle = np.median(front, axis=0)
    value = float(-T[1, 3]) if slides else 0.0
    for _ in range(config.rounds):
        R = T[:3, :3]
        back = apply(invert(T), after.points)
        beside = np.abs(back - middle) - np.ptp(front, axis=0) / 2
        near = (beside < [config.margin, config.layer, config.margin]).all(1)
        near &= after.normals @ (R @ side.normal) > config.straight
        if near.sum() < config.fewest:
            return None
        seen = after.points[near]
        if slides:
            value = float(np.median(front[:, 1]) - np.median(seen[:, 1]))
            T = pose(value * axis)
            continue
        flat = np.stack([seen @ u, seen @ v], axis=1)
        n = _normal(flat, np.array([R @ side.normal @ u, R @ side.normal @ v]))
        turn = _signed_turn(np.array([side.normal @ u, side.normal @ v]), n)
        R2 = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        first = np.stack([front @ u, front @ v], axis=1) @ R2.T
        along = R2 @ np.array([FREE[kind], 0.0])
        half, most = np.percentile(flat @ along, (50.0, 95.0))
        # Points lie evenly on a leaf, but for its very edge, which depth images blur.
        ends = FREE[kind] * side.free_end, most + (most - half) * (5.0 / 45.0)
        depth = [np.median(points @ n) for points in (first, flat)]
        shift = (ends[1] - ends[0]) * along + (depth[1] - depth[0]) * n
        center = np.linalg.solve(np.eye(2) - R2, shift)
        value = turn * float(np.sign(np.cross(u, v) @ axis))
        if not config.turns[0] / 2 < value < np.pi:
            return None
        pivot = center[0] * u + center[1] * v
        T = _transform(kind, pivot, axis.tolist(), value)
    if slides:
        return (np.zeros(3), value) if value > 0.0 else None
    return pivot, value


def _across(kind: PartKind) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Two directions across an axis: along the front, and to the back."""
    along = [0.0, 0.0, 1.0] if kind in ("door_down", "door_up") else [1.0, 0.0, 0.0]
    return np.array(along), np.array([0.0, 1.0, 0.0])


def _normal(
    flat: Float[np.ndarray, "n 2"], about: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "2"]:
    """The normal of a line through points, robust against what stands out of it."""
    kept = flat
    for _ in range(4):
        middle = kept.mean(0)
        _, _, axes = np.linalg.svd(kept - middle, full_matrices=False)
        n = axes[1] * np.sign(axes[1] @ about or 1.0)
        off = np.abs((flat - middle) @ n)
        kept = flat[off <= max(2.5 * np.median(off), 2e-3)]
    return n


def _signed_turn(one: Float[np.ndarray, "2"], other: Float[np.ndarray, "2"]) -> float:
    """Angle from one direction to another [rad]."""
    return float(np.arctan2(one[0] * other[1] - one[1] * other[0], one @ other))


def _local(cloud: Cloud, T: Float[np.ndarray, "4 4"], reach: float) -> Cloud:
    """What of a cloud is near a piece, in its frame."""
    points = apply(T, cloud.points)
    near = np.linalg.norm(points, axis=1) < reach
    return Cloud(points[near], cloud.normals[near] @ T[:3, :3].T, cloud.colors[near])


def _elsewhere(cloud: Cloud, other: Cloud, near: float) -> Cloud:
    """What of a cloud is in no place where another one has something."""
    if not len(cloud.points) or not len(other.points):
        return cloud
    away, _ = cKDTree(other.points).query(cloud.points, distance_upper_bound=near)
    new = np.isinf(away)
    return Cloud(cloud.points[new], cloud.normals[new], cloud.colors[new])
