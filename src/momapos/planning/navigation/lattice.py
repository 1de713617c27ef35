"""Cheapest paths over cells and headings (A*), and the moves of each kind of drive."""

from __future__ import annotations

import heapq
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core.compiled import B1, B2, F1, F2, I1, I2, S3, entry, kernel
from momapos.core.geometry import wrap_angle
from momapos.model.robots import Robot

from .cost_map import CELL
from .footprint_map import HEADINGS, MOVES
from .outline_gaps import (
    CostWeights,
    OutlineArrays,
    connect,
    gap,
    leg,
    scratch_for,
    select,
    wrapped,
)
from .reeds_shepp import MAX_PIECES, bend_cost, connect_car

if TYPE_CHECKING:
    from jaxtyping import Bool, Int


MAX_EXPANDED = 5_000
"""States of the lattice expanded between two looks at the clock; they take up to 0.1 s [-]."""


class PathModel(NamedTuple):
    """The robot, the obstacles and the cost of paths."""

    omni: bool
    """Whether the base can move sideways."""
    turning_radius: float
    """Turning radius of the paths of a car-like base [m]; 0 for one that turns on the spot."""
    surroundings: OutlineArrays
    cost_weights: CostWeights


class Moves(NamedTuple):
    """The moves from a state, by heading and move; see `lattice_moves`."""

    heading: I2
    """Index of the heading after the move."""
    columns: I2
    rows: I2
    """Cells that it moves by."""
    length: F2
    """Length of its path [m]."""
    factor: F1
    """Cost of a meter of each move [-]."""


class Lattice(NamedTuple):
    """The states of the search: cells of the floor, with headings."""

    origin: F1
    """World position of the corner of cell (0, 0) [m]."""
    cell: float
    """Edge of a cell [m]."""
    headings: F1
    """[rad]"""
    moves: Moves
    farthest: float
    """Upper bound of gaps [m]."""


@entry
def connections(a: F2, b: F2, model: PathModel) -> tuple[np.ndarray, np.ndarray]:
    """Compute the cost of the simple path between pairs of poses (n, 3), and if it is backwards."""
    scratch = scratch_for(model.surroundings)
    cost, backwards = np.empty(len(a)), np.empty(len(a), np.bool_)
    for k in range(len(a)):
        cost[k], backwards[k] = _connect(a[k], b[k], model, model.cost_weights, np.inf, scratch)
    return cost, backwards


@kernel
def _connect(a, b, model, weights, limit, scratch):
    """Find the cheapest simple path of any base between two poses, see `connect`."""
    surroundings, radius = model.surroundings, model.turning_radius
    if radius > 0:
        return connect_car(a, b, radius, surroundings, weights, limit, scratch)[0], False
    return connect(a, b, model.omni, surroundings, weights, limit, scratch)


@entry
def car_curves(a: F2, b: F2, model: PathModel) -> np.ndarray:
    """Return the pieces of the cheapest curves between pairs of poses (n, 3) of a car-like base.

    Returns:
        Signed length [m] and curvature [1/m] of each piece (n, `MAX_PIECES`, 2); zeros where no
        curve is free.
    """
    scratch, weights = scratch_for(model.surroundings), model.cost_weights
    out = np.zeros((len(a), MAX_PIECES, 2))
    for k in range(len(a)):
        cost, curve = connect_car(
            a[k], b[k], model.turning_radius, model.surroundings, weights, np.inf, scratch
        )
        if np.isfinite(cost):
            for piece in range(MAX_PIECES):
                out[k, piece, 0], out[k, piece, 1] = curve[piece, 0], curve[piece, 1]
    return out


@entry
def standable(inside: B2, lattice: Lattice, model: PathModel) -> np.ndarray:
    """Find the cells on the floor in which the base fits with some heading (rows, columns)."""
    surroundings, need = model.surroundings, model.cost_weights.needed_clearance
    prisms, obstacles = surroundings.prisms, surroundings.obstacles
    origin, cell = lattice.origin, lattice.cell
    # The base collides wherever the inscribed circle of a prism does.
    inner = np.empty(len(prisms.first) - 1)
    for layer in range(len(inner)):
        inner[layer] = np.inf
        for e in range(prisms.first[layer], prisms.first[layer + 1]):
            inner[layer] = min(inner[layer], prisms.level[e])
    scratch = scratch_for(surroundings)
    out = np.zeros(inside.shape, np.bool_)
    for i in range(inside.shape[0]):
        for j in range(inside.shape[1]):
            if not inside[i, j]:
                continue
            x, y = origin[0] + (j + 0.5) * cell, origin[1] + (i + 0.5) * cell
            count = select(x, y, prisms.radius + need, obstacles.bounds, scratch.near)
            blocked = False
            for o in scratch.near[:count]:
                circle = inner[obstacles.layer[o]]
                if circle > 0 and _within(x, y, circle + need, obstacles, o):
                    blocked = True
                    break
            if blocked:
                continue
            for yaw in lattice.headings:
                if gap(x, y, yaw, surroundings, count, need, scratch) >= need:
                    out[i, j] = True
                    break
    return out


@kernel
def _within(x, y, distance, obstacles, o):
    """Check whether a point is closer to a convex polygon than a distance."""
    corner, first, last = obstacles.corner, obstacles.first[o], obstacles.first[o + 1]
    outside = False
    for e in range(first, last):
        beyond = obstacles.normal[e, 0] * x + obstacles.normal[e, 1] * y - obstacles.level[e]
        if beyond >= distance:
            return False
        outside = outside or beyond > 0
    if not outside:
        return True
    for e in range(first, last):
        f = e + 1 if e + 1 < last else first
        ax, ay = x - corner[e, 0], y - corner[e, 1]
        bx, by = corner[f, 0] - corner[e, 0], corner[f, 1] - corner[e, 1]
        share = min(1.0, max(0.0, (ax * bx + ay * by) / max(bx * bx + by * by, 1e-18)))
        dx, dy = ax - share * bx, ay - share * by
        if dx * dx + dy * dy < distance * distance:
            return True
    return False


@kernel
def _gap_at(h, i, j, known, lattice, surroundings, scratch):
    """Return the gap at a state [m], computed on first use."""
    if np.isnan(known[h, i, j]):
        x = lattice.origin[0] + (j + 0.5) * lattice.cell
        y = lattice.origin[1] + (i + 0.5) * lattice.cell
        reach, bounds = surroundings.prisms.radius + lattice.farthest, surroundings.obstacles.bounds
        count = select(x, y, reach, bounds, scratch.near)
        known[h, i, j] = gap(
            x, y, lattice.headings[h], surroundings, count, lattice.farthest, scratch
        )
    return known[h, i, j]


def astar(
    known: S3, ahead: F2, first: F1, last: F1, lattice: Lattice, model: PathModel
) -> tuple[Int[np.ndarray, " k"], Bool[np.ndarray, " s"]]:
    """Find the cheapest path over the lattice (Hart, Nilsson, Raphael 1968).

    Args:
        known: Gap at every state (headings, rows, columns) [m]; NaN until its first use.
        ahead: Lower bound of the cost from every cell to the goal (rows, columns) [m].
        first: Cost from the start to every state connected to it, infinite elsewhere, flat.
        last: Cost from every state to the goal, likewise.
        lattice, model: The states, and the data of the search.

    Returns:
        Flat indices of the path's states from start to goal, empty without a path; and whether each
        state was expanded: without a path, all that can be reached.
    """
    cost, parent = first.copy(), np.full(first.size, -1, np.int64)
    done, best = np.zeros(first.size, np.bool_), np.array([np.inf, -1.0])
    while _expand(known, ahead, last, lattice, model, cost, parent, done, best):
        pass
    path = [int(best[1])]
    while path[-1] >= 0:
        path.append(int(parent[path[-1]]))
    return np.array(path[:-1][::-1], np.int64), done


@entry
def _expand(
    known: S3, ahead: F2, last: F1, lattice: Lattice, model: PathModel,
    cost: F1, parent: I1, done: B1, found: F1,
) -> bool:  # fmt: skip
    """Continue a search with at most `MAX_EXPANDED` states; return whether it is not at its end.

    Args:
        known, ahead, last, lattice, model: See `astar`.
        cost: Least known cost from the start to each state, changed.
        parent: The state before it, changed.
        done: Whether a state was expanded, changed.
        found: Cost of the best path so far, and its last state, changed.
    """
    origin, cell, headings, moves = lattice.origin, lattice.cell, lattice.headings, lattice.moves
    surroundings, weights = model.surroundings, model.cost_weights
    radius = surroundings.prisms.radius
    rows, columns = known.shape[1:]
    area = rows * columns
    scratch = scratch_for(surroundings)
    queue = [(np.inf, np.int64(-1))]
    for attached in range(cost.size):
        bound = ahead[(attached % area) // columns, attached % columns]
        if not done[attached] and np.isfinite(cost[attached]) and np.isfinite(bound):
            heapq.heappush(queue, (cost[attached] + bound, np.int64(attached)))
    best = found[0]
    a, b = np.zeros(3), np.zeros(3)
    expanded = 0
    while expanded < MAX_EXPANDED:
        estimate, state = heapq.heappop(queue)
        if estimate >= best or state < 0:
            return False
        if done[state]:
            continue
        done[state] = True
        expanded += 1
        if cost[state] + last[state] < best:
            best = cost[state] + last[state]
            found[0], found[1] = best, state
        h, i, j = state // area, (state % area) // columns, state % columns
        a[0], a[1] = origin[0] + (j + 0.5) * cell, origin[1] + (i + 0.5) * cell
        a[2] = headings[h]
        here = _gap_at(h, i, j, known, lattice, surroundings, scratch)
        for move in range(moves.heading.shape[1]):
            g, di, dj = moves.heading[h, move], moves.rows[h, move], moves.columns[h, move]
            ni, nj = i + di, j + dj
            if ni < 0 or nj < 0 or ni >= rows or nj >= columns:
                continue
            after = g * area + ni * columns + nj
            if done[after] or not np.isfinite(ahead[ni, nj]):
                continue
            turn = wrapped(headings[g] - headings[h]) if g != h else 0.0
            length, factor = moves.length[h, move], moves.factor[move]
            step = factor * (length + weights.turning * abs(turn))
            if cost[state] + step >= cost[after]:
                continue
            there = _gap_at(g, ni, nj, known, lattice, surroundings, scratch)
            if there < weights.needed_clearance:
                continue
            between = (here + there) / 2
            if 2 * between - length - radius * abs(turn) > weights.needed_clearance:
                near = max(0.0, 1 - between / weights.preferred_clearance)
                step *= 1 + weights.proximity * near**2
            else:
                b[0], b[1], b[2] = a[0] + dj * cell, a[1] + di * cell, headings[g]
                if g != h and model.turning_radius > 0:
                    step = bend_cost(a, b, model.turning_radius, surroundings, weights, scratch)
                else:
                    step = factor * leg(a, b, turn, surroundings, weights, scratch)
            if cost[state] + step < cost[after]:
                cost[after], parent[after] = cost[state] + step, state
                heapq.heappush(queue, (cost[after] + ahead[ni, nj], after))
    return True


@entry
def shorten(poses: F2, needs: F1, model: PathModel) -> np.ndarray:
    """Remove poses from a path where a simple path past them is cheaper.

    Args:
        poses: The path (n, 3).
        needs: Smallest gaps on the legs at the first two and the last two poses, which may be close
            to obstacles [m].
        model: The robot, the obstacles and the cost of paths.

    Returns:
        Indices of the remaining poses, in order; empty if consecutive poses do not connect.
    """
    n, weights = len(poses), model.cost_weights
    scratch = scratch_for(model.surroundings)
    cost, parent = np.full(n, np.inf), np.full(n, -1, np.int64)
    cost[0] = 0.0
    for j in range(1, n):
        for i in range(j):
            limit = cost[j] - cost[i]
            if np.isfinite(cost[i]) and limit > 0:
                need = weights.needed_clearance
                if i <= 1:
                    need = min(need, needs[0])
                if j >= n - 2:
                    need = min(need, needs[1])
                local = CostWeights(
                    need,
                    weights.preferred_clearance,
                    weights.proximity,
                    weights.turning,
                    weights.reversing,
                    weights.cusp,
                )
                found = _connect(poses[i], poses[j], model, local, limit, scratch)[0]
                if found < limit:
                    cost[j], parent[j] = cost[i] + found, i
    kept = [n - 1]
    while parent[kept[-1]] >= 0:
        kept.append(parent[kept[-1]])
    if kept[-1] != 0:
        return np.zeros(0, np.int64)
    return np.array(kept[::-1], np.int64)


REVERSING_COST = 1.3
"""Cost of a meter driven backwards, except for an omni base [-]."""
RADIUS_RESERVE = 1.1
"""Turning radius of the paths of a car-like base, relative to its least one [-]. The rest corrects
deviations in a turn: twelve drives in `kitchen_small` take 27 paths and 213 s with 1.02, 19 and
187 s with 1.1, and 18 and 202 s with 1.25, where the paths are longer."""


def planned_radius(robot: Robot) -> float:
    """Return the turning radius of a robot's paths [m]; 0 for one that turns on the spot."""
    return RADIUS_RESERVE * robot.min_turning_radius if robot.drive == "car" else 0.0


def lattice_moves(robot: Robot) -> Moves:
    """Return the moves of a robot's base.

    An omni base moves along all headings and turns on the spot; a differential base moves along its
    own heading, both ways, and turns on the spot. A car-like base moves along its heading, and
    bends to the next heading: whole steps before and after are the tangents of an arc.
    """
    if robot.drive == "omni":
        return _turning_moves(True)
    return _car_moves(planned_radius(robot)) if robot.drive == "car" else _turning_moves(False)


@lru_cache(maxsize=2)
def _turning_moves(omni: bool) -> Moves:
    count = len(HEADINGS)
    own = np.arange(count)
    ways = count if omni else 2
    along = np.arange(count)[None] + 0 * own[:, None]
    if not omni:
        along = np.stack([own, own + count // 2], -1) % count
    heading = np.column_stack([(own + 1) % count, (own - 1) % count, np.tile(own[:, None], ways)])
    steps = np.concatenate([np.zeros((count, 2, 2), int), MOVES[along]], axis=1)
    factor = np.ones(2 + ways)
    factor[3:] = 1.0 if omni else REVERSING_COST
    return _moves(heading, steps, np.hypot(*steps.T).T * CELL, factor)


@lru_cache(maxsize=8)
def _car_moves(radius: float) -> Moves:
    count = len(HEADINGS)
    own = np.arange(count)
    heading, steps, length = [own, own], [MOVES, -MOVES], [_sizes(MOVES), _sizes(MOVES)]
    for way in (1, -1):
        for side in (1, -1):
            # Backwards, the heading after the move is that of a turn to the other side.
            after = (own + side) % count
            half = np.abs(wrap_angle(HEADINGS[after] - HEADINGS)) / 2
            tangent = radius * np.tan(half)
            before_steps, after_steps = (
                np.maximum(1, np.ceil(tangent / _sizes(MOVES[which]))).astype(int)
                for which in (own, after)
            )
            before, behind = before_steps * _sizes(MOVES), after_steps * _sizes(MOVES[after])
            least = np.minimum(before, behind)
            heading.append(after)
            steps.append(
                way * (before_steps[:, None] * MOVES + after_steps[:, None] * MOVES[after])
            )
            length.append(before + behind - 2 * least + least / np.tan(half) * 2 * half)
    factor = np.array([1.0, REVERSING_COST, 1.0, 1.0, REVERSING_COST, REVERSING_COST])
    return _moves(np.stack(heading, -1), np.stack(steps, 1), np.stack(length, -1), factor)


def _sizes(moves: Int[np.ndarray, "n 2"]) -> np.ndarray:
    return np.asarray(np.hypot(*moves.T) * CELL)


def _moves(
    heading: Int[np.ndarray, "h m"],
    steps: Int[np.ndarray, "h m 2"],
    length: np.ndarray,
    factor: np.ndarray,
) -> Moves:
    columns, rows = (np.ascontiguousarray(steps[..., k], np.int64) for k in (0, 1))
    return Moves(
        np.ascontiguousarray(heading, np.int64), columns, rows, np.ascontiguousarray(length), factor
    )
