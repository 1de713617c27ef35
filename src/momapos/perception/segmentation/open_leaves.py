"""Find doors and flaps that stand open in a scan, before the room is segmented.

An open leaf is a thin slab: the cameras also see behind it. One of its edges lies at a front, and
next to that edge, where the leaf would be when closed, there is a cavity of its size.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import between
from momapos.model.records import Cloud, OpenLeaf

from .leaf_evidence import (
    CELL,
    EMPTY_BEHIND,
    HINGE_DEPTH,
    LAYER,
    LEAF_THICKNESS,
    MAX_BESIDE,
    MAX_LIFT,
    MIN_AREA,
    MIN_FACING,
    MIN_FILLED,
    MIN_FRONT_FACING,
    MIN_POINTS,
    MIN_REMOVED,
    MIN_THIN,
    OTHER_SIDE,
    SEARCH_DISTANCE,
    SIDE_RANGE,
    TURN_RANGE,
    WALL_DISTANCE,
    Free,
    evidence,
    is_same,
)
from .room_shell import area, cell_numbers, peaks
from .supports import components

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

ANGLE_STEP = np.radians(15.0)
"""Angle between the normal directions that are searched [rad]."""
MIN_ALIGNED = np.cos(np.radians(15.0))
"""Surfaces are parallel to the walls from this cosine between normal and axis on [-]."""
FRONT_WEIGHT = 2.0
"""Weight of the size of the front that a leaf protrudes from [-]."""
FIT_ROUNDS = 6
"""Iterations of the robust plane fit [-]."""


def find_open_leaves(
    cloud: Cloud,
    free: Free,
    walls: Sequence[tuple[int, float]] = (),
) -> list[OpenLeaf]:
    """Find open doors and flaps, the largest first.

    Args:
        cloud: Upright, fronts along x and y.
        free: Tells which places were seen to be empty.
        walls: Axis of the normal, 0 or 1, and coordinate [m] of each wall; what protrudes from a
            wall is not a leaf.
    """
    coarse = _one_per_cell(cloud.points, LAYER)
    if len(coarse) < MIN_REMOVED * len(cloud.points):
        cloud = Cloud(cloud.points[coarse], cloud.normals[coarse], cloud.colors[coarse])
    points = cloud.points
    among = _one_per_cell(points, CELL)
    thin = np.zeros(len(points), bool)
    for away in EMPTY_BEHIND:
        thin[among] |= free(points[among] - away * cloud.normals[among])
    found: list[tuple[float, OpenLeaf]] = []
    for hinge in np.eye(3)[[2, 0, 1]]:
        for patch in _patches(cloud, among, thin, hinge):
            found += _leaves_of(patch, cloud, free, thin, hinge, walls)
    found.sort(key=lambda pair: -pair[0])
    kept: list[OpenLeaf] = []
    for _, leaf in found:
        if not any(is_same(leaf, other) for other in kept):
            kept.append(leaf)
    return sorted(kept, key=lambda leaf: -leaf.size[0] * leaf.size[1])


def _one_per_cell(points: Float[np.ndarray, "n 3"], cell: float) -> Int[np.ndarray, " m"]:
    _, first = np.unique(cell_numbers(points, cell), return_index=True)
    return np.sort(first)


def _patches(
    cloud: Cloud,
    among: Int[np.ndarray, " m"],
    thin: Bool[np.ndarray, " n"],
    hinge: Float[np.ndarray, "3"],
) -> Iterator[Int[np.ndarray, " k"]]:
    """Yield flat groups of points whose plane contains the direction of a hinge.

    Groups parallel to the walls must be partly thin, because furniture is parallel to walls too.
    """
    points, normals = cloud.points, cloud.normals
    square = among[np.abs(normals[among] @ hinge) < np.sin(ANGLE_STEP)]
    one = np.roll(hinge, 1)
    other = np.cross(hinge, one)
    for angle in np.arange(0.0, 2 * np.pi, ANGLE_STEP):
        facing = np.cos(angle) * one + np.sin(angle) * other
        group = square[normals[square] @ facing > np.cos(ANGLE_STEP)]
        place = points[group] @ np.stack([np.cross(hinge, facing), facing, hinge], axis=1)
        cell = (2 * CELL, LAYER + CELL, 2 * CELL)
        label = components(place, cell)
        for k in range(label.max(initial=-1) + 1):
            patch = group[label == k]
            if len(patch) * CELL**2 < MIN_AREA:
                break
            askew = np.abs(normals[patch].mean(0)).max() < MIN_ALIGNED
            if askew or thin[patch].sum() * CELL**2 >= MIN_THIN * MIN_AREA:
                yield patch


@dataclass(frozen=True, eq=False)
class _Slab:
    """A flat rectangle that protrudes from a front."""

    edge: Float[np.ndarray, "3"]
    """End of its hinge with the lower coordinate along it [m]."""
    open_along: Float[np.ndarray, "3"]
    """Unit vector from the hinge to the free edge."""
    facing: Float[np.ndarray, "3"]
    """Unit normal toward the side that was seen."""
    out: Float[np.ndarray, "3"]
    """Outward unit normal of the front."""
    hinge: Float[np.ndarray, "3"]
    """Unit vector along the hinge."""
    front: float
    """Coordinate of the front along its normal [m]."""
    size: tuple[float, float]
    """From the hinge to the free edge, and along the hinge [m]."""


def _leaves_of(
    patch: Int[np.ndarray, " k"],
    cloud: Cloud,
    free: Free,
    thin: Bool[np.ndarray, " n"],
    hinge: Float[np.ndarray, "3"],
    walls: Sequence[tuple[int, float]],
) -> Iterator[tuple[float, OpenLeaf]]:
    """Yield the leaves that a flat group of points may be, with scores.

    A door opened by 90 degrees is coplanar with the side of its furniture. It starts at the front.
    """
    points, normals = cloud.points[patch], cloud.normals[patch]
    low, high = points.min(0), points.max(0)
    around = max(SEARCH_DISTANCE, float(np.ptp(points, axis=0).max()) + MAX_BESIDE)
    cloud = _part(cloud, low - around, high + around)
    reach = CELL + 2 * LAYER + LEAF_THICKNESS[1]
    near = _part(cloud, low - reach, high + reach)
    for out in np.concatenate([np.eye(3)[:2], -np.eye(3)[:2]]):
        if abs(out @ hinge) > 0.5 or abs(normals.mean(0) @ out) > np.cos(
            TURN_RANGE[0] - ANGLE_STEP
        ):
            continue
        for front, likely in _fronts(cloud, out):
            if any(abs(front * out[axis] - at) < WALL_DISTANCE and out[axis] for axis, at in walls):
                continue
            ahead = points @ out > front
            if ahead.sum() * CELL**2 < MIN_AREA:
                continue
            if (points[ahead] @ out).min() - front > MAX_BESIDE + LEAF_THICKNESS[1]:
                continue
            slab = _slab(near, points[ahead], normals[ahead], front, out, hinge)
            if slab is None:
                continue
            askew = np.abs(slab.facing).max() < MIN_ALIGNED
            if askew or thin[patch[ahead]].mean() >= MIN_THIN:
                for share, leaf in _leaves(slab, near, cloud, free):
                    yield share + FRONT_WEIGHT * likely, leaf


def _part(cloud: Cloud, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> Cloud:
    there = between(cloud.points, low, high)
    return Cloud(cloud.points[there], cloud.normals[there], cloud.colors[there])


def _fronts(cloud: Cloud, out: Float[np.ndarray, "3"]) -> list[tuple[float, float]]:
    """Return the coordinates of a cloud's fronts along their normal [m], and their scores.

    The score is the size relative to the largest front, less what lies in front of it and faces
    the same way [-].
    """
    facing = cloud.normals @ out > MIN_FRONT_FACING
    at = cloud.points[facing] @ out
    found = np.array(peaks(at, LAYER, MIN_POINTS, 1.5 * LAYER))
    if not len(found):
        return []
    near = np.abs(at - found[:, None]) < LAYER
    before = (at > found[:, None] + MAX_BESIDE) & (at < found[:, None] + SEARCH_DISTANCE)
    counts = near.sum(1)
    likely = counts / counts.max() - np.minimum(before.sum(1) / counts, 1.0)
    return list(zip(found.tolist(), likely.tolist(), strict=True))


def _slab(
    cloud: Cloud,
    points: Float[np.ndarray, "k 3"],
    normals: Float[np.ndarray, "k 3"],
    front: float,
    out: Float[np.ndarray, "3"],
    hinge: Float[np.ndarray, "3"],
) -> _Slab | None:
    """Fit a rectangle to the points of a group that lie in one plane; None if there is none."""
    kept = points
    for _ in range(FIT_ROUNDS):
        middle = kept.mean(0)
        flat = kept - middle
        flat = flat - np.outer(flat @ hinge, hinge)
        _, axes = np.linalg.eigh(flat.T @ flat)  # along the hinge, across the leaf, along it
        facing = np.cross(axes[:, 2], hinge)
        facing = facing / np.linalg.norm(facing) * np.sign(normals.mean(0) @ facing or 1.0)
        off = np.abs((points - middle) @ facing)
        kept = points[off <= max(2.0 * float(np.median(off)), LAYER / 2)]
    along = np.cross(hinge, facing)
    along = along * np.sign(along @ out or 1.0)
    axes = np.stack([along, facing, hinge], axis=1)
    coarse = (kept - middle) @ axes
    low, high = coarse.min(0) - CELL, coarse.max(0) + CELL
    uneven = 2.0 * float(np.median(np.abs((kept - middle) @ facing)))
    flat = np.abs(cloud.points @ facing - middle @ facing) < np.clip(uneven, LAYER, 2 * LAYER)
    flat[flat] &= cloud.normals[flat] @ facing > MIN_FACING
    flat[flat] &= cloud.points[flat] @ out > front
    place = (cloud.points[flat] - middle) @ axes
    place = place[((place > low) & (place < high))[:, [0, 2]].all(1)]
    if not len(place):
        return None
    low, high = np.percentile(place, (1.0, 99.0), axis=0)
    width, height = (high - low)[[0, 2]]
    if min(width, height) < SIDE_RANGE[0] or max(width, height) > SIDE_RANGE[1]:
        return None
    if area(place[:, 0], place[:, 2], CELL) < MIN_FILLED * width * height:
        return None
    edge = middle + axes @ [low[0], np.median(place[:, 1]), low[2]]
    return _Slab(edge, along, facing, out, hinge, front, (float(width), float(height)))


def _leaves(slab: _Slab, near: Cloud, cloud: Cloud, free: Free) -> Iterator[tuple[float, OpenLeaf]]:
    thickness = _other_side(slab, near)
    for along in (np.cross(slab.hinge, slab.out), np.cross(slab.out, slab.hinge)):
        value = float(np.arctan2(slab.open_along @ slab.out, slab.open_along @ along))
        if TURN_RANGE[0] < value < TURN_RANGE[1]:
            leaf = _leaf(slab, along, value, thickness, cloud)
            if leaf is None or (leaf.kind == "door_up" and value > MAX_LIFT):
                continue
            apart = (slab.edge - leaf.pivot) @ slab.open_along / MAX_BESIDE
            share = evidence(leaf, cloud, free) if apart < 1.0 else 0.0
            if share > 0.0:
                yield share - apart, leaf


def _leaf(
    slab: _Slab,
    along: Float[np.ndarray, "3"],
    value: float,
    thickness: float | None,
    cloud: Cloud,
) -> OpenLeaf | None:
    """Return a slab as a leaf opened by an angle [rad]; None if it would lie behind its hinge."""
    leaf = _hinged(slab, along, value, thickness or LEAF_THICKNESS[0])
    if thickness is None and slab.facing @ leaf.normal < 0.0:
        rim = _rim(leaf, cloud)
        leaf = leaf if rim is None else _hinged(slab, along, value, rim)
    return leaf if min(leaf.size) > 0.0 else None


def _hinged(
    slab: _Slab,
    along: Float[np.ndarray, "3"],
    value: float,
    thickness: float,
) -> OpenLeaf:
    """Return a slab as a leaf of a given thickness, with its axis behind its outer face."""
    looks = np.cos(value) * slab.out - np.sin(value) * along  # normal of its outer face, open
    face = slab.edge if slab.facing @ looks > 0.0 else slab.edge + thickness * looks
    deep = slab.front - HINGE_DEPTH
    aside = (HINGE_DEPTH - face @ looks + deep * np.cos(value)) / np.sin(value)
    low = (slab.edge @ slab.hinge) * slab.hinge
    pivot = aside * along + deep * slab.out + low
    end = slab.edge + slab.size[0] * slab.open_along
    size = float((end - pivot) @ slab.open_along), slab.size[1]
    corner = pivot + HINGE_DEPTH * slab.out
    return OpenLeaf(corner, along, slab.out, size, pivot, value, thickness)


def _other_side(slab: _Slab, cloud: Cloud) -> float | None:
    axes = np.stack([slab.open_along, slab.facing, slab.hinge], axis=1)
    place = (cloud.points - slab.edge) @ axes
    on = ((place[:, [0, 2]] > 0.0) & (place[:, [0, 2]] < slab.size)).all(1)
    on &= (place[:, 1] < 0.0) & (place[:, 1] > -LEAF_THICKNESS[1])
    on &= cloud.normals @ slab.facing < -MIN_FRONT_FACING
    seen = area(place[on, 0], place[on, 2], CELL)
    if seen < OTHER_SIDE * slab.size[0] * slab.size[1]:
        return None
    return max(-float(np.median(place[on, 1])), LEAF_THICKNESS[0] / 2)


def _rim(leaf: OpenLeaf, cloud: Cloud) -> float | None:
    """Return how far behind the front the leaf's stop lies [m]; None if it was not seen."""
    place = leaf.local(cloud.points)
    inside = (place[:, [0, 2]] > -LAYER).all(1)
    inside &= (place[:, [0, 2]] < np.array(leaf.size) + LAYER).all(1)
    edge = np.minimum(place[:, [0, 2]], leaf.size - place[:, [0, 2]]).min(1) < MAX_BESIDE / 2
    deep = (place[:, 1] < -LAYER) & (place[:, 1] > -LEAF_THICKNESS[1])
    on = inside & edge & deep & (cloud.normals @ leaf.out > MIN_FRONT_FACING)
    return -float(np.median(place[on, 1])) if on.sum() >= MIN_POINTS else None
