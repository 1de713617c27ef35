"""Plan free arm motions in one kernel: RRT-Connect, then shortcuts.

Two trees grow toward samples and toward each other (Kuffner and LaValle, RRT-Connect, ICRA 2000),
always the smaller one (Kuffner and LaValle, Balanced Bidirectional RRT Search, 2005). A node whose
extension failed ignores samples that are far from it (Yershova et al., Dynamic-Domain RRTs, ICRA
2005). Samples are Halton points, which cover the joint ranges more evenly than random ones. Some
are near a node instead: they lead out of a narrow place, where samples of the whole range are rare
(Hsu, Latombe and Motwani, Path Planning in Expansive Configuration Spaces, 1999).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from momapos.core.compiled import (
    F1,
    F2,
    I1,
    LANES,
    S2,
    entry,
    kernel,
    less,
    load_lanes,
    spread,
    store_lanes,
)
from momapos.model.collision import MotionArrays, motion_hit, motion_scratch

REACH = 1.0
"""Largest length of a motion that is added to a tree [rad] or [m]. Of the Fetch's problems of
MotionBenchMaker, 0.5 solves as many in half as much time again, and 1.5 or more fewer."""
DOMAIN, MIN_DOMAIN, DOMAIN_CHANGE = 4.0, 1.0, 1e-4
"""Radius within which a node takes samples after its first failure, its least value, and its
relative change with each further failure or success [rad]: the defaults of VAMP (Thomason et al.,
Motions in Microseconds via Vectorized Sampling-Based Planning, ICRA 2024)."""
LOCAL, NEARBY = 25, 0.7
"""Every how many samples one is near a node, and the largest difference of a joint from it [rad] or
[m]. Of the Fetch's problems of MotionBenchMaker, 95 % of the solved ones then take 72 ms instead of
180; every 10th, or 0.3, solve as many, and every 2nd takes half as much time again."""
SAMPLES_PER_CHECK = 20
"""The search also ends after this many samples per check, since a sample may check nothing [-]."""
SHORTCUTS = 60
"""Number of shortcuts tried: with 30 paths are 10 % longer, with 100 they are 5 % shorter [-]."""
SKIPPED = 100
"""Halton points that are skipped for each seed; the first ones are alike in high dimensions [-]."""
PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53)
"""Bases of the Halton points; joints beyond these share them."""


class _Tree(NamedTuple):
    """A tree of configurations."""

    q: F2
    """(capacity, n)"""
    blocks: S2
    """The same in blocks of eight nodes: rows k * n to k * n + n - 1."""
    parent: I1
    domain: F1
    """Samples farther from a node than this do not extend it."""
    size: I1
    """(1,): number of nodes."""


@kernel
def _tree(root, capacity):
    """Return a tree with one node."""
    n = len(root)
    tree = _Tree(
        np.empty((capacity, n)),
        np.empty(((capacity // LANES + 1) * n, LANES), np.float32),
        np.empty(capacity, np.int64),
        np.empty(capacity),
        np.zeros(1, np.int64),
    )
    _add(tree, root, -1)
    return tree


@kernel
def _add(tree, q, parent):
    """Add a node; return its index."""
    i = tree.size[0]
    for k in range(len(q)):
        tree.q[i, k] = q[k]
        tree.blocks[i // LANES * len(q) + k, i % LANES] = q[k]
    tree.parent[i], tree.domain[i] = parent, np.inf
    tree.size[0] = i + 1
    return i


@kernel
def _nearest(tree, q, rows):
    """Return the nearest node and its distance; rows (n + 1, 8) are scratch memory."""
    best, least, size, n = 0, np.inf, tree.size[0], len(q)
    for k in range(n):
        store_lanes(rows, k, spread(q[k]))
    for block in range((size + LANES - 1) // LANES):
        square = spread(0.0)
        for k in range(n):
            d = load_lanes(tree.blocks, block * n + k) - load_lanes(rows, k)
            square = square + d * d
        if less(square, spread(least)) == 0:
            continue
        store_lanes(rows, n, square)
        for lane in range(min(LANES, size - block * LANES)):
            if rows[n, lane] < least:
                best, least = block * LANES + lane, float(rows[n, lane])
    return best, np.sqrt(least)


@kernel
def _halton(i, base):
    """Return coordinate i of the van der Corput sequence."""
    out, digit = 0.0, 1.0
    while i > 0:
        digit /= base
        out += digit * (i % base)
        i //= base
    return out


@kernel
def _between(a, b, share, out):
    for k in range(len(out)):
        out[k] = a[k] + (b[k] - a[k]) * share


@kernel
def _length(a, b):
    square = 0.0
    for k in range(len(a)):
        square += (b[k] - a[k]) ** 2
    return np.sqrt(square)


@kernel
def _grow(tree, q, motion, new, rows, scratch):
    """Extend a tree toward a sample; return the new node, -1 for a collision, -2 if it is far."""
    near, distance = _nearest(tree, q, rows)
    if distance > tree.domain[near]:
        return -2
    _between(tree.q[near], q, min(1.0, REACH / max(distance, 1e-12)), new)
    domain = tree.domain[near]
    if motion_hit(tree.q[near], new, motion, True, scratch):
        less_far = max(domain * (1.0 - DOMAIN_CHANGE), MIN_DOMAIN)
        tree.domain[near] = DOMAIN if domain == np.inf else less_far
        return -1
    tree.domain[near] = domain * (1.0 + DOMAIN_CHANGE)
    return _add(tree, new, near)


@kernel
def _wander(tree, number, lower, upper, motion, new, scratch):
    """Extend a node to a sample near it; return the new node, or -1 for a collision."""
    n = len(new)
    near = int(_halton(number, PRIMES[n % len(PRIMES)]) * tree.size[0])
    reach = NEARBY * _halton(number, PRIMES[(n + 1) % len(PRIMES)])
    for k in range(n):
        share = _halton(number, PRIMES[k % len(PRIMES)])
        there = tree.q[near, k] + reach * (2.0 * share - 1.0)
        new[k] = min(max(there, lower[k]), upper[k])
    if motion_hit(tree.q[near], new, motion, True, scratch):
        return -1
    return _add(tree, new, near)


@kernel
def _connect(tree, goal, motion, new, rows, checks, scratch):
    """Extend a tree to a configuration; return the last node, whether it is there, and checks."""
    near, distance = _nearest(tree, goal, rows)
    origin, steps = near, max(int(np.ceil(distance / REACH)), 1)
    for i in range(1, steps + 1):
        _between(tree.q[origin], goal, i / steps, new)
        if i > checks or motion_hit(tree.q[near], new, motion, True, scratch):
            return near, False, i
        near = _add(tree, new, near)
    return near, True, steps


@kernel
def _search(start, goal, lower, upper, motion, checks, seed, scratch):
    """Grow trees from both ends; return the path, empty without one, and the checks spent."""
    n, capacity = len(start), checks + 2
    one, other = _tree(start, capacity), _tree(goal, capacity)
    q, new, rows = np.empty(n), np.empty(n), np.empty((n + 1, LANES), np.float32)
    forward, spent = True, 0
    first = SKIPPED + seed * SKIPPED
    for number in range(first, first + SAMPLES_PER_CHECK * checks):
        if spent >= checks:
            break
        if one.size[0] > other.size[0]:
            one, other, forward = other, one, not forward
        if number % LOCAL == 0:
            tip = _wander(one, number // LOCAL, lower, upper, motion, new, scratch)
        else:
            for k in range(n):
                share = _halton(number, PRIMES[k % len(PRIMES)])
                q[k] = lower[k] + (upper[k] - lower[k]) * share
            tip = _grow(one, q, motion, new, rows, scratch)
        if tip == -2:
            continue
        spent += 1
        if tip == -1:
            continue
        near, met, more = _connect(other, one.q[tip], motion, new, rows, checks - spent, scratch)
        spent += more
        if met:
            if forward:
                return _joined(one, tip, other, near), spent
            return _joined(other, near, one, tip), spent
    return np.empty((0, n)), spent


@kernel
def _joined(one, tip, other, near):
    """Return the path through two trees whose nodes `tip` and `near` are the same state."""
    before, i = 0, tip
    while i >= 0:
        before, i = before + 1, one.parent[i]
    after, i = 0, other.parent[near]
    while i >= 0:
        after, i = after + 1, other.parent[i]
    path, at, i = np.empty((before + after, one.q.shape[1])), before - 1, tip
    while i >= 0:
        path[at], at, i = one.q[i], at - 1, one.parent[i]
    at, i = before, other.parent[near]
    while i >= 0:
        path[at], at, i = other.q[i], at + 1, other.parent[i]
    return path


@kernel
def _skip_corners(path, count, motion, scratch):
    """Remove corners between which the straight motion is free; return how many remain."""
    i = 0
    while i < count - 2:
        for j in range(count - 1, i + 1, -1):
            if not motion_hit(path[i], path[j], motion, True, scratch):
                for k in range(j, count):
                    path[k - j + i + 1] = path[k]
                count -= j - i - 1
                break
        i += 1
    return count


@kernel
def _point_at(path, count, along, out):
    """Write the point at a distance along a path; return the corner before it."""
    i = 0
    while i < count - 2 and along > _length(path[i], path[i + 1]):
        along -= _length(path[i], path[i + 1])
        i += 1
    whole = max(_length(path[i], path[i + 1]), 1e-12)
    _between(path[i], path[i + 1], min(1.0, along / whole), out)
    return i


@kernel
def _cut_corners(path, count, motion, seed, scratch):
    """Replace corners by straight motions between points of a path; return how many remain."""
    n = path.shape[1]
    a, b = np.empty(n), np.empty(n)
    for number in range(SHORTCUTS):
        whole = 0.0
        for i in range(count - 1):
            whole += _length(path[i], path[i + 1])
        x, y = whole * _halton(number + seed + 1, 2), whole * _halton(number + seed + 1, 3)
        i, j = _point_at(path, count, min(x, y), a), _point_at(path, count, max(x, y), b)
        if i == j or motion_hit(a, b, motion, True, scratch):
            continue
        # Corners i + 1 to j become the two points.
        shift = 2 - (j - i)
        if shift > 0:
            path[count] = path[count - 1]
            for k in range(count - 1, j + 1, -1):
                path[k] = path[k - 1]
        elif shift < 0:
            for k in range(j + 1, count):
                path[k + shift] = path[k]
        path[i + 1], path[i + 2] = a, b
        count += shift
    return count


@entry
def connect(
    start: F1, goal: F1, lower: F1, upper: F1, motion: MotionArrays, checks: int, seed: int
) -> tuple[np.ndarray, int]:
    """Find a path between two free configurations.

    Args:
        start, goal: Configurations (n,).
        lower, upper: Range of each joint, which includes both.
        motion: The check of straight motions.
        checks: Maximum number of motions that the search checks.
        seed: Same seed, same path.

    Returns:
        Corner states (k, n) including both ends, none if no path is found, and the number of
        motions that the search checked.
    """
    scratch = motion_scratch(motion, len(start))
    found, spent = _search(start, goal, lower, upper, motion, checks, seed, scratch)
    path = np.empty((len(found) + SHORTCUTS, len(start)))
    path[: len(found)] = found
    count = _skip_corners(path, len(found), motion, scratch)
    if count > 2:
        count = _cut_corners(path, count, motion, seed, scratch)
        count = _skip_corners(path, count, motion, scratch)
    return path[:count].copy(), spent
