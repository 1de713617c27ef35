"""Cheapest ways over cells and headings (A*), and their shortening: the compiled part."""

from __future__ import annotations

import heapq

import numpy as np
from numba import njit

from momapos.navigation.clearance import connect, leg, wrapped


@njit(cache=True, nogil=True)
def connections(a, b, omni, body, things, taste):
    """Cost of the simple way between each pair of poses (n, 3), and whether it is backwards."""
    near, work = np.empty(len(things[4]), np.int64), np.empty((len(body[0]), 5))
    cost, backwards = np.empty(len(a)), np.empty(len(a), np.bool_)
    for k in range(len(a)):
        cost[k], backwards[k] = connect(a[k], b[k], omni, body, things, taste, np.inf, near, work)
    return cost, backwards


@njit(cache=True, nogil=True)
def search(gaps, ahead, first, last, lattice, omni, body, things, taste):
    """Find the cheapest way over the lattice (Hart, Nilsson, Raphael 1968).

    Args:
        gaps: Gap at every state (headings, rows, columns) [m].
        ahead: Lower bound of the cost from every cell to the goal (rows, columns) [m].
        first: Cost from the start to every state it is attached to, infinite elsewhere, flat.
        last: Cost from every state to the goal, likewise.
        lattice: Origin (2,) [m], edge of a cell [m], moves (headings, 2), headings [rad].
        omni, body, things, taste: See `connect`.

    Returns:
        The states of the way, from first to last, as flat indices; empty where there is none.
    """
    origin, cell, moves, headings = lattice
    turns, rows, columns = gaps.shape
    area = rows * columns
    flat = gaps.ravel()
    near, work = np.empty(len(things[4]), np.int64), np.empty((len(body[0]), 5))
    cost, parent = first.copy(), np.full(flat.size, -1, np.int64)
    done = np.zeros(flat.size, np.bool_)
    queue = [(np.inf, np.int64(-1))]
    for state in np.flatnonzero(np.isfinite(first)):
        bound = ahead[(state % area) // columns, state % columns]
        if np.isfinite(bound):
            heapq.heappush(queue, (first[state] + bound, state))
    best, end = np.inf, np.int64(-1)
    a, b = np.zeros(3), np.zeros(3)
    need, liked, weight, turning, reversing = taste
    ways = turns if omni else 2
    while True:
        estimate, state = heapq.heappop(queue)
        if estimate >= best or state < 0:
            break
        if done[state]:
            continue
        done[state] = True
        if cost[state] + last[state] < best:
            best, end = cost[state] + last[state], state
        h, i, j = state // area, (state % area) // columns, state % columns
        a[0], a[1] = origin[0] + (j + 0.5) * cell, origin[1] + (i + 0.5) * cell
        a[2] = headings[h]
        for way in range(ways + 2):
            g, di, dj, factor = h, 0, 0, 1.0
            if way < 2:
                g = (h + 1 - 2 * way) % turns
            else:
                along = way - 2 if omni else (h + (way - 2) * (turns // 2)) % turns
                dj, di = moves[along, 0], moves[along, 1]
                factor = reversing if way == 3 and not omni else 1.0
            ni, nj = i + di, j + dj
            if ni < 0 or nj < 0 or ni >= rows or nj >= columns:
                continue
            after = g * area + ni * columns + nj
            if done[after] or flat[after] < need or not np.isfinite(ahead[ni, nj]):
                continue
            turn = wrapped(headings[g] - headings[h]) if g != h else 0.0
            length = cell * np.hypot(di, dj)
            between = (flat[state] + flat[after]) / 2
            step = factor * (length + turning * abs(turn))
            if cost[state] + step >= cost[after]:
                continue
            if 2 * between - length - body[4] * abs(turn) > need:
                step *= 1 + weight * max(0.0, 1 - between / liked) ** 2
            else:
                b[0], b[1] = a[0] + dj * cell, a[1] + di * cell
                step = factor * leg(a, b, turn, body, things, taste, near, work)
            if cost[state] + step < cost[after]:
                cost[after], parent[after] = cost[state] + step, state
                heapq.heappush(queue, (cost[after] + ahead[ni, nj], after))
    path = [np.int64(end)]
    while path[-1] >= 0:
        path.append(parent[path[-1]])
    return np.array(path[:-1][::-1], np.int64)


@njit(cache=True, nogil=True)
def shorten(poses, needs, omni, body, things, taste):
    """Leave poses out of a way where a simple way past them is cheaper.

    Args:
        poses: The way (n, 3).
        needs: Gaps needed on the way to and from the first and last two poses, where there may be
            little room [m].
        omni, body, things, taste: See `connect`.

    Returns:
        Indices of the poses that stay, in order; empty where even neighbours do not connect.
    """
    n = len(poses)
    near, work = np.empty(len(things[4]), np.int64), np.empty((len(body[0]), 5))
    cost, parent = np.full(n, np.inf), np.full(n, -1, np.int64)
    cost[0] = 0.0
    for j in range(1, n):
        for i in range(j):
            limit = cost[j] - cost[i]
            if np.isfinite(cost[i]) and limit > 0:
                need = taste[0]
                if i <= 1:
                    need = min(need, needs[0])
                if j >= n - 2:
                    need = min(need, needs[1])
                local = (need, taste[1], taste[2], taste[3], taste[4])
                found = connect(poses[i], poses[j], omni, body, things, local, limit, near, work)[0]
                if found < limit:
                    cost[j], parent[j] = cost[i] + found, i
    kept = [n - 1]
    while parent[kept[-1]] >= 0:
        kept.append(parent[kept[-1]])
    if kept[-1] != 0:
        return np.zeros(0, np.int64)
    return np.array(kept[::-1], np.int64)
