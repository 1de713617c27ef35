"""Convert reachability at grid points to signed distances from the boundary, in cells.

Along every grid edge whose ends disagree, further evaluations locate the boundary. With crossings
at distances t_i along the axes, the distance to a flat boundary is `1 / sqrt(sum 1 / t_i^2)`.
Farther inside, steps along the axes are added (chamfer distance).
"""

from __future__ import annotations

import math

import numpy as np

from momapos.core.compiled import C1, C2, I2, U1, U2, entry, kernel

from .grid import DEPTH, OUTSIDE, STEPS, GridShape
from .map_kernels import AZIMUTHS


def uneven_edges(masks: np.ndarray, least: int) -> list[np.ndarray]:
    """Find, for each axis, the points that disagree with their neighbor one step up.

    Args:
        masks: Masks of azimuths (z, r, u, v).
        least: Smallest number of azimuths in which they must disagree [-].
    """
    found = []
    for axis in range(masks.ndim):
        near = np.moveaxis(masks, axis, 0)
        differ = np.zeros(masks.shape, bool)
        np.moveaxis(differ, axis, 0)[:-1] = np.bitwise_count(near[1:] ^ near[:-1]) >= least
        found.append(np.flatnonzero(differ))
    return found


def nearby(masks: np.ndarray, spread: int) -> np.ndarray:
    """Return the azimuths that a point or one of its neighbors has, widened to both sides.

    Args:
        masks: Masks of azimuths (z, r, u, v).
        spread: Number of azimuths added to both sides [-].
    """
    found = masks.copy()
    for axis in range(masks.ndim):
        near, here = np.moveaxis(found, axis, 0), np.moveaxis(masks, axis, 0)
        near[1:] |= here[:-1]
        near[:-1] |= here[1:]
    for _ in range(spread):
        left = (found << np.uint64(1)) | (found >> np.uint64(AZIMUTHS - 1))
        found |= left | (found >> np.uint64(1)) | (found << np.uint64(AZIMUTHS - 1))
    return found


@kernel
def _first_change(bit, here, there, row, interior, backwards):
    """Return the distance along an edge to the first point that differs, 9 if none does."""
    one, shift = np.uint64(1), np.uint64(bit)
    state = (here >> shift) & one
    if row >= 0:
        n = interior.shape[1]
        for k in range(n):
            m = interior[row, n - 1 - k] if backwards else interior[row, k]
            if (m >> shift) & one != state:
                return (k + 0.5) / (n + 1)
        return (n + 0.5) / (n + 1) if (there >> shift) & one != state else 9.0
    return 0.5 if (there >> shift) & one != state else 9.0


@entry
def near_signed_distances(
    lo: int, hi: int, masks: U1, shape: GridShape, rows: I2, interior: U2, out: C2
) -> None:
    """Compute signed distances next to the boundary, for points lo to hi.

    Args:
        lo, hi: Range of points.
        masks: Masks of azimuths (points,).
        shape: Number of points along z, r, u, v, azimuth.
        rows: Row of `interior` for the edge one step up each axis, or -1 (4, points).
        interior: Masks on the uneven edges (edges, k).
        out: Output (points, azimuths).
    """
    nz, nr, nu, nv, nb = shape
    stride = (nr * nu * nv, nu * nv, nv, 1)
    count = (nz, nr, nu, nv)
    one = np.uint64(1)
    for i in range(lo, hi):
        for b in range(nb):
            bit = b * (AZIMUTHS // nb)
            state = (masks[i] >> np.uint64(bit)) & one
            total = 0.0
            for a in range(4):
                at = (i // stride[a]) % count[a]
                t = 9.0
                if at + 1 < count[a]:
                    j = i + stride[a]
                    t = _first_change(bit, masks[i], masks[j], rows[a, i], interior, False)
                if at > 0:
                    j = i - stride[a]
                    t = min(t, _first_change(bit, masks[i], masks[j], rows[a, j], interior, True))
                if t < 9.0:
                    total += 1.0 / (t * t)
            if nb > 1:
                per = AZIMUTHS // nb
                for k in range(1, per + 1):
                    up = (masks[i] >> np.uint64((bit + k) % AZIMUTHS)) & one
                    down = (masks[i] >> np.uint64((bit - k) % AZIMUTHS)) & one
                    if up != state or down != state:
                        t = (k - 0.5) / per
                        total += 1.0 / (t * t)
                        break
            if total == 0.0:
                out[i, b] = DEPTH if state else OUTSIDE
            else:
                d = max(1.0, round(STEPS / math.sqrt(total)))
                out[i, b] = d if state else -d


@entry
def flood_signed_distances(state: C1, middles: C2, turn_gap: C1, shape: GridShape, out: C1) -> None:
    """Compute signed distances next to the boundary from whether each line is reached.

    Args:
        state: Whether each line is reached, 0 or 1.
        middles: The same half-way to the next line along each axis, or -1 (5, lines).
        turn_gap: Quarters of a step of the tool turn to where the state changes, or 0.
        shape: Number of lines along z, r, u, v, azimuth.
        out: Output (lines,).
    """
    nz, nr, nu, nv, nb = shape
    stride = (nr * nu * nv * nb, nu * nv * nb, nv * nb, nb, 1)
    count = (nz, nr, nu, nv, nb)
    for i in range(len(state)):
        total = 0.0
        for a in range(5):
            at = (i // stride[a]) % count[a]
            t = 9.0
            for way in (1, -1):
                to = at + way
                if a == 4:
                    to %= count[a]
                if not 0 <= to < count[a]:
                    continue
                j = i + (to - at) * stride[a]
                middle = middles[a, i if way == 1 else j]
                if middle >= 0 and middle != state[i]:
                    t = min(t, 0.25)
                elif state[j] != state[i]:
                    t = min(t, 0.75 if middle >= 0 else 0.5)
            if t < 9.0:
                total += 1.0 / (t * t)
        if turn_gap[i] > 0:
            t = (turn_gap[i] - 0.5) / 4.0
            total += 1.0 / (t * t)
        if total == 0.0:
            out[i] = DEPTH if state[i] else OUTSIDE
        else:
            d = max(1.0, round(STEPS / math.sqrt(total)))
            out[i] = d if state[i] else -d


@entry
def deepen(values: C1, shape: GridShape) -> None:
    """Propagate distances inwards: a point is at most one cell deeper than its neighbors."""
    nz, nr, nu, nv, nb = shape
    stride = (nr * nu * nv * nb, nu * nv * nb, nv * nb, nb)
    count = (nz, nr, nu, nv)
    for direction in (1, -1):
        for step in range(nz * nr * nu * nv):
            i = step if direction == 1 else nz * nr * nu * nv - 1 - step
            for a in range(4):
                at = (i // (stride[a] // nb)) % count[a]
                if not 0 <= at - direction < count[a]:
                    continue
                j = (i * nb) - direction * stride[a]
                for b in range(nb):
                    least = max(values[j + b], 0) + STEPS
                    if values[i * nb + b] > least:
                        values[i * nb + b] = least
            if nb > 1:
                for k in range(2 * nb):
                    b = (k if direction == 1 else -k) % nb
                    c = (b - direction) % nb
                    least = max(values[i * nb + c], 0) + STEPS
                    if values[i * nb + b] > least:
                        values[i * nb + b] = least


def close_seam(values: np.ndarray) -> None:
    """Give coinciding points on the octahedron's border the same value, in place."""
    flipped = values[:, :, ::-1]
    for edge in (0, -1):
        pair = np.stack([values[:, :, :, edge], flipped[:, :, :, edge]])
        values[:, :, :, edge] = _nearest_boundary(pair)
    flipped = values[:, :, :, ::-1]
    for edge in (0, -1):
        pair = np.stack([values[:, :, edge], flipped[:, :, edge]])
        values[:, :, edge] = _nearest_boundary(pair)
    corners = np.stack([values[:, :, i, j] for i in (0, -1) for j in (0, -1)])
    least = _nearest_boundary(corners)
    for i in (0, -1):
        for j in (0, -1):
            values[:, :, i, j] = least


def _nearest_boundary(values: np.ndarray) -> np.ndarray:
    """Pick the value of smallest magnitude along the first axis."""
    pick = np.argmin(np.abs(values), axis=0)
    return np.take_along_axis(values, pick[None], 0)[0]
