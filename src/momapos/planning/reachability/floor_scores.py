"""Kernels that score base positions on a floor grid, each at its best yaw.

If the arm's first axis is not above the base's origin, its position depends on the yaw. So the map
is looked up once for axes on a lattice around the tool's line, with all azimuths of a lattice point
together. A base at some yaw then interpolates between the lattice points around its axis.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from momapos.core.compiled import F1, F2, I1, S2, entry, kernel

from .grid import LOW, ONE, OUTSIDE, MapArrays, Point, relative_line, scored, turns_of

SPACING = 0.06
"""Spacing of the lattice [m]; the map's cell if that is larger."""


class FloorGrid(NamedTuple):
    """Base positions on a grid of the floor, and their yaws."""

    xs: F1
    ys: F1
    yaws: F2
    """(k, 3): cosine, sine, and in [0, 1] [turns]."""


@kernel(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def _axis_lattice(line, yaws, grid, rims, step, table):
    """Look up a line for first axes on a square lattice around its point.

    Interpolates over the simplex of height, distance and direction, then linearly over the azimuth.

    Args:
        line: Point over the floor and unit direction (6,).
        yaws: Yaws of the base (k, 3): cosine, sine, and in [0, 1] [turns].
        grid, rims: See `floor_scores`.
        step: Spacing of the lattice [cells].
        table: Output (n, k, n): at [n // 2 + i, k, n // 2 + j] the value for an axis j steps in x
            and i steps in y before the line's point. `OUTSIDE` beyond reach.

    Returns:
        Number of steps from the line's point beyond which all values are `OUTSIDE`.
    """
    nz, nr, nu, nv, nb = grid.shape
    half = len(table) // 2
    table[:] = OUTSIDE
    fz = (line[2] - grid.frame.low) * grid.frame.per_meter
    if fz < 0.0 or fz >= nz - 1:
        return 0
    iz = int(fz)
    rim = min(nr - 1, max(rims[iz], rims[iz + 1])) / step
    most = min(half, int(rim))
    row = np.empty(2 * nb + 2, np.float32)
    for i in range(-most, most + 1):
        for j in range(-most, most + 1):
            if i * i + j * j >= rim * rim:
                continue
            fr, u, v = relative_line(j * step, i * step, line[3], line[4], line[5])
            fu, fv = (u + 1.0) * (0.5 * (nu - 1)), (v + 1.0) * (0.5 * (nv - 1))
            ir, iu, iv = min(int(fr), nr - 2), min(int(fu), nu - 2), min(int(fv), nv - 2)
            at = ((iz * nr + ir) * nu + iu) * nv + iv
            _all_azimuths(at, (fz - iz, fr - ir, fu - iu, fv - iv), grid, row)
            ahead = turns_of(float(i), float(j)) + 1.0
            for k in range(len(yaws)):
                fb = np.float32((ahead - yaws[k, 2]) * nb)
                ib = np.uint64(fb)
                fb -= np.float32(ib)
                table[half + i, k, half + j] = row[ib] + fb * (row[ib + np.uint64(1)] - row[ib])
    return most + 1


@kernel(error_model="numpy", fastmath=True)
def _all_azimuths(at, fractions, grid, row):
    """Interpolate the values at all azimuths of two turns into `row` (2 azimuths + 2,).

    `at` is the index of the cell's lowest corner, `fractions` the position in the cell along z, r,
    u and v.
    """
    fz, fr, fu, fv = fractions
    values = grid.values
    _, nr, nu, nv, nb = grid.shape
    # Packed and sorted without branches, see `grid.lookup`; the network is Knuth's for four.
    a, b = (int(fz * ONE) << 32) + nr * nu * nv, (int(fr * ONE) << 32) + nu * nv
    c, d = (int(fu * ONE) << 32) + nv, (int(fv * ONE) << 32) + 1
    a, b = max(a, b), min(a, b)
    c, d = max(c, d), min(c, d)
    a, c = max(a, c), min(a, c)
    b, d = max(b, d), min(b, d)
    b, c = max(b, c), min(b, c)
    i = at + (a & LOW)
    j = i + (b & LOW)
    k = j + (c & LOW)
    m = k + (d & LOW)
    one = values[at * nb : (at + 1) * nb]
    two = values[i * nb : (i + 1) * nb]
    three = values[j * nb : (j + 1) * nb]
    four = values[k * nb : (k + 1) * nb]
    five = values[m * nb : (m + 1) * nb]
    fa, fb, fc, fd = (a >> 32) / ONE, (b >> 32) / ONE, (c >> 32) / ONE, (d >> 32) / ONE
    w1, w2, w3 = np.float32(1.0 - fa), np.float32(fa - fb), np.float32(fb - fc)
    w4, w5 = np.float32(fc - fd), np.float32(fd)
    for n in range(nb):
        row[n] = w1 * one[n] + w2 * two[n] + w3 * three[n] + w4 * four[n] + w5 * five[n]
    for n in range(nb, len(row)):
        row[n] = row[n - nb]


@entry(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def floor_scores(
    line: F1, floor: FloorGrid, axis: Point, grid: MapArrays, rims: I1, out: S2
) -> None:
    """Score base positions on a floor grid at their best yaw, linearly between lattice points.

    Args:
        line: Point over the floor and unit direction (6,).
        floor: The base positions and yaws.
        axis: The first axis in the base frame.
        rims: For each height, the smallest r beyond which all values are `OUTSIDE` [cells].
        out: Output (len(ys), len(xs)).
    """
    xs, ys, yaws = floor
    shape, frame = grid.shape, grid.frame
    step = max(1.0, SPACING * frame.per_meter)
    per_meter = frame.per_meter / step
    size = 2 * math.ceil(shape[1] / step) + 1
    table = np.empty((size, len(yaws), size), np.float32)
    far = _axis_lattice(line, yaws, grid, rims, step, table)
    begin, end = size // 2 - far, size // 2 + far
    out[:] = OUTSIDE
    column, low = np.empty(len(xs), np.int64), np.empty(len(xs), np.int64)
    share, row = np.empty(len(xs), np.float32), np.empty(size, np.float32)
    for k in range(len(yaws)):
        c, s = yaws[k, 0], yaws[k, 1]
        x, y = line[0] - c * axis.x + s * axis.y, line[1] - s * axis.x - c * axis.y
        count = 0
        for j in range(len(xs)):
            f = (x - xs[j]) * per_meter + size // 2
            if begin <= f < end:
                column[count], low[count], share[count] = j, int(f), f - int(f)
                count += 1
        for i in range(len(ys)):
            f = (y - ys[i]) * per_meter + size // 2
            if begin <= f < end:
                g = int(f)
                upper = np.float32(f - g)
                for m in range(begin, end + 1):
                    row[m] = table[g, k, m] + upper * (table[g + 1, k, m] - table[g, k, m])
                for m in range(count):
                    at = low[m]
                    v = row[at] + share[m] * (row[at + 1] - row[at])
                    out[i, column[m]] = max(out[i, column[m]], v)
    for i in range(len(ys)):
        for j in range(len(xs)):
            out[i, j] = scored(out[i, j], frame.threshold)
