"""Plan free arm motions between two states: a straight line, RRT-Connect or OMPL; round corners.

In RRT-Connect, two trees grow toward samples and toward each other (Kuffner and LaValle, RRT-
Connect, ICRA 2000), always the smaller one (Kuffner and LaValle, Balanced Bidirectional RRT Search,
2005). A node whose extension failed ignores samples that are far from it (Yershova et al., Dynamic-
Domain RRTs, ICRA 2005). Samples are Halton points, which cover the joint ranges more evenly than
random ones. Some are near a node instead: they lead out of a narrow place, where samples of the
whole range are rare (Hsu, Latombe and Motwani, Path Planning in Expansive Configuration Spaces,
1999).

A corner becomes a quintic Bezier curve that leaves and joins the path with its direction and
without curvature, so that the rounded path has continuous curvature. It lies in the triangle of its
corner, and is checked like the path itself: what is free is what the arm executes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from math import comb
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias

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
from momapos.model.collision import (
    ANY_TILT,
    MotionArrays,
    StraightMotions,
    motion_hit,
    motion_scratch,
    place_segments,
    up_of,
)

from .config import Planner, PlannerConfig

if TYPE_CHECKING:
    from jaxtyping import Float


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
LEVEL_REACH = 0.4
"""The largest length where the hand stays upright [rad] or [m]: straight motions between upright
states tilt it by about the square of their length."""
UPRIGHT_STEPS, UPRIGHT_SHARE = 5, 0.5
"""Newton steps toward an upright hand [-], and the share of the allowed 1 - cosine at which they
end, about 0.7 of the angle [-]."""
LEVEL_BUDGET = 0.05
"""Share of the checks for such a path: those that exist took at most 303 of 40,000 checks for a cup
that four robots carry over a counter, and each takes up to ten times as long [-]."""
UPRIGHT_DIFFERENCE, DAMPING = 1e-5, 1e-4
"""Difference of a joint in these steps [rad] or [m], and their damping [-]."""
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
def _set_upright(q, lower, upper, motion, scratch):
    """Turn the joints until the hand is upright; a hand that does not get there stays tilted.

    Newton steps move the horizontal part of the upright direction to zero, as projections onto the
    constraint in Berenson et al., Manipulation Planning on Constraint Manifolds, ICRA 2009.
    """
    n, upright, R, p = len(q), motion.upright, scratch.arm.R, scratch.arm.p
    goal = 1.0 - UPRIGHT_SHARE * (1.0 - upright.cosine)
    for _ in range(UPRIGHT_STEPS):
        place_segments(q, motion.base, motion.chain, R, p)
        x, y, z = up_of(R, upright)
        if z >= goal:
            return
        a, b, c = DAMPING, 0.0, DAMPING
        for k in range(n):
            before = q[k]
            q[k] = before + UPRIGHT_DIFFERENCE
            place_segments(q, motion.base, motion.chain, R, p)
            q[k] = before
            other = up_of(R, upright)
            dx, dy = (other[0] - x) / UPRIGHT_DIFFERENCE, (other[1] - y) / UPRIGHT_DIFFERENCE
            scratch.step[k], scratch.q[k] = dx, dy
            a, b, c = a + dx * dx, b + dx * dy, c + dy * dy
        if z < 0.0:  # upside down: turn as far as for a hand that lies
            size = max(np.hypot(x, y), 1e-6)
            x, y = x / size, y / size
        det = a * c - b * b
        u, v = (c * x - b * y) / det, (a * y - b * x) / det
        for k in range(n):
            there = q[k] - scratch.step[k] * u - scratch.q[k] * v
            q[k] = min(max(there, lower[k]), upper[k])


@kernel
def _grow(tree, q, lower, upper, motion, new, rows, scratch):
    """Extend a tree toward a sample; return the new node, -1 for a collision, -2 if it is far."""
    near, distance = _nearest(tree, q, rows)
    if distance > tree.domain[near]:
        return -2
    level = motion.upright.cosine > ANY_TILT
    reach = LEVEL_REACH if level else REACH
    _between(tree.q[near], q, min(1.0, reach / max(distance, 1e-12)), new)
    if level:
        _set_upright(new, lower, upper, motion, scratch)
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
    if motion.upright.cosine > ANY_TILT:
        _set_upright(new, lower, upper, motion, scratch)
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
def _connect_level(tree, goal, lower, upper, motion, new, rows, checks, scratch):
    """Extend a tree to a configuration, see `_connect`, in steps that keep the hand upright."""
    near, distance = _nearest(tree, goal, rows)
    for i in range(1, checks + 1):
        share = min(1.0, LEVEL_REACH / max(distance, 1e-12))
        _between(tree.q[near], goal, share, new)
        if share < 1.0:
            _set_upright(new, lower, upper, motion, scratch)
            if _length(new, goal) > distance - LEVEL_REACH / 4.0:
                return near, False, i
        if motion_hit(tree.q[near], new, motion, True, scratch):
            return near, False, i
        near, distance = _add(tree, new, near), _length(new, goal)
        if share == 1.0:
            return near, True, i
    return near, False, checks


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
            tip = _grow(one, q, lower, upper, motion, new, rows, scratch)
        if tip == -2:
            continue
        spent += 1
        if tip == -1:
            continue
        goal, left = one.q[tip], checks - spent
        if motion.upright.cosine > ANY_TILT:
            near, met, more = _connect_level(
                other, goal, lower, upper, motion, new, rows, left, scratch
            )
        else:
            near, met, more = _connect(other, goal, motion, new, rows, left, scratch)
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


@entry
def level_states(q: F2, lower: F1, upper: F1, motion: MotionArrays) -> np.ndarray:
    """Return states (k, n) that are turned until the hand is upright, see `_set_upright`.

    Args:
        q: The states (k, n).
        lower, upper: Range of each joint.
        motion: How upright the hand is to be.
    """
    scratch, out = motion_scratch(motion, q.shape[1]), q.copy()
    for i in range(len(out)):
        _set_upright(out[i], lower, upper, motion, scratch)
    return out


CheckMotion: TypeAlias = "Callable[[Float[np.ndarray, ' n'], Float[np.ndarray, ' n']], bool]"
"""Returns whether the straight motion between two configurations is free, including its ends."""


class _Budget:
    """Ends a search after a number of checks; a time limit would make results irreproducible."""

    TURNS_PER_CHECK = 10
    """A search also ends after this many turns per check, since a turn may check nothing [-]."""

    def __init__(self, checks: int) -> None:
        self.checks, self.turns = checks, self.TURNS_PER_CHECK * checks

    def spent(self) -> bool:
        """Count one turn of OMPL, and check whether the search ends."""
        self.turns -= 1
        return min(self.checks, self.turns) < 0


def ompl_path(
    start: Float[np.ndarray, " n"],
    goal: Float[np.ndarray, " n"],
    low: Float[np.ndarray, " n"],
    high: Float[np.ndarray, " n"],
    free: CheckMotion,
    *,
    planner: Planner,
    checks: int,
    step: float,
    seed: int,
    optimize: bool = False,
) -> Float[np.ndarray, "k n"] | None:
    """Find a path between two free configurations.

    Args:
        start, goal: Configurations.
        low, high: Range of each joint, which includes both.
        free: Checks straight motions.
        planner: OMPL's planner.
        checks: Maximum number of motions checked.
        step: Joint step at which motions are checked [rad] or [m].
        seed: Same seed, same path.
        optimize: Whether a planner that shortens its path spends all checks; it ends with its first
            path otherwise.

    Returns:
        Corner states, including start and goal, or None.
    """
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou

    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    ou.RNG.setSeed(seed + 1)  # OMPL seeds from the clock if the seed is 0
    n, budget = len(start), _Budget(checks)
    space = ob.RealVectorStateSpace(n)
    bounds = ob.RealVectorBounds(n)
    for k in range(n):
        bounds.setLow(k, float(low[k]))
        bounds.setHigh(k, float(high[k]) + 1e-9)
    space.setBounds(bounds)
    setup = og.SimpleSetup(space)

    def read(state: object) -> Float[np.ndarray, " n"]:
        return np.array([state[k] for k in range(n)])  # type: ignore[index]

    class Edges(ob.MotionValidator):  # type: ignore[misc]
        """Checks all states of an edge in one call of the kernel."""

        def checkMotion(self, a: object, b: object, *_: object) -> bool:
            budget.checks -= 1
            return free(read(a), read(b))

    def valid(state: object) -> bool:
        q = read(state)
        return free(q, q)

    setup.setStateValidityChecker(valid)
    info = setup.getSpaceInformation()
    edges = Edges(info)
    info.setMotionValidator(edges)
    info.setStateValidityCheckingResolution(step / space.getMaximumExtent())
    ends = [space.allocState(), space.allocState()]
    for state, q in zip(ends, (start, goal), strict=True):
        for k in range(n):
            state[k] = float(q[k])
    setup.setStartAndGoalStates(ends[0], ends[1])
    shortest = ob.PathLengthOptimizationObjective(info)
    if not optimize:
        shortest.setCostThreshold(shortest.infiniteCost())
    setup.setOptimizationObjective(shortest)
    setup.setPlanner(getattr(og, planner)(info))
    solved = setup.solve(ob.PlannerTerminationCondition(lambda: budget.spent()))
    if not solved or "Approximate" in solved.asString():
        return None
    if planner == "RRTConnect":
        budget = _Budget(checks)
        setup.simplifySolution(ob.PlannerTerminationCondition(lambda: budget.spent()))
    path = setup.getSolutionPath()
    return np.array([[path.getState(i)[k] for k in range(n)] for i in range(path.getStateCount())])


CORNER = np.radians(10.0)
"""Smaller turns between two steps are no corners: the arm does not stop at them [rad]."""
MAX_TURN = np.radians(2.0)
"""Mean turn between states of a rounded corner; the largest is up to four times as large [rad]."""
MAX_LENGTH = 1.0
"""Largest length of the path before and after a corner that is replaced [rad] or [m]."""
MIN_LENGTH = 0.01
"""The arm stops at a corner that cannot be rounded over this length [rad] or [m]."""
TRIES = 4
"""Lengths that are tried, each half of the one before [-]."""
HANDLE = 0.3
"""Distance of the curve's control points, as a share of the length that it replaces. At 0.2 the
curve bends most at its ends, at 0.5 in its middle [-]."""
_BERNSTEIN = np.array([comb(5, k) for k in range(6)])


def fill_curve(states: Float[np.ndarray, "m n"], step: float) -> Float[np.ndarray, "k n"]:
    """Add states on the cubic spline through the states of a curve.

    Args:
        states: States of a path without corners, such as one that follows a tool pose.
        step: Largest joint step between the states returned, nearly [rad] or [m].
    """
    largest = np.abs(np.diff(states, axis=0)).max(initial=0.0)
    pieces = int(np.ceil(largest / step - 1e-9))
    if len(states) < 3 or pieces < 2:
        return states
    slope = spline_slopes(states)
    change, share = np.diff(states, axis=0)[:, None], np.arange(pieces)[None, :, None] / pieces
    begin, end = (slope[part, None] for part in (slice(-1), slice(1, None)))
    bend = begin + end - 2.0 * change
    # The cubic of each step that has the values and slopes of its ends.
    inside = begin + share * (change - begin - bend + share * bend)
    filled = (states[:-1, None] + share * inside).reshape(-1, states.shape[1])
    return np.concatenate([filled, states[-1:]])


def spline_slopes(states: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "m n"]:
    """Return the slopes of the not-a-knot cubic spline through evenly spaced values, at these.

    The second derivative is continuous everywhere, and the third at the second value and at the
    last but one. Through three values this is a parabola.

    Source: de Boor, "A Practical Guide to Splines" (1978), chapter IV.

    Args:
        states: At least three values, one step apart.
    """
    change = np.diff(states, axis=0)
    inner = 3.0 * (change[:-1] + change[1:])
    first = 0.5 * (5.0 * change[0] + change[1])  # slope of the first value + 2 * of the second
    last = 0.5 * (change[-2] + 5.0 * change[-1])
    inner[0], inner[-1] = inner[0] - first, inner[-1] - last
    size = len(inner)
    if size == 1:
        middle = 0.5 * (change[:1] + change[1:])
    else:
        matrix = 4.0 * np.eye(size) + np.eye(size, k=1) + np.eye(size, k=-1)
        matrix[0, 0] = matrix[-1, -1] = 2.0
        middle = np.asarray(np.linalg.solve(matrix, inner), float)
    return np.concatenate([[first - 2.0 * middle[0]], middle, [last - 2.0 * middle[-1]]])


def round_corners(
    states: Float[np.ndarray, "m n"], free: StraightMotions, step: float
) -> Float[np.ndarray, "k n"]:
    """Replace the corners of a path by curves that are free; corners without one remain.

    Args:
        states: States of the path, close together.
        free: The check of straight motions.
        step: Largest joint step between states of a curve [rad] or [m].

    Returns:
        The states between the curves, and states of the curves.
    """
    moved = np.append(True, np.abs(np.diff(states, axis=0)).max(1, initial=0.0) > 1e-9)
    q = states[moved]
    lengths = np.linalg.norm(np.diff(q, axis=0), axis=1)
    along = np.append(0.0, np.cumsum(lengths))
    directions = np.diff(q, axis=0) / lengths[:, None]
    cosine = np.einsum("ij,ij->i", directions[:-1], directions[1:])
    corners = np.flatnonzero(cosine < np.cos(CORNER)) + 1
    ends = np.concatenate([along[:1], along[corners], along[-1:]])
    parts, kept = [], 0
    for corner, before, after in zip(
        corners.tolist(), *(np.diff(ends)[i:][: len(corners)] for i in (0, 1)), strict=True
    ):
        longest = min(before / 2, after / 2, MAX_LENGTH)
        angle = float(np.arccos(np.clip(cosine[corner - 1], -1.0, 1.0)))
        for length in longest * 0.5 ** np.arange(TRIES):
            if length < MIN_LENGTH:
                break
            curve = _curve(q, along, directions, along[corner], length, step, angle)
            if free.along(curve):
                first = int(np.searchsorted(along, along[corner] - length - 1e-9))
                parts += [q[kept:first], curve]
                kept = int(np.searchsorted(along, along[corner] + length + 1e-9))
                break
    return np.concatenate([*parts, q[kept:]])


def _curve(
    q: Float[np.ndarray, "m n"],
    along: Float[np.ndarray, " m"],
    directions: Float[np.ndarray, "l n"],
    corner: float,
    length: float,
    step: float,
    angle: float,
) -> Float[np.ndarray, "k n"]:
    """Return states of the curve that replaces a corner.

    Args:
        q: States of the path.
        along: Position of each state along the path.
        directions: Unit direction from each state to the next.
        corner: Position of the corner.
        length: Length of the path before and after the corner that is replaced.
        step: Largest joint step [rad] or [m].
        angle: Angle of the corner [rad].
    """
    ends = np.array([corner - length, corner + length])
    # The segment that contains each end; at the corner's side if the end is a state.
    at = np.array(
        [np.searchsorted(along, ends[0] + 1e-9) - 1, np.searchsorted(along, ends[1] - 1e-9) - 1]
    )
    points = q[at] + (ends - along[at])[:, None] * directions[at]
    out = HANDLE * length * np.arange(3)[:, None]
    control = np.concatenate([
        points[0] + out * directions[at[0]], (points[1] - out * directions[at[1]])[::-1]
    ])  # fmt: skip
    count = int(np.ceil(max(2.0 * length / step, angle / MAX_TURN, 4.0)))
    t = np.linspace(0.0, 1.0, count + 1)[:, None]
    k = np.arange(6)
    return np.asarray((_BERNSTEIN * t**k * (1.0 - t) ** (5 - k)) @ control)


RESOLUTION = 0.04
"""Largest joint step at which a motion is checked [rad] or [m]."""
PREFERRED_CLEARANCE = 0.005
"""Preferred clearance of a free motion to everything, including the robot itself: an arm deviates
from its path by millimeters, and between the checked states it may come closer [m]."""
BRIEF_SHARE = 0.25
"""Share of the checks for a path between two grasps or home; most are easy or infeasible [-]."""
QUICK_SHARE = 0.005
"""Share for a path that is searched again, with more checks, if nothing else is found [-]: of 75
ways between two grasps at a door, the six that exist take less, and 69 have none even with 30 times
as many as `BRIEF_SHARE`."""
BETWEEN_SHARE = 0.05
"""Share for a path between two poses of a set, which may also lead by home [-]."""
_MIN_BEYOND = np.pi / 4
"""Least range beyond the ends in which a joint without limits is sampled, where a whole turn that
contains both is no wider [rad]."""


def brief_config(config: PlannerConfig) -> PlannerConfig:
    """Limit the planner for a path between two grasps or home, see `BRIEF_SHARE`."""
    return replace(config, checks=max(1, round(BRIEF_SHARE * config.budget)))


def between_config(config: PlannerConfig) -> PlannerConfig:
    """Limit the planner for a path between two poses, see `BETWEEN_SHARE`."""
    return replace(config, checks=max(1, round(BETWEEN_SHARE * config.budget)))


def quick_config(config: PlannerConfig) -> PlannerConfig:
    """Limit the planner for a path that is searched again, see `QUICK_SHARE`."""
    return replace(config, checks=max(1, round(QUICK_SHARE * config.budget)))


@dataclass(frozen=True, eq=False)
class FreePath:
    """A free path between two configurations."""

    corners: Float[np.ndarray, "k n"]
    """States with straight motions between them, including both ends."""
    free: StraightMotions
    """The check that the path passes."""

    def states(self, then: Float[np.ndarray, "m n"] | None = None) -> Float[np.ndarray, "s n"]:
        """Return close states of the path with rounded corners.

        Args:
            then: States that follow the last one, whose corner with the path is rounded as well.
        """
        states = interpolate(self.corners)
        if then is not None:
            states = np.concatenate([states, then])
        return round_corners(states, self.free, RESOLUTION)


class MotionCheckerFactory(Protocol):
    """Builds checks of motions."""

    def __call__(self, *, extra_clearance: float, fine: bool) -> StraightMotions:
        """Return the check for a clearance [m], see `build_motions`."""
        ...


def interpolate(
    path: Float[np.ndarray, "k n"], step: float = RESOLUTION
) -> Float[np.ndarray, "m n"]:
    """Add states to a path so that no joint moves more than `step` between them."""
    pieces = [path[:1]]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.abs(b - a).max() / step - 1e-9)))
        pieces.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(pieces)


def plan_motion(
    start: Float[np.ndarray, " n"],
    goal: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    free: StraightMotions,
    *,
    config: PlannerConfig,
    seed: int,
) -> Float[np.ndarray, "k n"] | None:
    """Find a free path between two configurations.

    Args:
        start, goal: Configurations; joints without limits are not wrapped.
        lower, upper: Joint limits; infinite if there are none.
        free: Checks straight motions, at `RESOLUTION` or finer. Between the checked states a motion
            may graze an obstacle.
        config: The planner and its maximum number of checks.
        seed: Same seed, same path.

    Returns:
        Corner states, including start and goal, or None.
    """
    if not (free(start, start) and free(goal, goal)):
        return None
    if free(start, goal):
        return np.stack([start, goal])
    beyond = np.maximum(np.pi - np.abs(goal - start) / 2, _MIN_BEYOND)
    low = np.where(np.isfinite(lower), lower, np.minimum(start, goal) - beyond)
    high = np.where(np.isfinite(upper), upper, np.maximum(start, goal) + beyond)
    ends = np.clip(start, low, high), np.clip(goal, low, high)
    if config.planner is None:
        level = free.arrays.upright.cosine > ANY_TILT
        checks = max(1, round(LEVEL_BUDGET * config.budget)) if level else config.budget
        path, _ = connect(*ends, low, high, free.arrays, checks, seed)
    else:
        path = ompl_path(
            *ends, low, high, free, planner=config.planner, checks=config.budget, step=RESOLUTION,
            seed=seed, optimize=config.optimize,
        )  # fmt: skip
    if path is None or not len(path):
        return None
    return np.concatenate([start[None], path[1:-1], goal[None]])


def plan_with_clearance(
    start: Float[np.ndarray, " n"],
    goal: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    checker: MotionCheckerFactory,
    *,
    config: PlannerConfig,
    seed: int,
) -> FreePath | None:
    """Find a path with `PREFERRED_CLEARANCE`, or else a free one past obstacles, see `plan_motion`.

    Spheres judge the clearance. Where they leave no path, hulls decide what is free.
    """
    for clearance, fine in ((PREFERRED_CLEARANCE, False), (0.0, True)):
        free = checker(extra_clearance=clearance, fine=fine)
        path = plan_motion(start, goal, lower, upper, free, config=config, seed=seed)
        if path is not None:
            return FreePath(path, free)
    return None
