"""The deepest overlap of pairs of shapes over a motion, and the checks made of overlaps.

A state is skipped if it cannot be the deepest: between two states, no point of a shape moves
farther than the corners of its box can, and the depth changes by at most the motion of the
points. The result equals checking every state, with a few exact queries per pair.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import contact_text
from momapos.core.compiled import F1, F2, F3, F4, I2, entry, kernel

from .convex import TOLERANCE, Body, overlap
from .exact_shapes import ShapeArrays, Shapes, triangle_shapes, without_piece
from .report import Check, at_most

if TYPE_CHECKING:
    from jaxtyping import Float, Int


def deepest(
    a: Shapes,
    Ts_a: Float[np.ndarray, "s a 4 4"],
    b: Shapes,
    Ts_b: Float[np.ndarray, "#s b 4 4"],
    pairs: Int[np.ndarray, "p 2"],
    floor: float,
) -> tuple[Float[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Find the deepest overlap of pairs of shapes, and its state.

    Args:
        a, b: The shapes.
        Ts_a, Ts_b: Their world poses; `Ts_b` may hold a single state, for static shapes.
        pairs: Indices into `a` and `b`.
        floor: Smallest depth of interest [m]; below zero, distances count as negative depths.

    Returns:
        Depth [m] and state of each pair; the floor and -1 where no depth exceeds the floor.
    """
    depth, state = _deepest(
        np.ascontiguousarray(pairs, np.int64),
        np.ascontiguousarray(Ts_a), np.ascontiguousarray(Ts_b), a.arrays, b.arrays, floor,
    )  # fmt: skip
    return depth, state


def first_contact(
    a: Shapes,
    Ts_a: Float[np.ndarray, "s a 4 4"],
    travel: Float[np.ndarray, " s"],
    b: Shapes,
    Ts_b: Float[np.ndarray, "b 4 4"],
    press: Float[np.ndarray, "s 3"],
) -> tuple[int, float]:
    """Find the first state in which shapes on a path touch others, and how they press on.

    Args:
        a: The shapes on the path.
        Ts_a: Their poses.
        travel: How far any of their points has moved at each state, at most [m].
        b, Ts_b: The other shapes, which stand still.
        press: By how much to move straight on after a contact at each state [m].

    Returns:
        The state, -1 if there is none, and by how much the deepest overlap then grows, as a share
        of the motion: 1 if the shapes press along the normal of the contact, 0 if they slide along
        it, and less than 1 also if the path ends before it is that long.
    """
    state, bite = _first_contact(
        all_pairs(len(a), len(b)), np.ascontiguousarray(Ts_a), travel,
        np.ascontiguousarray(Ts_b), a.arrays, b.arrays, np.ascontiguousarray(press),
    )  # fmt: skip
    return int(state), float(bite)


def all_pairs(count_a: int, count_b: int) -> Int[np.ndarray, "p 2"]:
    """Pair every shape of one set with every shape of another."""
    pairs = np.empty((count_b, count_a, 2), np.int64)
    pairs[..., 0], pairs[..., 1] = np.arange(count_a), np.arange(count_b)[:, None]
    return pairs.reshape(-1, 2)


@kernel
def _swept(Ts, half):
    """Return axis-aligned bounding boxes over the whole motion: corners (2, k, 3) [m]."""
    box = np.empty((2, Ts.shape[1], 3))
    box[0], box[1] = np.inf, -np.inf
    for s in range(len(Ts)):
        for k in range(Ts.shape[1]):
            T, h = Ts[s, k], half[k]
            for r in range(3):
                extent = abs(T[r, 0]) * h[0] + abs(T[r, 1]) * h[1] + abs(T[r, 2]) * h[2]
                box[0, k, r] = min(box[0, k, r], T[r, 3] - extent)
                box[1, k, r] = max(box[1, k, r], T[r, 3] + extent)
    return box


@kernel
def _meet(a, b, i, j, floor):
    for r in range(3):
        if a[0, i, r] > b[1, j, r] - floor or b[0, j, r] > a[1, i, r] - floor:
            return False
    return True


@entry
def _deepest(
    pairs: I2, Ts_a: F4, Ts_b: F4, a: ShapeArrays, b: ShapeArrays, floor: float
) -> tuple[np.ndarray, np.ndarray]:
    depths, states = np.full(len(pairs), floor), np.full(len(pairs), -1)
    bounds, Ts = np.empty(len(Ts_a)), np.empty((len(Ts_a), 4, 4))
    index = np.empty(len(Ts_a), np.int64)
    swept_a, swept_b = _swept(Ts_a, a.half), _swept(Ts_b, b.half)
    for p in range(len(pairs)):
        i, j = pairs[p]
        if not _meet(swept_a, swept_b, i, j, floor):
            continue
        count, stride = 0, 1 if len(Ts_b) == len(Ts_a) else 0
        near = max(0.0, _radius(a.half[i]) + _radius(b.half[j]) - floor) ** 2
        for s in range(len(Ts_a)):
            x = Ts_a[s, i, 0, 3] - Ts_b[s * stride, j, 0, 3]
            y = Ts_a[s, i, 1, 3] - Ts_b[s * stride, j, 1, 3]
            z = Ts_a[s, i, 2, 3] - Ts_b[s * stride, j, 2, 3]
            if x * x + y * y + z * z > near:
                continue
            bound = _bound(Ts_a[s, i], Ts_b[s * stride, j], a.half[i], b.half[j], Ts[count])
            if bound > floor:
                bounds[count], index[count] = bound, s
                count += 1
        if count:
            found = _search(_core(a, i), _core(b, j), Ts[:count], bounds[:count], a.half[i], floor)
            depths[p] = found[0]
            if found[1] >= 0:
                states[p] = index[found[1]]
    return depths, states


@kernel
def _depth_at(pairs, Ts_a, Ts_b, a, b, T):
    """Return the deepest overlap of any pair; less than minus their distance is not exact."""
    deep = -np.inf
    for p in range(len(pairs)):
        i, j = pairs[p]
        if _bound(Ts_a[i], Ts_b[j], a.half[i], b.half[j], T) > deep:
            deep = max(deep, overlap(_core(a, i), _core(b, j), T))
    return deep


@entry
def _first_contact(
    pairs: I2, Ts_a: F4, travel: F1, Ts_b: F3, a: ShapeArrays, b: ShapeArrays, press: F2
) -> tuple[int, float]:
    T, count, s = np.empty((4, 4)), len(Ts_a), np.int64(0)
    while s < count:
        depth = _depth_at(pairs, Ts_a[s], Ts_b, a, b, T)
        if depth >= 0.0:
            break
        reached = travel[s] - depth
        s += 1
        while s < count and travel[s] < reached:
            s += 1
    if s == count:
        return -1, -np.inf
    pressed = Ts_a[s].copy()
    for i in range(len(pressed)):
        for k in range(3):
            pressed[i, k, 3] += press[s, k]
    grown = _depth_at(pairs, pressed, Ts_b, a, b, T) - depth
    length = max(1e-9, np.sqrt(press[s, 0] ** 2 + press[s, 1] ** 2 + press[s, 2] ** 2))
    return int(s), grown / length * min(1.0, (travel[-1] - travel[s]) / length)


@kernel
def _core(shapes, i):
    points = shapes.points[shapes.first[i] : shapes.first[i + 1]]
    return Body(points, shapes.disc[i], shapes.ball[i])


@kernel
def _radius(half):
    """Radius of the sphere around a box."""
    return np.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)


@kernel
def _bound(T_a, T_b, half_a, half_b, T):
    """Return an upper bound on the depth of two boxes; write the pose of A in B's frame to `T`.

    The overlap along any direction bounds the depth; the box axes are used.
    """
    bound = np.inf
    for r in range(3):
        for c in range(3):
            T[r, c] = T_b[0, r] * T_a[0, c] + T_b[1, r] * T_a[1, c] + T_b[2, r] * T_a[2, c]
        T[r, 3] = 0.0
        for k in range(3):
            T[r, 3] += T_b[k, r] * (T_a[k, 3] - T_b[k, 3])
    T[3, :3] = 0.0
    T[3, 3] = 1.0
    for r in range(3):
        extent_b = extent_a = along_a = 0.0
        for c in range(3):
            extent_b += abs(T[r, c]) * half_a[c]
            extent_a += abs(T[c, r]) * half_b[c]
            along_a += T[c, r] * T[c, 3]
        bound = min(bound, half_b[r] + extent_b - abs(T[r, 3]))
        bound = min(bound, half_a[r] + extent_a - abs(along_a))
    return bound


@kernel
def _search(a, b, Ts, bounds, half, floor):
    """Branch and bound over the states of one pair."""
    radius = _radius(half)
    best, where = floor, np.int64(-1)
    while True:
        s = np.int64(0)
        for other in range(1, len(bounds)):
            if bounds[other] > bounds[s]:
                s = np.int64(other)
        if bounds[s] <= best + TOLERANCE:
            return best, where
        depth = overlap(a, b, Ts[s])
        if depth > best:
            best, where = depth, s
        bounds[s] = -np.inf
        for other in range(len(bounds)):
            if bounds[other] > best:
                limit = depth + _farthest_move(Ts[s], Ts[other], radius)
                bounds[other] = min(bounds[other], limit)


@kernel
def _farthest_move(T, U, radius):
    """Bound how far any point within `radius` of the origin moves from T to U."""
    shift = turn = 0.0
    for r in range(3):
        shift += (U[r, 3] - T[r, 3]) ** 2
        for c in range(3):
            turn += (U[r, c] - T[r, c]) ** 2
    return np.sqrt(shift) + radius * np.sqrt(0.5 * turn)  # |U - T| = sqrt(8) sin(angle / 2)


MAX_TRIANGLE_PAIRS = 100_000
"""Pairs of triangles that are compared together; they need about 0.1 kB each [-]."""


def surfaces_cross(one: Float[np.ndarray, "t 3 3"], other: Float[np.ndarray, "u 3 3"]) -> bool:
    """Return whether triangles of two surfaces meet.

    The larger surface is halved until few triangles are left in the boxes around both.
    """
    parts = [(one, other)]
    while parts:
        one, other = parts.pop()
        for _ in range(2):  # leave out what is outside the box around the other
            low, high = other.min((0, 1), initial=np.inf), other.max((0, 1), initial=-np.inf)
            near = one[((one.min(1) <= high) & (one.max(1) >= low)).all(1)]
            one, other = other, near
        if len(one) * len(other) > MAX_TRIANGLE_PAIRS:
            large, small = (one, other) if len(one) >= len(other) else (other, one)
            middle = large.mean(1)
            order = middle[:, np.ptp(middle, axis=0).argmax()].argsort()
            parts += [(large[half], small) for half in np.array_split(order, 2)]
        elif len(one) and len(other):
            a, b = triangle_shapes(one, 0, ""), triangle_shapes(other, 0, "")
            Ts_a, Ts_b = a.Ts_body_shape[None], b.Ts_body_shape[None]
            if (deepest(a, Ts_a, b, Ts_b, all_pairs(len(a), len(b)), 0.0)[1] >= 0).any():
                return True
    return False


MAX_NAMED_PAIRS = 6
"""Largest number of overlapping pairs that a check lists [-]."""


class Overlaps:
    """Collects overlapping pairs of links, each with its deepest overlap."""

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self.worst: dict[tuple[str, str], tuple[float, str]] = {}
        """Depth [m], and in words which shapes overlap and where, by pair of links."""

    def add(
        self,
        a: Shapes,
        Ts_a: Float[np.ndarray, "s a 4 4"],
        b: Shapes,
        Ts_b: Float[np.ndarray, "#s b 4 4"],
        pairs: Int[np.ndarray, "p 2"],
        where: Callable[[int], str],
        *,
        swapped: bool = False,
        already: Float[np.ndarray, " p"] | float = 0.0,
    ) -> None:
        """Add pairs of shapes; overlap counts beyond `already` [m]."""
        depth, state = deepest(a, Ts_a, b, Ts_b, pairs, min(0.0, self.limit))
        self.collect(a, b, pairs, depth - already, state, where, swapped=swapped)

    def collect(
        self,
        a: Shapes,
        b: Shapes,
        pairs: Int[np.ndarray, "p 2"],
        depth: Float[np.ndarray, " p"],
        state: Int[np.ndarray, " p"],
        where: Callable[[int], str],
        *,
        swapped: bool = False,
    ) -> None:
        """Add pairs of shapes by their deepest overlap [m] and its state, see `deepest`."""
        for p in np.flatnonzero(state >= 0):
            names = (a.names[pairs[p, 0]], b.names[pairs[p, 1]])
            one, other = names[::-1] if swapped else names
            pair, deep = (without_piece(one), without_piece(other)), float(depth[p])
            if deep > self.worst.get(pair, (-np.inf, ""))[0]:
                words = f"{contact_text(one, other, deep)} at {where(int(state[p]))}"
                self.worst[pair] = deep, words

    def check(self, name: str) -> Check:
        ranked = sorted(self.worst.items(), key=lambda item: -item[1][0])
        deep = ranked[0][1][0] if ranked else min(0.0, self.limit)
        bad = [(pair, text) for pair, (d, text) in ranked if d > self.limit]
        words = [text for _, text in bad[:MAX_NAMED_PAIRS]]
        more = (
            [f"and {len(bad) - MAX_NAMED_PAIRS} more pairs"] if len(bad) > MAX_NAMED_PAIRS else []
        )
        culprit = " and ".join(bad[0][0]) if bad else ""
        return at_most(
            name, 1000 * deep, 1000 * self.limit, "mm deep", "; ".join(words + more), culprit
        )
