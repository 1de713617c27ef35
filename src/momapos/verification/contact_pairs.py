"""Find which objects of a scene touch or overlap, with exact shapes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.scene import Scene

from .exact_shapes import Shapes, join
from .moved_part import static_shapes
from .sweep import deepest

if TYPE_CHECKING:
    from jaxtyping import Float, Int

MAX_PAIRS = 1_000_000
"""Pairs of shapes that are compared together; they need about 0.1 kB each [-]."""


@dataclass(frozen=True)
class ObjectContact:
    """Two objects, with the deepest overlap of their shapes."""

    first: int
    second: int
    """Indices of the objects in the scene."""
    depth: float
    """Distance by which they must move apart to touch no more [m]; negative for a gap."""
    labels: tuple[str, str]
    """The two overlapping links, as object/link."""


def object_contacts(scene: Scene, max_gap: float) -> tuple[ObjectContact, ...]:
    """Find the pairs of objects that overlap or are close to each other, at their joint values.

    Args:
        scene: The scene.
        max_gap: Objects farther apart are left out [m].

    Returns:
        The pairs, the deepest first.
    """
    found: dict[tuple[int, int], ObjectContact] = {}
    parts = [static_shapes(item) for item in scene.objects]
    shapes = join(parts, [f"{item.name}/" for item in scene.objects])
    owner = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    Ts = shapes.Ts_body_shape[None]
    for pairs in _close_pairs(shapes, owner, max_gap):
        depth, state = deepest(shapes, Ts, shapes, Ts, pairs, -max_gap)
        for p in np.flatnonzero(state >= 0):
            i, j = pairs[p].tolist()
            key, labels = (int(owner[i]), int(owner[j])), (shapes.names[i], shapes.names[j])
            if key not in found or depth[p] > found[key].depth:
                found[key] = ObjectContact(*key, float(depth[p]), labels)
    return tuple(sorted(found.values(), key=lambda one: -one.depth))


def _close_pairs(
    shapes: Shapes, owner: Int[np.ndarray, " k"], gap: float
) -> Iterator[Int[np.ndarray, "p 2"]]:
    """Yield the pairs of shapes of different objects whose boxes are close, many at a time."""
    if not len(shapes):
        return
    T = shapes.Ts_body_shape
    extent = np.einsum("kij,kj->ki", np.abs(T[:, :3, :3]), shapes.half)
    low, high = T[:, :3, 3] - extent, T[:, :3, 3] + extent + gap
    count = np.bincount(owner)
    first = np.concatenate([[0], np.cumsum(count)])
    full = np.flatnonzero(count)
    a, b = _overlapping(
        np.minimum.reduceat(low, first[full]), np.maximum.reduceat(high, first[full])
    )
    a, b = full[a], full[b]
    products = count[a] * count[b]
    for block in np.split(np.arange(len(a)), _cuts(products)):
        size = products[block]
        pair = np.repeat(block, size)
        within = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
        i = first[a[pair]] + within // count[b[pair]]
        j = first[b[pair]] + within % count[b[pair]]
        close = ((low[i] <= high[j]) & (low[j] <= high[i])).all(1)
        yield np.column_stack([i[close], j[close]])


def _overlapping(
    low: Float[np.ndarray, "n 3"], high: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Return the pairs of overlapping boxes, smaller index first."""
    meet = np.triu(np.ones((len(low), len(low)), bool), 1)
    for axis in range(3):
        meet &= low[:, None, axis] <= high[None, :, axis]
        meet &= low[None, :, axis] <= high[:, None, axis]
    a, b = np.nonzero(meet)
    return a, b


def _cuts(sizes: Int[np.ndarray, " p"]) -> Int[np.ndarray, " c"]:
    """Return where to split a list so that the sizes of each block sum up to about `MAX_PAIRS`."""
    return np.flatnonzero(np.diff(np.cumsum(sizes) // MAX_PAIRS)) + 1
