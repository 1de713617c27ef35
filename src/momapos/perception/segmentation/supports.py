"""Find surfaces that objects stand on: tops of counters, tables, ovens, seats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from momapos.core import InputError
from momapos.model.records import Cloud

from .room_shell import RoomShell, peaks

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MAX_CELLS = 200_000_000
"""Larger rooms are refused: the scan contains something far away."""
MAX_ASPECT = 1.2
"""Larger ratio of depth to width is not furniture of a row but the arm of a corner [-]."""

Rectangle = tuple[float, float, float, float]
"""Low x, low y, high x, high y [m]."""
_Cells = tuple[int, int, int, int]
"""Low x, low y, high x, high y (exclusive), in cells of a raster."""
MAX_HOLE = 0.6
"""Holes up to this area are filled: sinks, and objects on the surface [m2]."""
OUTLINE_CELL = 0.03
"""Edge length of the floor cells of outlines [m]."""
SURFACE_LAYER = 0.015
"""Height of the cells in which surfaces are grown [m]; larger steps than two cells divide."""
MIN_SUPPORT_AREA = 0.06
"""Minimum area [m2]."""
MIN_SUPPORT_HEIGHT = 0.25
"""Minimum height above the floor [m]."""
MAX_SUPPORT_HEIGHT = 1.9
"""Maximum height; cameras are rarely above it [m]."""
HALF_CLOSED_GAP = 0.15
"""Gaps in an outline up to twice this are closed: objects hide the surface [m]."""
MAX_BASIN_DEPTH = 0.35
"""A surface in the hole of another one is its basin if at most this much lower [m]."""


@dataclass(frozen=True, eq=False)
class FloorRaster:
    """A raster of the floor."""

    low: Float[np.ndarray, "2"]
    shape: tuple[int, int]
    cell: float

    def cells(self, points: Float[np.ndarray, "n d"]) -> Int[np.ndarray, "n 2"]:
        """Return the cell below each point, clipped to the raster."""
        at = np.floor((points[:, :2] - self.low) / self.cell).astype(int)
        return np.clip(at, 0, np.array(self.shape) - 1)

    def within(
        self, mask: Bool[np.ndarray, "x y"], points: Float[np.ndarray, "n d"]
    ) -> Bool[np.ndarray, " n"]:
        """Tell which points are above or below the cells of a mask."""
        at = self.cells(points)
        return mask[at[:, 0], at[:, 1]]

    def drawn(self, points: Float[np.ndarray, "n d"]) -> Bool[np.ndarray, "x y"]:
        """Return the cells with points."""
        mask = np.zeros(self.shape, bool)
        at = self.cells(points)
        mask[at[:, 0], at[:, 1]] = True
        return mask

    def filled(self, box: Rectangle) -> Bool[np.ndarray, "x y"]:
        """Return the cells whose centers are in a rectangle."""
        mask = np.zeros(self.shape, bool)
        start = np.ceil((np.array(box[:2]) - self.low) / self.cell - 0.5).astype(int)
        stop = np.ceil((np.array(box[2:]) - self.low) / self.cell - 0.5).astype(int)
        start = np.maximum(start, 0)
        mask[start[0] : max(stop[0], 0), start[1] : max(stop[1], 0)] = True
        return mask


@dataclass(frozen=True, eq=False)
class Support:
    """A horizontal surface."""

    height: float
    """Height above the floor [m]."""
    outline: Bool[np.ndarray, "x y"]
    """Its cells, including hidden ones."""
    members: Int[np.ndarray, " k"]
    """Indices of its points."""


def floor_raster(points: Float[np.ndarray, "n 3"], cell: float) -> FloorRaster:
    """Return a raster around all points, with a margin of half a meter."""
    low = points[:, :2].min(axis=0) - 0.5
    shape = np.ceil((points[:, :2].max(axis=0) + 0.5 - low) / cell).astype(int)
    if float(shape[0]) * float(shape[1]) > MAX_CELLS / 100:
        raise InputError(_too_wide(shape * cell))
    return FloorRaster(low, (int(shape[0]), int(shape[1])), cell)


def _too_wide(extent: Float[np.ndarray, " d"]) -> str:
    size = " x ".join(f"{edge:.0f}" for edge in extent)
    return f"the cloud spans {size} m, too much for one room; crop it to the room"


def components(
    points: Float[np.ndarray, "n 3"], cell: float | tuple[float, float, float]
) -> Int[np.ndarray, " n"]:
    """Number groups of points whose cells touch, corners included, from 0; largest first."""
    if not len(points):
        return np.zeros(0, int)
    at = np.floor((points - points.min(axis=0)) / np.asarray(cell)).astype(np.int64) + 1
    shape = at.max(axis=0) + 2
    if np.prod(shape.astype(float)) > MAX_CELLS:
        raise InputError(_too_wide(np.ptp(points, axis=0)))
    grid = np.zeros(tuple(shape), bool)
    grid[tuple(at.T)] = True
    labels, _ = ndimage.label(grid, np.ones((3, 3, 3)))
    label = labels[tuple(at.T)] - 1
    order = np.argsort(-np.bincount(label), kind="stable")
    rank = np.empty(len(order), int)
    rank[order] = np.arange(len(order))
    return rank[label]


def find_supports(
    cloud: Cloud,
    room: RoomShell,
    among: Int[np.ndarray, " m"],
    raster: FloorRaster,
) -> list[Support]:
    """Find surfaces that face up, highest first.

    Args:
        cloud: Upright.
        room: Walls, at which hidden parts of surfaces end.
        among: Indices of the points to use.
        raster: Raster of the whole cloud.
    """
    z = cloud.points[among, 2]
    flat = (cloud.normals[among, 2] > 0.9) & (z > MIN_SUPPORT_HEIGHT) & (z < MAX_SUPPORT_HEIGHT)
    members = among[flat]
    label = components(cloud.points[members], (OUTLINE_CELL, OUTLINE_CELL, SURFACE_LAYER))
    if not len(label):
        return []
    least = int(MIN_SUPPORT_AREA / OUTLINE_CELL**2 / 4)
    groups = []
    for k in range(label.max() + 1):
        group = members[label == k]
        if len(group) < least:
            break
        heights = cloud.points[group, 2]
        for height in peaks(heights, SURFACE_LAYER, least, 2 * SURFACE_LAYER):
            groups.append(group[np.abs(heights - height) < SURFACE_LAYER])
    merged = _same_height(groups, cloud, raster)
    supports = []
    for group in merged:
        seen = raster.drawn(cloud.points[group])
        if seen.sum() * OUTLINE_CELL**2 >= MIN_SUPPORT_AREA:
            height = float(np.median(cloud.points[group, 2]))
            supports.append(Support(height, _hidden_too(seen, room, raster), group))
    supports.sort(key=lambda support: -support.height)
    return [s for k, s in enumerate(supports) if not _is_basin(s, supports[:k])]


def _is_basin(support: Support, higher: Sequence[Support]) -> bool:
    """Check whether a surface is the bottom of a hole in a higher one, like a sink's."""
    size = support.outline.sum()
    return any(
        other.height - support.height < MAX_BASIN_DEPTH
        and (support.outline & other.outline).sum() > 0.7 * size
        for other in higher
    )


def _same_height(
    groups: Sequence[Int[np.ndarray, " _"]],
    cloud: Cloud,
    raster: FloorRaster,
) -> list[Int[np.ndarray, " _"]]:
    """Merge pieces of one surface that objects divide."""
    merged: list[tuple[float, Bool[np.ndarray, "x y"], list[Int[np.ndarray, " _"]]]] = []
    reach = _square(HALF_CLOSED_GAP, OUTLINE_CELL)
    for group in groups:
        height = float(np.median(cloud.points[group, 2]))
        mask = ndimage.binary_dilation(raster.drawn(cloud.points[group]), reach)
        for k, (other, reached, pieces) in enumerate(merged):
            if abs(height - other) < SURFACE_LAYER and (reached & mask).any():
                merged[k] = (other, reached | mask, [*pieces, group])
                break
        else:
            merged.append((height, mask, [group]))
    return [np.concatenate(pieces) for _, _, pieces in merged]


def _square(radius: float, cell: float) -> Bool[np.ndarray, "k k"]:
    side = 2 * max(1, round(radius / cell)) + 1
    return np.ones((side, side), bool)


def _hidden_too(
    seen: Bool[np.ndarray, "x y"], room: RoomShell, raster: FloorRaster
) -> Bool[np.ndarray, "x y"]:
    """Fill gaps, holes, and notches that end at a wall: objects hide the surface there."""
    outside = np.zeros_like(seen)
    for wall in room.walls:
        edge = [wall.low - 0.1, wall.high + 0.1]
        strip = sorted([wall.offset, wall.offset - wall.sign * 0.5])
        across = (strip[0], edge[0], strip[1], edge[1])
        along = (edge[0], strip[0], edge[1], strip[1])
        outside |= raster.filled(across if wall.axis == 0 else along)
    radius = round(HALF_CLOSED_GAP / OUTLINE_CELL)
    padded = np.pad(seen | outside, radius + 1)
    closed = ndimage.binary_closing(padded, _square(HALF_CLOSED_GAP, OUTLINE_CELL))
    closed = closed[radius + 1 : -radius - 1, radius + 1 : -radius - 1]
    closed &= ndimage.binary_dilation(seen, _square(2 * HALF_CLOSED_GAP, OUTLINE_CELL))
    holes, count = ndimage.label(~(closed | outside))
    sizes = np.bincount(holes.ravel(), minlength=count + 1) * OUTLINE_CELL**2
    small = sizes < MAX_HOLE
    small[0] = False
    filled = (closed | small[holes]) & ~outside
    labels, _ = ndimage.label(filled, np.ones((3, 3)))
    return filled & np.isin(labels, np.unique(labels[seen & filled]))


def rectangles(
    mask: Bool[np.ndarray, "x y"], raster: FloorRaster, least: float = 0.2, deepest: float = 1.0
) -> list[Rectangle]:
    """Cover an outline by rectangles that do not overlap, largest first.

    Where two arms of a row meet in a corner, the corner is a rectangle of its own, because neither
    arm's fronts reach into it. Where one piece of a row is deeper than its neighbors, its rectangle
    reaches from its front to the wall.

    Args:
        mask: The outline.
        raster: Raster of the outline.
        least: Minimum length of sides [m]; smaller remains are dropped.
        deepest: Maximum depth of a piece of a row [m].
    """
    rest = mask.copy()
    cells: list[_Cells] = []
    shortest = max(1, round(least / raster.cell))
    while rest.any():
        box = _largest(rest)
        if min(box[2] - box[0], box[3] - box[1]) < shortest:
            break
        cells.append(box)
        rest[box[0] : box[2], box[1] : box[3]] = False
    x, y = raster.low
    c = raster.cell
    cells = _to_the_wall(_cut_at_corners(cells, shortest), shortest, deepest / c)
    boxes = [(x + a * c, y + b * c, x + d * c, y + e * c) for a, b, d, e in cells]
    return sorted(boxes, key=lambda r: -(r[2] - r[0]) * (r[3] - r[1]))


def _to_the_wall(cells: list[_Cells], shortest: int, deepest: float) -> list[_Cells]:
    """Merge the front and the rear of pieces that are deeper than their neighbors.

    The rear may be up to `shortest` narrower where taller neighbors hide it, but not where there
    is another rectangle.
    """
    out: list[_Cells] = []
    for j, box in enumerate(cells):
        for k, other in enumerate(out):
            low, high = np.minimum(box[:2], other[:2]), np.maximum(box[2:], other[2:])
            size = high - low
            ends = np.abs(np.subtract(box, other)).reshape(2, 2).max(axis=0)
            behind = (size == np.add(_size(box), _size(other))) & (ends[::-1] < shortest)
            behind &= (size <= deepest) & (size <= MAX_ASPECT * size[::-1])
            rest = np.array([*out[:k], *out[k + 1 :], *cells[j + 1 :]]).reshape(-1, 4)
            free = (rest[:, :2] >= high) | (rest[:, 2:] <= low)
            if behind.any() and free.any(axis=1).all():
                out[k] = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
                break
        else:
            out.append(box)
    return out


def _size(box: _Cells) -> tuple[int, int]:
    return box[2] - box[0], box[3] - box[1]


def _largest(mask: Bool[np.ndarray, "x y"]) -> _Cells:
    best, area = (0, 0, 0, 0), 0
    xs = np.flatnonzero(mask.any(axis=1))
    for start in range(xs[0], xs[-1] + 1):
        common = np.ones(mask.shape[1], bool)
        for stop in range(start + 1, xs[-1] + 2):
            common = common & mask[stop - 1]
            if common.sum() * (xs[-1] + 1 - start) <= area:
                break
            edges = np.flatnonzero(np.diff(np.pad(common, 1).astype(np.int8)))
            if not len(edges):
                break
            runs = edges[1::2] - edges[::2]
            k = int(np.argmax(runs))
            if runs[k] * (stop - start) > area:
                area = int(runs[k]) * (stop - start)
                best = (start, int(edges[2 * k]), stop, int(edges[2 * k + 1]))
    return best


def _cut_at_corners(cells: list[_Cells], shortest: int) -> list[_Cells]:
    """Cut a rectangle where another one that meets its long side ends."""
    out: list[_Cells] = []
    for k, box in enumerate(cells):
        axis = 0 if box[2] - box[0] >= box[3] - box[1] else 1
        low, high = box[axis], box[axis + 2]
        cuts = set()
        for other in cells[:k] + cells[k + 1 :]:
            side = 1 - axis
            touches = abs(other[side] - box[side + 2]) <= 1 or abs(other[side + 2] - box[side]) <= 1
            along = min(high, other[axis + 2]) - max(low, other[axis]) >= shortest
            if touches and along and other[axis + 2] - other[axis] < high - low - shortest:
                cuts |= {other[axis], other[axis + 2]}
        edges = [low]
        for cut in [*sorted(cuts), high]:
            if cut - edges[-1] >= shortest and (cut == high or high - cut >= shortest):
                edges.append(cut)
        edges[-1] = high
        for a, b in pairwise(edges):
            piece = list(box)
            piece[axis], piece[axis + 2] = a, b
            out.append((piece[0], piece[1], piece[2], piece[3]))
    return out
