"""Plan free arm motions in one kernel: RRT-Connect, then shortcuts and rounded corners.

Source: Kuffner and LaValle, RRT-Connect: An Efficient Approach to Single-Query Path Planning (ICRA
2000); the smaller tree grows, as in Kuffner and LaValle, An Efficient Approach to Path Planning
Using Balanced Bidirectional RRT Search (2005).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from momapos.core.compiled import LANES, F1, F2, I1, S2, entry, kernel, less, load, spread, store
from momapos.model.collision import MotionArrays, motion_hit, motion_scratch

class SearchRule(NamedTuple):
    """Parameters of the search."""

    reach: float
    """Largest length of a motion that is added to a tree [rad]."""
    checks: int
    """Maximum number of motions checked [-]."""
    shortcuts: int
    """Shortcuts tried [-]."""
    seed: int
    domain: float
    alpha: float
    least: float


class Tree(NamedTuple):
    """A tree of configurations."""

    q: F2
    parent: I1
    radius: F1
    """Samples farther from a node than this do not extend it."""
    columns: S2
    values: S2
    size: I1
    """(1,): number of nodes."""


@kernel
def _tree(root, capacity, reach):
    q = np.empty((capacity, len(root)))
    q[0] = root
    parent = np.empty(capacity, np.int64)
    parent[0] = -1
    radius = np.empty(capacity)
    radius[0] = reach
    columns = np.empty(((capacity // LANES + 1) * len(root), LANES), np.float32)
    for k in range(len(root)):
        columns[k, 0] = root[k]
    values = np.empty((len(root) + 1, LANES), np.float32)
    return Tree(q, parent, radius, columns, values, np.ones(1, np.int64))


@kernel
def _add(tree, q, parent, radius):
    n = tree.size[0]
    for k in range(len(q)):
        tree.q[n, k] = q[k]
        tree.columns[n // LANES * len(q) + k, n % LANES] = q[k]
    tree.parent[n] = parent
    tree.radius[n] = radius
    tree.size[0] = n + 1
    return n


@kernel
def _nearest(tree, q):
    """Return the nearest node and its distance."""
    best, least, size = 0, np.inf, tree.size[0]
    joints, values = len(q), tree.values
    for k in range(joints):
        store(values, k, spread(q[k]))
    for block in range((size + LANES - 1) // LANES):
        row, d = block * joints, spread(0.0)
        for k in range(joints):
            x = load(tree.columns, row + k) - load(values, k)
            d = d + x * x
        if less(d, spread(least)) == 0:
            continue
        store(values, joints, d)
        for lane in range(min(LANES, size - block * LANES)):
            if values[joints, lane] < least:
                best, least = block * LANES + lane, values[joints, lane]
    return best, np.sqrt(least)


@kernel
def _random(state):
    """Return the next uniform number in [0, 1): SplitMix64 (Steele, Lea and Flood 2014)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) / 9007199254740992.0


PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37)


@kernel
def _van_der_corput(i, base):
    out, f = 0.0, 1.0
    while i > 0:
        f /= base
        out += f * (i % base)
        i //= base
    return out


@kernel
def _toward(a, b, share, out):
    for k in range(len(out)):
        out[k] = a[k] + (b[k] - a[k]) * share


@kernel
def _search(start, goal, lower, upper, motion, rule, scratch, random):
    """Return both trees, the node of each at which they meet, or -1, and the checks spent."""
    capacity = rule.checks + 3
    one, other = _tree(start, capacity, np.inf), _tree(goal, capacity, np.inf)
    from_start, spent, turns, number = True, 0, 0, rule.seed
    q, new = np.empty(len(start)), np.empty(len(start))
    while spent < rule.checks:
        if one.size[0] > other.size[0]:
            one, other, from_start = other, one, not from_start
        number += 1
        for k in range(len(q)):
            q[k] = lower[k] + (upper[k] - lower[k]) * _van_der_corput(number, PRIMES[k])
        near, distance = _nearest(one, q)
        turns += 1
        if turns > 20 * rule.checks:
            break
        if distance > one.radius[near]:
            continue
        _toward(one.q[near], q, min(1.0, rule.reach / max(distance, 1e-12)), new)
        spent += 1
        if motion_hit(one.q[near], new, motion, True, scratch):
            if one.radius[near] == np.inf:
                one.radius[near] = rule.domain
            else:
                one.radius[near] = max(one.radius[near] * (1.0 - rule.alpha), rule.least)
            continue
        if one.radius[near] < np.inf:
            one.radius[near] *= 1.0 + rule.alpha
        tip = _add(one, new, near, np.inf)
        near, distance = _nearest(other, one.q[tip])
        steps = int(np.ceil(distance / rule.reach))
        origin, met = near, True
        for i in range(1, steps + 1):
            if spent >= rule.checks:
                met = False
                break
            _toward(other.q[origin], one.q[tip], i / steps, new)
            spent += 1
            if motion_hit(other.q[near], new, motion, True, scratch):
                met = False
                break
            near = _add(other, new, near, np.inf)
        if met:
            if from_start:
                return one, other, tip, near, spent
            return other, one, near, tip, spent
    return one, other, -1, -1, spent


@kernel
def _joined(one, other, tip, near):
    """Return the path through two trees that meet."""
    count, i = 0, tip
    while i >= 0:
        count, i = count + 1, one.parent[i]
    first, i = count, other.parent[near]
    while i >= 0:
        count, i = count + 1, other.parent[i]
    path, at, i = np.empty((count, one.q.shape[1])), first - 1, tip
    while i >= 0:
        path[at] = one.q[i]
        at, i = at - 1, one.parent[i]
    at, i = first, other.parent[near]
    while i >= 0:
        path[at] = other.q[i]
        at, i = at + 1, other.parent[i]
    return path


@kernel
def _skip_corners(path, count, motion, scratch):
    """Remove corners between which the straight motion is free; return how many remain."""
    i = 0
    while i < count - 2:
        for j in range(count - 1, i + 1, -1):
            if j == i + 1:
                break
            if not motion_hit(path[i], path[j], motion, True, scratch):
                drop = j - i - 1
                for k in range(j, count):
                    path[k - drop] = path[k]
                count -= drop
                break
        i += 1
    return count


@kernel
def _length(a, b):
    d = 0.0
    for k in range(len(a)):
        d += (b[k] - a[k]) ** 2
    return np.sqrt(d)


@kernel
def _point_at(path, count, along, out):
    """Write the point at a distance along the path; return the corner before it."""
    i = 0
    while i < count - 2 and along > _length(path[i], path[i + 1]):
        along -= _length(path[i], path[i + 1])
        i += 1
    whole = _length(path[i], path[i + 1])
    _toward(path[i], path[i + 1], min(1.0, along / max(whole, 1e-12)), out)
    return i


@kernel
def _shortcut(path, count, motion, rule, scratch, random):
    """Try shortcuts between random points of a path; return the number of corners."""
    n = path.shape[1]
    a, b = np.empty(n), np.empty(n)
    for _ in range(rule.shortcuts):
        if count < 3:
            break
        whole = 0.0
        for i in range(count - 1):
            whole += _length(path[i], path[i + 1])
        x, y = whole * _random(random), whole * _random(random)
        i = _point_at(path, count, min(x, y), a)
        j = _point_at(path, count, max(x, y), b)
        if i == j or motion_hit(a, b, motion, True, scratch):
            continue
        # The corners between are replaced by two.
        shift = 2 - (j - i)
        if count + shift > len(path):
            continue
        if shift > 0:
            for k in range(count - 1, j, -1):
                path[k + shift] = path[k]
        elif shift < 0:
            for k in range(j + 1, count):
                path[k + shift] = path[k]
        path[i + 1], path[i + 2] = a, b
        count += shift
    return count


@entry
def connect(
    start: F1, goal: F1, lower: F1, upper: F1, motion: MotionArrays, rule: SearchRule
) -> tuple[np.ndarray, int]:
    """Find a path between two free configurations whose straight connection is not free.

    Args:
        start, goal: Configurations (n,).
        lower, upper: Range of each joint.
        motion: The check of straight motions.
        rule: Parameters.

    Returns:
        Corner states (k, n) including both ends, none if no path is found, and the number of
        motions checked by the search.
    """
    scratch = motion_scratch(motion, len(start))
    random = np.array([np.uint64(rule.seed)])
    one, other, tip, near, spent = _search(
        start, goal, lower, upper, motion, rule, scratch, random
    )
    if tip < 0:
        return np.empty((0, len(start))), spent
    found = _joined(one, other, tip, near)
    path = np.empty((len(found) + 2 * rule.shortcuts, len(start)))
    path[: len(found)] = found
    count = _skip_corners(path, len(found), motion, scratch)
    count = _shortcut(path, count, motion, rule, scratch, random)
    count = _skip_corners(path, count, motion, scratch)
    return path[:count].copy(), spent
