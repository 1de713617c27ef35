"""Doors and flaps that stand open in a scan, found before the room is divided into things.

An open leaf is a thin slab: what is behind it is seen, too. It stands out of a front at one of its
edges, and beside that edge, where it would be when shut, one sees into a hollow of its size between
what the leaf closes against.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import between
from momapos.model.records import Cloud, OpenLeaf

from .leaf_evidence import Free, OpenLeafConfig, evidence, same
from .room_shell import area, cell_numbers, peaks
from .supports import components

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

TURN = np.radians(15.0)
"""Between the normals that are looked at together [rad]."""
SQUARE = np.cos(np.radians(15.0))
"""Cosine between the normal of a surface and an axis from which on it is along the walls [-]."""
LARGE = 2.0
"""How much it counts that a leaf stands out of the largest front around [-]."""
ROUNDS = 6
"""Of a fit that leaves out what is beside the plane [-]."""


def find_open_leaves(
    cloud: Cloud,
    free: Free,
    walls: Sequence[tuple[int, float]] = (),
    config: OpenLeafConfig | None = None,
) -> list[OpenLeaf]:
    """Find doors and flaps that stand open, the largest first.

    Args:
        cloud: Upright, fronts along x and y.
        free: Whether places were seen to be empty.
        walls: Axis of the normal, 0 or 1, and coordinate [m] of each wall: what stands out of one
            is no leaf.
        config: Constants.
    """
    config = config or OpenLeafConfig()
    coarse = _apart(cloud.points, config.layer)
    if len(coarse) < config.dense * len(cloud.points):
        cloud = Cloud(cloud.points[coarse], cloud.normals[coarse], cloud.colors[coarse])
    points = cloud.points
    among = _apart(points, config.cell)
    thin = np.zeros(len(points), bool)
    for away in config.thick:
        thin[among] |= free(points[among] - away * cloud.normals[among])
    found: list[tuple[float, OpenLeaf]] = []
    for hinge in np.eye(3)[[2, 0, 1]]:
        for patch in _patches(cloud, among, thin, hinge, config):
            found += _leaves_of(patch, cloud, free, thin, hinge, walls, config)
    found.sort(key=lambda pair: -pair[0])
    kept: list[OpenLeaf] = []
    for _, leaf in found:
        if not any(same(leaf, other, config) for other in kept):
            kept.append(leaf)
    return sorted(kept, key=lambda leaf: -leaf.size[0] * leaf.size[1])


def _apart(points: Float[np.ndarray, "n 3"], cell: float) -> Int[np.ndarray, " m"]:
    """One point of each cell."""
    _, first = np.unique(cell_numbers(points, cell), return_index=True)
    return np.sort(first)


def _patches(
    cloud: Cloud,
    among: Int[np.ndarray, " m"],
    thin: Bool[np.ndarray, " n"],
    hinge: Float[np.ndarray, "3"],
    config: OpenLeafConfig,
) -> Iterator[Int[np.ndarray, " k"]]:
    """Flat groups of points whose plane holds the direction of a hinge.

    Of those along the walls, some are seen to be thin: furniture stands so, too.
    """
    points, normals = cloud.points, cloud.normals
    square = among[np.abs(normals[among] @ hinge) < np.sin(TURN)]
    one = np.roll(hinge, 1)
    other = np.cross(hinge, one)
    for angle in np.arange(0.0, 2 * np.pi, TURN):
        facing = np.cos(angle) * one + np.sin(angle) * other
        group = square[normals[square] @ facing > np.cos(TURN)]
        place = points[group] @ np.stack([np.cross(hinge, facing), facing, hinge], axis=1)
        cell = (2 * config.cell, config.layer + config.cell, 2 * config.cell)
        label = components(place, cell)
        for k in range(label.max(initial=-1) + 1):
            patch = group[label == k]
            if len(patch) * config.cell**2 < config.area:
                break
            askew = np.abs(normals[patch].mean(0)).max() < SQUARE
            if askew or thin[patch].sum() * config.cell**2 >= config.thin * config.area:
                yield patch


@dataclass(frozen=True, eq=False)
class _Slab:
    """A flat rectangle that stands out of a front."""

    edge: Float[np.ndarray, "3"]
    """The end of its hinge that is low along it [m]."""
    open_along: Float[np.ndarray, "3"]
    """Unit vector from there to its free edge."""
    facing: Float[np.ndarray, "3"]
    """Unit normal toward the side that was seen."""
    out: Float[np.ndarray, "3"]
    """Unit normal of the front."""
    hinge: Float[np.ndarray, "3"]
    """Unit vector."""
    front: float
    """Where the front lies along its normal [m]."""
    size: tuple[float, float]
    """From the hinge to the free edge, and along it [m]."""


def _leaves_of(
    patch: Int[np.ndarray, " k"],
    cloud: Cloud,
    free: Free,
    thin: Bool[np.ndarray, " n"],
    hinge: Float[np.ndarray, "3"],
    walls: Sequence[tuple[int, float]],
    config: OpenLeafConfig,
) -> Iterator[tuple[float, OpenLeaf]]:
    """The leaves that a flat group of points may be, and how much speaks for each.

    A door that is open by a right angle lies in one plane with the side of what it belongs to: it
    begins at the front.
    """
    points, normals = cloud.points[patch], cloud.normals[patch]
    low, high = points.min(0), points.max(0)
    around = max(config.around, float(np.ptp(points, axis=0).max()) + config.beside)
    cloud = _part(cloud, low - around, high + around)
    reach = config.cell + 2 * config.layer + config.thickness[1]
    near = _part(cloud, low - reach, high + reach)
    for out in np.concatenate([np.eye(3)[:2], -np.eye(3)[:2]]):
        if abs(out @ hinge) > 0.5 or abs(normals.mean(0) @ out) > np.cos(config.turns[0] - TURN):
            continue
        for front, likely in _fronts(cloud, out, config):
            if any(abs(front * out[axis] - at) < config.wall and out[axis] for axis, at in walls):
                continue
            ahead = points @ out > front
            if ahead.sum() * config.cell**2 < config.area:
                continue
            if (points[ahead] @ out).min() - front > config.beside + config.thickness[1]:
                continue
            slab = _slab(near, points[ahead], normals[ahead], front, out, hinge, config)
            if slab is None:
                continue
            askew = np.abs(slab.facing).max() < SQUARE
            if askew or thin[patch[ahead]].mean() >= config.thin:
                for share, leaf in _leaves(slab, near, cloud, free, config):
                    yield share + LARGE * likely, leaf


def _part(cloud: Cloud, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> Cloud:
    """What of a cloud is in a box."""
    there = between(cloud.points, low, high)
    return Cloud(cloud.points[there], cloud.normals[there], cloud.colors[there])


def _fronts(
    cloud: Cloud, out: Float[np.ndarray, "3"], config: OpenLeafConfig
) -> list[tuple[float, float]]:
    """Where the fronts of a cloud lie along their normal [m], and how large each is.

    As a share of the largest one, less by what is before it and faces the same way [-].
    """
    facing = cloud.normals @ out > config.straight
    at = cloud.points[facing] @ out
    found = np.array(peaks(at, config.layer, config.fewest, 1.5 * config.layer))
    if not len(found):
        return []
    near = np.abs(at - found[:, None]) < config.layer
    before = (at > found[:, None] + config.beside) & (at < found[:, None] + config.around)
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
    config: OpenLeafConfig,
) -> _Slab | None:
    """The rectangle of what of a group of points lies in one plane; None where it is none."""
    kept = points
    for _ in range(ROUNDS):
        middle = kept.mean(0)
        flat = kept - middle
        flat = flat - np.outer(flat @ hinge, hinge)
        _, axes = np.linalg.eigh(flat.T @ flat)  # the hinge, across the line of the leaf, along it
        facing = np.cross(axes[:, 2], hinge)
        facing = facing / np.linalg.norm(facing) * np.sign(normals.mean(0) @ facing or 1.0)
        off = np.abs((points - middle) @ facing)
        kept = points[off <= max(2.0 * float(np.median(off)), config.layer / 2)]
    along = np.cross(hinge, facing)
    along = along * np.sign(along @ out or 1.0)
    axes = np.stack([along, facing, hinge], axis=1)
    coarse = (kept - middle) @ axes
    low, high = coarse.min(0) - config.cell, coarse.max(0) + config.cell
    uneven = 2.0 * float(np.median(np.abs((kept - middle) @ facing)))
    flat = np.abs(cloud.points @ facing - middle @ facing) < np.clip(
        uneven, config.layer, 2 * config.layer
    )
    flat[flat] &= cloud.normals[flat] @ facing > config.facing
    flat[flat] &= cloud.points[flat] @ out > front
    place = (cloud.points[flat] - middle) @ axes
    place = place[((place > low) & (place < high))[:, [0, 2]].all(1)]
    if not len(place):
        return None
    low, high = np.percentile(place, (1.0, 99.0), axis=0)
    width, height = (high - low)[[0, 2]]
    if min(width, height) < config.sides[0] or max(width, height) > config.sides[1]:
        return None
    if area(place[:, 0], place[:, 2], config.cell) < config.filled * width * height:
        return None
    edge = middle + axes @ [low[0], np.median(place[:, 1]), low[2]]
    return _Slab(edge, along, facing, out, hinge, front, (float(width), float(height)))


def _leaves(
    slab: _Slab, near: Cloud, cloud: Cloud, free: Free, config: OpenLeafConfig
) -> Iterator[tuple[float, OpenLeaf]]:
    """The leaves that a slab may be, and how much speaks for each."""
    thickness = _other_side(slab, near, config)
    for along in (np.cross(slab.hinge, slab.out), np.cross(slab.out, slab.hinge)):
        value = float(np.arctan2(slab.open_along @ slab.out, slab.open_along @ along))
        if config.turns[0] < value < config.turns[1]:
            leaf = _leaf(slab, along, value, thickness, cloud, config)
            if leaf is None or (leaf.kind == "door_up" and value > config.lifted):
                continue
            apart = (slab.edge - leaf.pivot) @ slab.open_along / config.beside
            share = evidence(leaf, cloud, free, config) if apart < 1.0 else 0.0
            if share > 0.0:
                yield share - apart, leaf


def _leaf(
    slab: _Slab,
    along: Float[np.ndarray, "3"],
    value: float,
    thickness: float | None,
    cloud: Cloud,
    config: OpenLeafConfig,
) -> OpenLeaf | None:
    """A slab as a leaf that is open by a value [rad]; None where it would lie behind its hinge."""
    leaf = _hinged(slab, along, value, thickness or config.thickness[0], config)
    if thickness is None and slab.facing @ leaf.looks < 0.0:
        rim = _rim(leaf, cloud, config)
        leaf = leaf if rim is None else _hinged(slab, along, value, rim, config)
    return leaf if min(leaf.size) > 0.0 else None


def _hinged(
    slab: _Slab,
    along: Float[np.ndarray, "3"],
    value: float,
    thickness: float,
    config: OpenLeafConfig,
) -> OpenLeaf:
    """A slab as a leaf of some thickness, its axis as far behind its outer face, open and shut."""
    looks = np.cos(value) * slab.out - np.sin(value) * along  # its outer face, now
    face = slab.edge if slab.facing @ looks > 0.0 else slab.edge + thickness * looks
    deep = slab.front - config.hinge_depth
    aside = (config.hinge_depth - face @ looks + deep * np.cos(value)) / np.sin(value)
    low = (slab.edge @ slab.hinge) * slab.hinge
    pivot = aside * along + deep * slab.out + low
    end = slab.edge + slab.size[0] * slab.open_along
    size = float((end - pivot) @ slab.open_along), slab.size[1]
    corner = pivot + config.hinge_depth * slab.out
    return OpenLeaf(corner, along, slab.out, size, pivot, value, thickness)


def _other_side(slab: _Slab, cloud: Cloud, config: OpenLeafConfig) -> float | None:
    """How far behind its face a slab has another one [m]; None where that is not seen."""
    axes = np.stack([slab.open_along, slab.facing, slab.hinge], axis=1)
    place = (cloud.points - slab.edge) @ axes
    on = ((place[:, [0, 2]] > 0.0) & (place[:, [0, 2]] < slab.size)).all(1)
    on &= (place[:, 1] < 0.0) & (place[:, 1] > -config.thickness[1])
    on &= cloud.normals @ slab.facing < -config.straight
    seen = area(place[on, 0], place[on, 2], config.cell)
    if seen < config.other_side * slab.size[0] * slab.size[1]:
        return None
    return max(-float(np.median(place[on, 1])), config.thickness[0] / 2)


def _rim(leaf: OpenLeaf, cloud: Cloud, config: OpenLeafConfig) -> float | None:
    """How far behind the front what a leaf closes against lies [m]; None where none is seen."""
    place = leaf.local(cloud.points)
    inside = (place[:, [0, 2]] > -config.layer).all(1)
    inside &= (place[:, [0, 2]] < np.array(leaf.size) + config.layer).all(1)
    edge = np.minimum(place[:, [0, 2]], leaf.size - place[:, [0, 2]]).min(1) < config.beside / 2
    deep = (place[:, 1] < -config.layer) & (place[:, 1] > -config.thickness[1])
    on = inside & edge & deep & (cloud.normals @ leaf.out > config.straight)
    return -float(np.median(place[on, 1])) if on.sum() >= config.fewest else None
