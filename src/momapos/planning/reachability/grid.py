"""Coordinates of a reachability map, and its lookup kernels.

A tool pose is reduced to the line of the arm's last axis: if that joint turns fully, the tool's
turn about the line makes no difference. The line is described relative to a vertical axis through
the foot of the arm's first axis: distance `r` and height `z` of a point on it, its direction
relative to the radius, and the azimuth of the point. The azimuth counts if the first axis leans, or
if its limits or the base restrict it. Source: Rudorfer, RM4D: a combined reachability and inverse
reachability map for common 6-/7-axis robot arms by dimensionality reduction to 4D (ICRA 2025).

The direction is mapped to the square [-1, 1]^2 by the octahedral projection (Cigolle et al., A
survey of efficient representations for independent unit vectors, JCGT 2014), which needs no
trigonometry. Values are at grid points. A lookup interpolates over the simplex of the cell that
contains the query (Kuhn's triangulation: six corners instead of 32).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from momapos.core.compiled import F1, F2, F3, S2, ReadI8, entry, kernel

STEPS = 8
"""Stored steps of signed distance per cell [-]."""
DEPTH = 32
"""Stored value from which on the score is 1: four cells inside the boundary."""
OUTSIDE = -12
"""Stored value of points far from any reachable line."""
TURNS = 32
"""Number of tool turns about the line that are evaluated if they make a difference [-]."""
STORED_TURNS, FIRST_TURN = 8, 1
"""How many of these turns a map stores, evenly spaced, and the index of the first [-]."""
TURN_AT = (FIRST_TURN + 0.5) * STORED_TURNS / TURNS
"""Position of the first stored turn, in units of their spacing: each turn is in the middle of its
sector."""
ONE = 1 << 24
"""Fixed-point value of a whole cell."""
LOW = (1 << 32) - 1
_SHIFT = 1 << 20
"""Offset of packed strides, which may be negative."""


class GridShape(NamedTuple):
    """Number of points along each axis of a map."""

    z: int
    r: int
    u: int
    v: int
    azimuth: int


class GridFrame(NamedTuple):
    """Position and resolution of a map, and its threshold."""

    low: float
    """Height of the lowest point over the floor [m]."""
    per_meter: float
    """1 / cell [1/m]."""
    threshold: float
    """Stored value above which a line counts as reachable."""


class MapArrays(NamedTuple):
    """A map for the kernels."""

    values: ReadI8
    """Stored values, flat, tool turn by tool turn."""
    shape: GridShape
    frame: GridFrame
    turns: int
    """Number of stored tool turns; 1 if the turn makes no difference."""


class Point(NamedTuple):
    """A point of the floor plan [m]."""

    x: float
    y: float


class AxisLine(NamedTuple):
    """The line of the last axis: a point [m], relative to the first axis, and a unit direction."""

    x: float
    y: float
    z: float
    ax: float
    ay: float
    az: float


@kernel
def oct_decode(u: float, v: float) -> tuple[float, float, float]:
    """Return the unit vector of a point on the octahedral square."""
    z = 1.0 - abs(u) - abs(v)
    x, y = u, v
    if z < 0.0:
        x = (1.0 - abs(v)) * (1.0 if u >= 0.0 else -1.0)
        y = (1.0 - abs(u)) * (1.0 if v >= 0.0 else -1.0)
    n = 1.0 / math.sqrt(x * x + y * y + z * z)
    return x * n, y * n, z * n


@kernel
def turns_of(y: float, x: float) -> float:
    """Return atan2(y, x) / 2 pi in [0, 1], within 1e-5 (polynomial after Abramowitz and Stegun)."""
    ax, ay = abs(x), abs(y)
    low, high = min(ax, ay), max(ax, ay)
    a = low / high if high > 0.0 else 0.0
    s = a * a
    t = ((-0.0464964749 * s + 0.15931422) * s - 0.327622764) * s * a + a
    t *= 0.15915494309189535
    t = 0.25 - t if ay > ax else t
    t = 0.5 - t if x < 0.0 else t
    return 1.0 - t if y < 0.0 else t


@kernel(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def relative_line(x, y, ax, ay, az):
    """Compute the distance of a line's point (x, y) from the first axis, and the line's direction.

    Returns:
        r in the unit of x and y, and the direction relative to the radius, on the octahedral square
        u, v.
    """
    r = math.sqrt(x * x + y * y)
    cx, cy = 1.0, 0.0
    if r > 1e-9:
        cx, cy = x / r, y / r
    radial, tangential = ax * cx + ay * cy, ay * cx - ax * cy
    n = 1.0 / (abs(radial) + abs(tangential) + abs(az))
    u, v = radial * n, tangential * n
    if az < 0.0:
        fold_u = math.copysign(1.0 - abs(v), u)
        v = math.copysign(1.0 - abs(u), v)
        u = fold_u
    return r, u, v


@kernel(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def lookup(line, yaw_turns, turn, grid):
    """Interpolate the value of a line and a tool turn about it.

    Args:
        line: `AxisLine`, in any frame with z up from the floor.
        yaw_turns: Yaw of the base in that frame [turns].
        turn: Tool turn about the line, see `ReachMap.turns` [turns].
        grid: `MapArrays`.

    Returns:
        Value in stored steps; the line can be reached if it is above the threshold.
    """
    size = grid.shape.z * grid.shape.r * grid.shape.u * grid.shape.v * grid.shape.azimuth
    f = turn * grid.turns - TURN_AT + grid.turns
    i = int(f)
    f -= i
    one = _line_value(line, yaw_turns, (i % grid.turns) * size, grid)
    if grid.turns == 1:
        return one
    other = _line_value(line, yaw_turns, ((i + 1) % grid.turns) * size, grid)
    return one + f * (other - one)


@kernel(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def _line_value(line, yaw_turns, first, grid):
    """Interpolate the value of a line, see `lookup`, in the values from index `first` on."""
    x, y, z, ax, ay, az = line
    values = grid.values
    nz, nr, nu, nv, nb = grid.shape
    z0, per_meter = grid.frame.low, grid.frame.per_meter
    square = x * x + y * y
    fz = (z - z0) * per_meter
    if square * (per_meter * per_meter) >= (nr - 1) * (nr - 1) or fz < 0.0 or fz >= nz - 1:
        return float(OUTSIDE)
    r, u, v = relative_line(x, y, ax, ay, az)
    fr, fu, fv = r * per_meter, (u + 1.0) * (0.5 * (nu - 1)), (v + 1.0) * (0.5 * (nv - 1))
    iz, ir, iu, iv = int(fz), min(int(fr), nr - 2), min(int(fu), nu - 2), min(int(fv), nv - 2)
    sv = nb
    su = sv * nv
    sr = su * nu
    sz = sr * nr
    at = first + iz * sz + ir * sr + iu * su + iv * sv
    fb, sb = 0.0, 0
    if nb > 1:
        turns = turns_of(y, x) - yaw_turns
        fb = (turns - math.floor(turns)) * nb
        ib = min(int(fb), nb - 1)
        fb -= ib
        at += ib
        sb = 1 if ib < nb - 1 else 1 - nb
    # Pack fraction and stride into one integer: sorting is then min and max, without branches.
    a = (int((fz - iz) * ONE) << 32) + sz + _SHIFT
    b = (int((fr - ir) * ONE) << 32) + sr + _SHIFT
    c = (int((fu - iu) * ONE) << 32) + su + _SHIFT
    d = (int((fv - iv) * ONE) << 32) + sv + _SHIFT
    e = (int(fb * ONE) << 32) + sb + _SHIFT
    # Sorting network for five (Knuth, The Art of Computer Programming, section 5.3.4).
    a, d = max(a, d), min(a, d)
    b, e = max(b, e), min(b, e)
    a, c = max(a, c), min(a, c)
    b, d = max(b, d), min(b, d)
    a, b = max(a, b), min(a, b)
    c, e = max(c, e), min(c, e)
    b, c = max(b, c), min(b, c)
    d, e = max(d, e), min(d, e)
    c, d = max(c, d), min(c, d)
    i = at + (a & LOW) - _SHIFT
    j = i + (b & LOW) - _SHIFT
    k = j + (c & LOW) - _SHIFT
    m = k + (d & LOW) - _SHIFT
    last = m + (e & LOW) - _SHIFT
    fa, fs, fc, fd, fe = a >> 32, b >> 32, c >> 32, d >> 32, e >> 32
    total = (
        values[np.uint64(at)] * (ONE - fa)
        + values[np.uint64(i)] * (fa - fs)
        + values[np.uint64(j)] * (fs - fc)
        + values[np.uint64(k)] * (fc - fd)
        + values[np.uint64(m)] * (fd - fe)
        + values[np.uint64(last)] * fe
    )
    return total / ONE


@kernel
def scored(value, threshold):
    """Convert a stored value to a score in [0, 1]; 0 up to the threshold."""
    return min(max((value - threshold) / DEPTH, 0.0), 1.0)


@entry
def score_lines(lines: F2, turn: F1, grid: MapArrays, out: F1) -> None:
    """Score lines (m, 6), given as x, y, z, direction relative to the first axis, at tool turns
    about them (m,)."""
    for i in range(len(lines)):
        line = AxisLine(
            lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3], lines[i, 4], lines[i, 5]
        )
        out[i] = scored(lookup(line, 0.0, turn[i], grid), grid.frame.threshold)


@entry
def min_line_scores(bases: F2, lines: F3, turn: F2, axis: Point, grid: MapArrays, out: S2) -> None:
    """Compute the lowest score over w lines (g, w, 6) in the world, for every base (n, 3) and g.

    The tool is turned about each line (g, w). The first axis is at a point of the base frame.
    """
    threshold = grid.frame.threshold
    for i in range(len(bases)):
        c, s = math.cos(bases[i, 2]), math.sin(bases[i, 2])
        x, y = bases[i, 0] + c * axis.x - s * axis.y, bases[i, 1] + s * axis.x + c * axis.y
        turns = bases[i, 2] / (2.0 * math.pi)
        for g in range(lines.shape[0]):
            least = float(DEPTH)
            for w in range(lines.shape[1]):
                line = AxisLine(
                    lines[g, w, 0] - x,
                    lines[g, w, 1] - y,
                    lines[g, w, 2],
                    lines[g, w, 3],
                    lines[g, w, 4],
                    lines[g, w, 5],
                )
                least = min(least, lookup(line, turns, turn[g, w], grid))
                if least <= threshold:
                    break
            out[i, g] = scored(least, threshold)


def pack_shape(shape: tuple[int, ...]) -> GridShape:
    """Convert the shape of the values for the kernels."""
    return GridShape(*map(int, shape))


def grid_points(
    shape: tuple[int, ...], low: float, cell: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the coordinates of the grid along z [m], r [m], u [-] and v [-]."""
    nz, nr, nu, nv = shape[:4]
    return (
        low + cell * np.arange(nz),
        cell * np.arange(nr),
        np.linspace(-1.0, 1.0, nu),
        np.linspace(-1.0, 1.0, nv),
    )
