"""Estimate how parts moved between two scans of a room.

Everything is in the frame of the piece of furniture: x right, y to the back, z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.spatial import cKDTree

from momapos.core.geometry import apply, invert, pose, rotation_about
from momapos.model.records import UP, Cloud, Hypothesis, PartKind
from momapos.model.scene.library import FurniturePart, JointMotion, Piece, Vec, vec

if TYPE_CHECKING:
    from jaxtyping import Float

FRONT = np.array([0.0, -1.0, 0.0])
AXES: dict[PartKind, Vec] = {
    "door_left": (0.0, 0.0, -1.0),
    "door_right": (0.0, 0.0, 1.0),
    "door_down": (1.0, 0.0, 0.0),
    "door_up": (-1.0, 0.0, 0.0),
    "drawer": (0.0, -1.0, 0.0),
}
"""Axis of a kind of part, about or along which it opens with a positive value."""
FREE = {"door_left": 1.0, "door_right": -1.0, "door_down": 1.0, "door_up": -1.0}
"""Side of the edge opposite to the hinge: +1 right or up, -1 left or down."""
EDGE_ERROR = 0.008
"""Standard error of an observed edge [m]."""
SAME_SURFACE = 0.03
"""Surfaces this close to each other are the same [m]."""
MIN_GONE = 0.3
"""Share of a part's front that must be absent after it moved [-]; a drawer shows its tray there."""
MIN_POINTS = 40
"""Minimum number of points of a front [-]."""
MIN_SUPPORT = 0.5
"""Share of the front that must be found elsewhere [-]."""
TURNS: tuple[float, float, float] = (np.radians(10.0), np.radians(130.0), np.radians(5.0))
"""Candidate angles of doors: from, to, step [rad]."""
SLIDES = (0.04, 0.7, 0.02)
"""Candidate displacements of drawers: from, to, step [m]."""
MIN_FACING = 0.9
"""Cosine between the normals of one surface before and after [-]."""
MIN_FIT_FACING = 0.95
"""The same for the fit, which must not include static surfaces [-]."""
EDGE_MARGIN = 0.06
"""Points this far beyond the expected edges of the front may belong to it [m]."""
LAYER = 0.04
"""Points this far in front of or behind it may belong to it [m]."""
AXIS_ERROR = 0.015
"""Standard error of an assumed axis [m]."""
ROUNDS = 6
"""Iterations of the fit [-]."""


@dataclass(frozen=True, eq=False)
class Side:
    """The front or the inside of a closed part."""

    points: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "3"]
    free_end: float
    """Coordinate of the edge opposite to the hinge, along the front [m]."""


@dataclass(frozen=True)
class SeenMotion:
    """The motion of a part that the second scan shows moved, or the only scan shows open."""

    kind: PartKind
    motion: JointMotion
    value: float
    """How far it is open [rad] or [m]."""


def moved_piece(piece: Piece, before: Cloud, after: Cloud) -> tuple[Piece, dict[str, SeenMotion]]:
    """Replace the joints of parts that moved between two scans by the observed ones.

    Args:
        piece: The furniture as modeled from the first scan, with its parts closed.
        before: The first scan.
        after: The second scan, in the same frame.

    Returns:
        The piece with these joints and its parts as in the second scan; and the observed motion of
        each part that moved, by its name.
    """
    T = invert(pose(piece.xyz, rotation_about(UP, np.array(piece.yaw))))
    reach = float(
        np.linalg.norm([box.high for part in piece.parts for box in part.boxes], axis=1).max()
    )
    there = [_local(cloud, T, 2.0 * reach + SLIDES[1]) for cloud in (before, after)]
    new = _only_in(there[1], there[0], SAME_SURFACE)
    parts, seen = [], {}
    for part in piece.parts:
        found = None
        if part.motion is not None:
            found = _moved(part, there[0], there[1], new)
        if found is not None:
            seen[part.name] = found
        parts.append(part if found is None else with_observed_joint(part, found))
    return replace(piece, parts=tuple(parts)), seen


def with_observed_joint(part: FurniturePart, seen: SeenMotion) -> FurniturePart:
    """Return a part with its observed joint, as open as observed. If the modeled joint is of
    another type, only the leaf remains."""
    assert part.motion is not None
    same = part.motion.kind == seen.motion.kind
    motion = replace(seen.motion, upper=max(part.motion.upper if same else 0.0, seen.value))
    only = Hypothesis(seen.kind, 1.0, motion.pivot, motion.axis, motion.upper)
    boxes = part.boxes if same else part.boxes[:1]
    return replace(part, boxes=boxes, motion=motion, hypotheses=(only,), value=seen.value)


def _moved(part: FurniturePart, before: Cloud, after: Cloud, new: Cloud) -> SeenMotion | None:
    assert part.motion is not None
    leaf = part.boxes[0]
    low, high = np.array(leaf.low), np.array(leaf.high)
    points = before.points
    on = ((points[:, [0, 2]] > low[[0, 2]]) & (points[:, [0, 2]] < high[[0, 2]])).all(1)
    on &= (np.abs(points[:, 1] - low[1]) < SAME_SURFACE) & (before.normals @ FRONT > MIN_FACING)
    if on.sum() < MIN_POINTS or len(new.points) < MIN_POINTS:
        return None
    front = points[on]
    away, _ = cKDTree(after.points).query(front, distance_upper_bound=SAME_SURFACE)
    if np.isinf(away).mean() < MIN_GONE:
        return None
    tree = cKDTree(new.points)
    inside = front + np.array([0.0, high[1] - low[1], 0.0])
    best, seen = MIN_SUPPORT, None
    for kind, axis in AXES.items():
        edge = _edge(kind, low, high)
        end = _free_end(kind, low, high)
        for side in (Side(front, FRONT, end), Side(inside, -FRONT, end)):
            value = _best_candidate(kind, edge, side, tree, new)
            fitted = _fitted(kind, side, after, _transform(kind, edge, axis, value))
            if fitted is None:
                continue
            share = _support(tree, new, side, _transform(kind, fitted[0], axis, fitted[1]))
            if share < best:
                continue
            pivot = np.array(part.motion.pivot if part.motion.axis == axis else edge)
            if side.normal @ FRONT > 0.0:  # the inside's offset depends on the leaf's thickness
                pivot += _trust(kind, fitted[1]) * (fitted[0] - pivot)
            name: Literal["prismatic", "revolute"] = "prismatic" if kind == "drawer" else "revolute"
            best = share
            seen = SeenMotion(kind, JointMotion(name, vec(pivot), axis, fitted[1]), fitted[1])
    return seen


def _best_candidate(
    kind: PartKind,
    edge: Float[np.ndarray, "3"],
    side: Side,
    tree: cKDTree,
    new: Cloud,
) -> float:
    """Return the candidate value of a kind at which most of the part is found."""
    values = np.arange(*(SLIDES if kind == "drawer" else TURNS))
    shares = [_support(tree, new, side, _transform(kind, edge, AXES[kind], v)) for v in values]
    return float(values[int(np.argmax(shares))])


def _trust(kind: PartKind, value: float) -> float:
    """Return the weight of the observed against the assumed axis: small angles are imprecise."""
    if kind == "drawer":
        return 1.0
    seen = EDGE_ERROR / (2.0 * np.sin(value / 2.0))
    return float(AXIS_ERROR**2 / (AXIS_ERROR**2 + seen**2))


def _edge(
    kind: PartKind, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Return a point on the edge of a front at which a kind of part has its hinge."""
    return {
        "door_left": np.array([low[0], low[1], 0.0]),
        "door_right": np.array([high[0], low[1], 0.0]),
        "door_down": np.array([0.0, low[1], low[2]]),
        "door_up": np.array([0.0, low[1], high[2]]),
        "drawer": np.zeros(3),
    }[kind]


def _free_end(kind: PartKind, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> float:
    """Return the coordinate of the edge opposite to the hinge, along the front [m]."""
    axis = 2 if kind in ("door_down", "door_up") else 0
    return float((high if FREE.get(kind, 1.0) > 0.0 else low)[axis])


def _transform(
    kind: PartKind, pivot: Float[np.ndarray, "3"], axis: Sequence[float], value: float
) -> Float[np.ndarray, "4 4"]:
    """Return the transform of a part that is open by a value [rad] or [m]."""
    if kind == "drawer":
        return pose(value * np.array(axis))
    R = rotation_about(np.array(axis), np.array(value))
    return pose(pivot - R @ pivot, R)


def _support(
    tree: cKDTree,
    new: Cloud,
    side: Side,
    T: Float[np.ndarray, "4 4"],
) -> float:
    """Return the share of a moved side that lies on a new surface facing the same way."""
    away, index = tree.query(apply(T, side.points), distance_upper_bound=SAME_SURFACE)
    found = np.isfinite(away)
    facing = new.normals[index[found]] @ (T[:3, :3] @ side.normal) > MIN_FACING
    return float(facing.sum() / len(side.points))


def _fitted(
    kind: PartKind,
    side: Side,
    after: Cloud,
    T: Float[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "3"], float] | None:
    """Fit a point on the axis and the value that move a side of a part to where it is observed.

    The side's plane gives the angle and one translation, its free edge the other translation; the
    axis is the fixed point.
    """
    axis, front = np.array(AXES[kind]), side.points
    slides = kind == "drawer"
    u, v = _across(kind)  # along the front, and out of it, in the plane that the part moves in
    middle = np.median(front, axis=0)
    value = float(-T[1, 3]) if slides else 0.0
    for _ in range(ROUNDS):
        R = T[:3, :3]
        back = apply(invert(T), after.points)
        beside = np.abs(back - middle) - np.ptp(front, axis=0) / 2
        near = (beside < [EDGE_MARGIN, LAYER, EDGE_MARGIN]).all(1)
        near &= after.normals @ (R @ side.normal) > MIN_FIT_FACING
        if near.sum() < MIN_POINTS:
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
        # Points are evenly distributed on a leaf, but depth images blur its edge.
        ends = FREE[kind] * side.free_end, most + (most - half) * (5.0 / 45.0)
        depth = [np.median(points @ n) for points in (first, flat)]
        shift = (ends[1] - ends[0]) * along + (depth[1] - depth[0]) * n
        center = np.linalg.solve(np.eye(2) - R2, shift)
        value = turn * float(np.sign(np.cross(u, v) @ axis))
        if not TURNS[0] / 2 < value < np.pi:
            return None
        pivot = center[0] * u + center[1] * v
        T = _transform(kind, pivot, axis.tolist(), value)
    if slides:
        return (np.zeros(3), value) if value > 0.0 else None
    return pivot, value


def _across(kind: PartKind) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return two directions across an axis: along the front, and to the back."""
    along = [0.0, 0.0, 1.0] if kind in ("door_down", "door_up") else [1.0, 0.0, 0.0]
    return np.array(along), np.array([0.0, 1.0, 0.0])


def _normal(
    flat: Float[np.ndarray, "n 2"], about: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "2"]:
    """Fit the normal of a line through points, robustly."""
    kept = flat
    for _ in range(4):
        middle = kept.mean(0)
        _, _, axes = np.linalg.svd(kept - middle, full_matrices=False)
        n = axes[1] * np.sign(axes[1] @ about or 1.0)
        off = np.abs((flat - middle) @ n)
        kept = flat[off <= max(2.5 * np.median(off), 2e-3)]
    return n


def _signed_turn(one: Float[np.ndarray, "2"], other: Float[np.ndarray, "2"]) -> float:
    return float(np.arctan2(one[0] * other[1] - one[1] * other[0], one @ other))


def _local(cloud: Cloud, T: Float[np.ndarray, "4 4"], reach: float) -> Cloud:
    """Return the part of a cloud near a piece, in its frame."""
    points = apply(T, cloud.points)
    near = np.linalg.norm(points, axis=1) < reach
    return Cloud(points[near], cloud.normals[near] @ T[:3, :3].T, cloud.colors[near])


def _only_in(cloud: Cloud, other: Cloud, near: float) -> Cloud:
    """Return the points of a cloud that have no neighbor in another one."""
    if not len(cloud.points) or not len(other.points):
        return cloud
    away, _ = cKDTree(other.points).query(cloud.points, distance_upper_bound=near)
    new = np.isinf(away)
    return Cloud(cloud.points[new], cloud.normals[new], cloud.colors[new])
