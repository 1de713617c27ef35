"""Order points so that a path through all of them is short."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int

MAX_EXACT = 12
"""Number of points up to which the shortest order is found [-]; 12 take about 50 ms."""
_LONGEST_RUN = 3
"""Number of neighbors that are moved together [-], as in Or-opt."""
_SAME = 1e-9
"""Smaller gains are rounding errors."""


def shortest_order(
    first: Float[np.ndarray, " n"], between: Float[np.ndarray, "n n"], last: Float[np.ndarray, " n"]
) -> Int[np.ndarray, " n"]:
    """Return the order of points in which a path from a start to an end is shortest, or short.

    Up to `MAX_EXACT` points by dynamic programming (Held and Karp 1962), else the nearest neighbor
    first, improved by reversals (2-opt, Croes 1958) and by moving up to three neighbors (Or 1976).

    Args:
        first: Length from the start to each point.
        between: Symmetric lengths between the points.
        last: Length from each point to the end; zeros for a path that may end anywhere.
    """
    if len(first) <= MAX_EXACT:
        return _exact(first, between, last)
    order = _nearest_neighbor(first, between)
    return improved_order(order, first, between, last)


def path_length(
    order: Int[np.ndarray, " n"], first: Float[np.ndarray, " n"],
    between: Float[np.ndarray, "n n"], last: Float[np.ndarray, " n"],
) -> float:  # fmt: skip
    """Return the length of the path through points in an order, see `shortest_order`."""
    return float(first[order[0]] + between[order[:-1], order[1:]].sum() + last[order[-1]])


def _exact(
    first: Float[np.ndarray, " n"], between: Float[np.ndarray, "n n"], last: Float[np.ndarray, " n"]
) -> Int[np.ndarray, " n"]:
    count = len(first)
    if count == 0:
        return np.zeros(0, np.int64)
    masks, bits = np.arange(1 << count), 1 << np.arange(count)
    best = np.full((1 << count, count), np.inf)
    parent = np.zeros((1 << count, count), np.int64)
    best[bits, np.arange(count)] = first
    sizes = np.bitwise_count(masks)
    for size in range(2, count + 1):
        rows = masks[sizes == size]
        for k in range(count):
            own = rows[rows & bits[k] > 0]
            lengths = best[own ^ bits[k]] + between[:, k]
            parent[own, k] = lengths.argmin(1)
            best[own, k] = lengths.min(1)
    mask, at = (1 << count) - 1, int((best[-1] + last).argmin())
    order = [at]
    while len(order) < count:
        mask, at = mask ^ int(bits[at]), int(parent[mask, at])
        order.append(at)
    return np.array(order[::-1])


def _nearest_neighbor(
    first: Float[np.ndarray, " n"], between: Float[np.ndarray, "n n"]
) -> Int[np.ndarray, " n"]:
    left, row, order = np.ones(len(first), bool), first, []
    for _ in range(len(first)):
        order.append(int(np.where(left, row, np.inf).argmin()))
        left[order[-1]] = False
        row = between[order[-1]]
    return np.array(order)


def improved_order(
    order: Int[np.ndarray, " n"], first: Float[np.ndarray, " n"],
    between: Float[np.ndarray, "n n"], last: Float[np.ndarray, " n"],
) -> Int[np.ndarray, " n"]:  # fmt: skip
    """Improve an order by the best reversals and moves until none shortens the path."""
    count = len(order)
    # The start and the end are points that keep their places; they are far from each other.
    lengths = np.zeros((count + 2, count + 2))
    lengths[1:-1, 1:-1] = between
    lengths[0, 1:-1], lengths[1:-1, 0] = first, first
    lengths[-1, 1:-1], lengths[1:-1, -1] = last, last
    path = np.concatenate([[0], order + 1, [count + 1]])
    while True:
        gain, changed = _best_reversal(path, lengths)
        for size in range(1, min(_LONGEST_RUN, count - 1) + 1):
            other, moved = _best_move(path, lengths, size)
            if other > gain:
                gain, changed = other, moved
        if gain <= _SAME:
            return path[1:-1] - 1
        path = changed


def _best_reversal(
    path: Int[np.ndarray, " m"], lengths: Float[np.ndarray, "m m"]
) -> tuple[float, Int[np.ndarray, " m"]]:
    """Reverse the points from i + 1 to j, for the best i < j."""
    D = lengths[np.ix_(path, path)]
    step = np.diagonal(D, 1)
    gain = step[:, None] + step[None, :] - D[:-1, :-1] - D[1:, 1:]
    gain[np.tril_indices(len(step), 1)] = -np.inf
    i, j = np.unravel_index(int(gain.argmax()), gain.shape)
    changed = path.copy()
    changed[i + 1 : j + 1] = path[i + 1 : j + 1][::-1]
    return float(gain[i, j]), changed


def _best_move(
    path: Int[np.ndarray, " m"], lengths: Float[np.ndarray, "m m"], size: int
) -> tuple[float, Int[np.ndarray, " m"]]:
    """Move a run of points to another place, either way round."""
    D = lengths[np.ix_(path, path)]
    step, count = np.diagonal(D, 1), len(path)
    starts = np.arange(1, count - size)
    ends = starts + size - 1
    left_out = step[starts - 1] + step[ends] - D[starts - 1, ends + 1]
    forward = D[:-1, starts].T + D[1:, ends].T
    backward = D[:-1, ends].T + D[1:, starts].T
    gain = left_out[:, None] + step[None] - np.minimum(forward, backward)
    places = np.arange(count - 1)
    inside = (places[None] >= starts[:, None] - 1) & (places[None] <= ends[:, None])
    gain[inside] = -np.inf
    k, at = np.unravel_index(int(gain.argmax()), gain.shape)
    run = path[starts[k] : ends[k] + 1]
    run = run if forward[k, at] <= backward[k, at] else run[::-1]
    before, after = path[: at + 1], path[at + 1 :]
    if at < starts[k]:
        after = np.concatenate([path[at + 1 : starts[k]], path[ends[k] + 1 :]])
    else:
        before = np.concatenate([path[: starts[k]], path[ends[k] + 1 : at + 1]])
    return float(gain[k, at]), np.concatenate([before, run, after])
