"""The reachability map of one robot: how well a tool pose can be reached from a base pose.

If the arm's first axis is not above the base's origin, its position depends on the yaw. So the map
is looked up once for axes on a lattice around the tool's line, with all azimuths of a lattice point
together. A base at some yaw then interpolates between the lattice points around its axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import finite_number, refuse_above, refuse_below
from momapos.core.compiled import F1, F2, I1, S2, entry, kernel

from .grid import (
    LOW,
    ONE,
    OUTSIDE,
    GridFrame,
    MapArrays,
    Point,
    min_line_scores,
    pack_shape,
    relative_line,
    score_lines,
    scored,
    turns_of,
)

if TYPE_CHECKING:
    from jaxtyping import Float, Int, Int8


Progress = Callable[[float], None]
"""Callback for the completed share, in [0, 1]."""
SPACING = 0.06
"""Spacing of the lattice [m]; the map's cell if that is larger."""


def silent(_share: float) -> None:
    """Report no progress."""


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


YAWS = 12
"""Number of base yaws that `base_scores` tries [-]."""
MAX_VALUES = 100_000_000
"""Largest number of values of a map [-]; building it takes several bytes per value."""
MAX_LOOKUPS = 2_000_000
"""Number of lines that are looked up between two looks at the clock; they take about 0.1 s [-]."""
_TURNS = np.arange(YAWS) / YAWS
_YAWS = np.stack([np.cos(2 * np.pi * _TURNS), np.sin(2 * np.pi * _TURNS), _TURNS], -1)


MAX_GRID, MAX_STATES = 1_000, 100_000_000
"""Bounds of the counts [-]."""


@dataclass(frozen=True)
class ReachConfig:
    """Resolution of a reachability map."""

    cell: float = 0.04
    """Spacing of the grid in height and distance [m]."""
    directions: int = 25
    """Grid points along each side of the octahedral square of directions, odd [-]."""
    azimuths: int = 32
    """Grid points along the azimuth, a divisor of 64 [-]; 1 omits the azimuth. It is also omitted
    if it makes no difference."""
    samples: int = 32
    """Locked values of the first joint of a redundant arm [-]; up to four times as many where
    neighbors disagree. Far from any reachable line, only half of them are tried."""
    heights: int = 5
    """Locked values of a torso joint [-]; about half of them far from any reachable line."""
    threshold: float = -0.4
    """Value above which a line counts as reachable [1/8 cell]. Interpolation shifts the convex
    boundary of the reachable set inwards by about 1/20 of a cell."""
    spins: int = 4
    """Tool turns about the last axis that are checked for collision, as tools are not round [-];
    at least half of them must be free."""
    states: int = 300_000
    """Random arm states that start the flooding [-]. An arm is flooded if its first axis is not
    vertical or its last joint does not turn fully."""

    def __post_init__(self) -> None:
        refuse_below(self, 0.005, "cell")
        refuse_below(self, 3, "directions")
        refuse_below(self, 1, "azimuths", "samples", "heights", "spins", "states")
        refuse_above(self, MAX_GRID, "directions", "azimuths", "samples", "heights", "spins")
        refuse_above(self, MAX_STATES, "states")
        finite_number("ReachConfig.threshold", self.threshold)


@dataclass(frozen=True, eq=False)
class ReachMap:
    """The reachability map of a robot: signed distances to the boundary of the reachable set.

    The grid is over the lines of the arm's last axis, see `momapos.planning.reachability.grid`.
    """

    values: Int8[np.ndarray, "z r u v azimuth"]
    """Distance to the boundary [1/8 cell]; positive inside."""
    low: float
    """Height of the lowest grid point over the floor [m]."""
    cell: float
    """Spacing in height and distance [m]."""
    axis_xy: Float[np.ndarray, "2"]
    """Foot of the first axis in the base frame [m]; the grid is centered on it."""
    line_tool: Float[np.ndarray, "2 3"]
    """Direction of the last axis and a point on it [m], in the tool frame."""
    threshold: float = 0.0
    """Value above which a line counts as reachable [1/8 cell]."""
    key: str = ""
    """Content key of the data that the map was built from."""
    build_seconds: float = 0.0
    turned: Int8[np.ndarray, "k z r u v azimuth"] | None = None
    """Values for k tool turns about the line; `values` holds their maximum. None if the turn makes
    no difference."""
    across_tool: Float[np.ndarray, "3"] | None = None
    """Unit vector across the line, in the tool frame; its angle about the line is the tool turn."""

    def __repr__(self) -> str:
        size = " x ".join(map(str, self.values.shape))
        return f"<ReachMap {self.key}: {size} values, {self.reach:.2f} m>"

    def _repr_png_(self) -> bytes:
        """Return the figure that a notebook shows."""
        # Imported by name, because plots are above planning in the import order.
        png: bytes = import_module("momapos.apps.plots.notebook_images").reach_png(self)
        return png

    @property
    def reach(self) -> float:
        """Upper bound of the distance between the last axis point and the first axis [m]."""
        return (self.values.shape[1] - 1) * self.cell

    def _arrays(self) -> MapArrays:
        frame = GridFrame(float(self.low), 1.0 / float(self.cell), float(self.threshold))
        shape = pack_shape(self.values.shape)
        if self.turned is None:
            return MapArrays(self.values.reshape(-1), shape, frame, 1)
        return MapArrays(self.turned.reshape(-1), shape, frame, len(self.turned))

    def turns(self, Ts: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, " *batch"]:
        """Return the tool's turn about its last axis [turns]; 0 if it makes no difference.

        It counts from the horizontal direction across the axis, so it is the same for every base.
        """
        Ts = np.asarray(Ts, float)
        if self.across_tool is None:
            return np.zeros(Ts.shape[:-2])
        direction, across = Ts[..., :3, :3] @ self.line_tool[0], Ts[..., :3, :3] @ self.across_tool
        level = np.stack([-direction[..., 1], direction[..., 0], 0 * direction[..., 2]], -1)
        upwards = np.cross(direction, level)
        turn = np.arctan2((across * upwards).sum(-1), (across * level).sum(-1))
        return np.asarray(turn / (2 * np.pi) % 1.0)

    def _any_turn(self) -> MapArrays:
        """Return the map that scores each line by its best tool turn."""
        return replace(self, turned=None)._arrays()

    def _axis(self) -> Point:
        return Point(float(self.axis_xy[0]), float(self.axis_xy[1]))

    def lines(self, Ts: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 6"]:
        """Return the last axis of tool poses in their frame: a point [m] and a direction."""
        Ts = np.asarray(Ts, float)
        direction = Ts[..., :3, :3] @ self.line_tool[0]
        point = Ts[..., :3, :3] @ self.line_tool[1] + Ts[..., :3, 3]
        return np.concatenate([point, direction], -1)

    def score(self, Ts_base_tool: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, " *batch"]:
        """Score tool poses: 0 for unreachable, 1 from four cells inside the boundary on.

        Args:
            Ts_base_tool: Tool poses in the base frame, z up from the floor.
        """
        lines = self.lines(Ts_base_tool)
        batch = lines.shape[:-1]
        lines = np.ascontiguousarray(lines.reshape(-1, 6))
        lines[:, :2] -= self.axis_xy
        out = np.empty(len(lines))
        score_lines(lines, self.turns(Ts_base_tool).reshape(-1), self._arrays(), out)
        return out.reshape(batch)

    def min_score(
        self, bases: Float[np.ndarray, "n 3"], Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    ) -> Float[np.ndarray, "n g"]:
        """Return the worst score along each grasp's waypoints, for each base pose.

        Args:
            bases: x, y [m], yaw [rad] of the base on the floor, in the world frame.
            Ts_world_tool: Tool poses of g grasps at w waypoints.
        """
        # Evaluate the last waypoint first: it rules out most base poses that the first one leaves.
        Ts_world_tool = np.roll(np.asarray(Ts_world_tool, float), 1, axis=1)
        lines = np.ascontiguousarray(self.lines(Ts_world_tool))
        bases = np.ascontiguousarray(bases, float)
        out = np.empty((len(bases), len(lines)), np.float32)
        turn = np.ascontiguousarray(self.turns(Ts_world_tool))
        block = max(1, MAX_LOOKUPS // max(1, lines[..., 0].size))
        for first in range(0, len(bases), block):
            part = slice(first, first + block)
            min_line_scores(bases[part], lines, turn, self._axis(), self._arrays(), out[part])
        return out

    def score_base_poses(
        self, base_poses: Float[np.ndarray, "n 3"], T_world_tool: Float[np.ndarray, "4 4"]
    ) -> Float[np.ndarray, " n"]:
        """Score base poses for one tool pose, see `score`.

        Args:
            base_poses: x, y [m], yaw [rad] of the base on the floor, in the world frame.
            T_world_tool: Tool pose in the world frame.
        """
        return self.min_score(base_poses, np.asarray(T_world_tool, float)[None, None])[:, 0]

    def base_scores(
        self,
        T_world_tool: Float[np.ndarray, "4 4"],
        xs: Float[np.ndarray, " columns"],
        ys: Float[np.ndarray, " rows"],
    ) -> Float[np.ndarray, "rows columns"]:
        """Score base positions on a floor grid for one tool pose, each at the best of 12 yaws.

        Positions of the first axis are interpolated between points 6 cm apart: scores differ from
        `score` by 0.01 on average and by at most 0.15.

        Args:
            T_world_tool: Tool pose in the world frame.
            xs: x coordinates of the bases [m].
            ys: y coordinates of the bases [m].
        """
        line = self.lines(T_world_tool)
        xs, ys = np.ascontiguousarray(xs, float), np.ascontiguousarray(ys, float)
        out = np.empty((len(ys), len(xs)), np.float32)
        floor = FloorGrid(xs, ys, _YAWS)
        floor_scores(line, floor, self._axis(), self._any_turn(), self._rims, out)
        return out

    @cached_property
    def _rims(self) -> Int[np.ndarray, " z"]:
        """For each height, the smallest r beyond which all values are `OUTSIDE` [cells]."""
        near = (self.values > OUTSIDE).any((2, 3, 4))
        return (near * np.arange(1, near.shape[1] + 1)).max(1)
