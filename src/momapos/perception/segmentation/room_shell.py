"""The room around the furniture: floor, ceiling and walls of an upright scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import Cloud

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


@dataclass(frozen=True)
class Wall:
    """A wall along x or y."""

    axis: int
    """0 where its normal is along x, 1 along y."""
    sign: float
    """+1 where the room is on the side of larger coordinates, else -1."""
    offset: float
    """Its coordinate along the axis [m]."""
    low: float
    """Where it begins along the other axis [m]."""
    high: float
    """Where it ends [m]."""
    top: float
    """How high it was seen [m]."""

    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """How far points are in front of the wall [m]; negative behind it."""
        return self.sign * (points[:, self.axis] - self.offset)

    def beside(
        self, points: Float[np.ndarray, "n 3"], margin: float = 0.0
    ) -> Bool[np.ndarray, " n"]:
        """Whether points lie between the ends of the wall, or `margin` [m] beyond."""
        along = points[:, 1 - self.axis]
        return (along > self.low - margin) & (along < self.high + margin)


@dataclass(frozen=True)
class Room:
    """What is no furniture; the floor is at z = 0."""

    walls: tuple[Wall, ...] = ()
    ceiling: float | None = None
    """Its height [m]."""


@dataclass(frozen=True)
class RoomConfig:
    """What makes a surface part of the room."""

    wall_length: float = 1.0
    """Walls are at least this long [m]."""
    wall_area: float = 0.4
    """And at least this much of them is seen [m2]."""
    wall_top: float = 1.35
    """And they are seen up to this height, unless nothing in the scan is this high [m]."""
    behind: float = 0.3
    """Share of a wall's length with something behind it, at most: fronts of furniture have walls
    behind them, walls have nothing [-]."""
    depth: tuple[float, float] = (0.08, 2.0)
    """Behind means this far behind [m]: nearer is noise, farther is another room."""
    thickness: float = 0.03
    """Points this near to a plane of the room belong to it [m]."""
    ceiling: float = 2.0
    """Ceilings are at least this high [m]."""


STRIP = 0.1  # [m] of a wall that are judged together
STRAY = 0.2
"""Points behind a strip are strays of it up to this share of its own [-]."""
AT_WALL = 0.15
"""What stands against a wall is no farther from it [m]: skirting boards and hoses are behind it."""
FACING = 0.9
"""Cosine between its normal and that of the wall [-]."""
CELL = 0.05  # [m], of the raster that areas are measured on


def find_room(cloud: Cloud, config: RoomConfig | None = None) -> Room:
    """Find ceiling and walls of an upright cloud."""
    config = config or RoomConfig()
    walls = [
        wall
        for axis in (0, 1)
        for sign in (1.0, -1.0)
        for wall in _walls(cloud, axis, sign, config)
    ]
    return Room(tuple(walls), _ceiling(cloud, config))


def in_room(room: Room, cloud: Cloud, config: RoomConfig | None = None) -> Bool[np.ndarray, " n"]:
    """Whether points belong to floor, ceiling or walls, or lie beyond them."""
    config = config or RoomConfig()
    points, normals = cloud.points, cloud.normals
    thick = config.thickness
    out = (points[:, 2] < thick) | ((points[:, 2] < 2 * thick) & (normals[:, 2] > 0.9))
    if room.ceiling is not None:
        out |= points[:, 2] > room.ceiling - thick
    for wall in room.walls:
        away = wall.distance(points)
        facing = wall.sign * normals[:, wall.axis] > 0.9
        out |= wall.beside(points, 0.5) & (away < np.where(facing, 1.5 * thick, thick))
    return out


def flat_on_wall(room: Room, points: Float[np.ndarray, "n 3"], flat: float) -> bool:
    """Whether points are an image on a wall, or its own unevenness: within `flat` [m] of it."""
    return any(
        np.percentile(wall.distance(points), 95) < flat and bool(wall.beside(points, 0.5).all())
        for wall in room.walls
    )


def at_wall(room: Room, place: Float[np.ndarray, "3"], outward: Float[np.ndarray, "3"]) -> bool:
    """Whether a side of a thing stands against a wall.

    Args:
        room: Its walls.
        place: The middle of the side [m].
        outward: Its normal.
    """
    return any(
        -wall.sign * outward[wall.axis] > FACING
        and bool(wall.beside(place[None], AT_WALL)[0])
        and abs(float(wall.distance(place[None])[0])) < AT_WALL
        for wall in room.walls
    )


def area(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"], cell: float = CELL) -> float:
    """Area that points of a plane cover, as cells of a raster that hold any [m2]."""
    return len(np.unique(cell_numbers(np.stack([a, b], axis=1), cell))) * cell**2


def cell_numbers(points: Float[np.ndarray, "n d"], cell: float) -> Int[np.ndarray, " n"]:
    """A number of the cell of a raster in which each point is; other cells have others."""
    cells = np.floor(points / cell).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    sides = cells.max(axis=0, initial=0) + 1
    return cells @ np.append(np.cumprod(sides[:0:-1])[::-1], 1)


def floor_seen(
    cloud: Cloud, low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"], margin: float = 0.1
) -> float:
    """Share of a rectangle on which the floor was seen, `margin` [m] off its edges [-]."""
    points, thickness = cloud.points, RoomConfig().thickness
    inside = ((points[:, :2] > low + margin) & (points[:, :2] < high - margin)).all(axis=1)
    floor = points[inside & (points[:, 2] < thickness)]
    return area(floor[:, 0], floor[:, 1]) / float(np.prod(high - low))


def ends(values: Float[np.ndarray, " n"], step: float) -> tuple[float, float]:
    """Where values that lie evenly between two ends begin and end.

    Stretches of `step` with less than a third of what is usual hold strays and do not count.
    """
    low = float(values.min())
    bins = np.floor((values - low) / step).astype(int)
    counts = np.bincount(bins)
    full = np.flatnonzero(counts > np.median(counts[counts > 0]) / 3)
    within = values[(bins >= full[0]) & (bins <= full[-1])]
    return float(within.min()), float(within.max())


def peaks(values: Float[np.ndarray, " n"], width: float, least: int, apart: float) -> list[float]:
    """Where values are dense: most first, each at least `apart` from those before.

    Args:
        values: Numbers on a line.
        width: Values within this of each other make a peak.
        least: Number of values in a peak, at least.
        apart: Distance between peaks, at least.
    """
    if len(values) < max(least, 1):
        return []
    step = width / 2
    low = float(values.min()) - step
    bins = np.floor((values - low) / step).astype(int)
    dense = np.convolve(np.bincount(bins), np.ones(2, int), "same")
    found = []
    while dense.max() >= max(least, 1):
        top = int(np.argmax(dense))
        center = low + top * step  # of the bins top - 1 and top
        near = values[np.abs(values - center) <= width]
        found.append(float(np.median(near)) if len(near) else center)
        reach = int(np.ceil(apart / step))
        dense[max(0, top - reach) : top + reach + 1] = 0
    return found


def _walls(cloud: Cloud, axis: int, sign: float, config: RoomConfig) -> list[Wall]:
    """Walls whose normal is one of the four horizontal directions."""
    facing = np.flatnonzero(sign * cloud.normals[:, axis] > 0.9)
    points = cloud.points[facing]
    tall = min(config.wall_top, 0.75 * float(np.percentile(cloud.points[:, 2], 99)))
    walls = []
    for offset in peaks(points[:, axis], 2 * config.thickness, 100, 4 * config.thickness):
        on = points[np.abs(points[:, axis] - offset) < config.thickness]
        along, height = on[:, 1 - axis], on[:, 2]
        low, high = np.percentile(along, [0.2, 99.8])
        middle = np.percentile(along, 95) - np.percentile(along, 5)
        top = float(np.percentile(height, 99))
        if (
            middle >= 0.9 * config.wall_length
            and top >= tall
            and area(along, height) >= config.wall_area
        ):
            wall = Wall(axis, sign, offset, float(low), float(high), top)
            if _share_hiding(wall, along, cloud, config) <= config.behind:
                walls.append(wall)
    return walls


def _share_hiding(
    wall: Wall, along: Float[np.ndarray, " n"], cloud: Cloud, config: RoomConfig
) -> float:
    """Share of the strips of a surface that have something behind them."""
    away = -wall.distance(cloud.points)
    behind = (away > config.depth[0]) & (away < config.depth[1])
    count = int(np.ceil((wall.high - wall.low) / STRIP)) + 1

    def strips(values: Float[np.ndarray, " m"]) -> Int[np.ndarray, " count"]:
        bins = np.floor((values - wall.low) / STRIP).astype(int)
        return np.bincount(bins[(bins >= 0) & (bins < count)], minlength=count)

    seen = strips(along)
    hiding = strips(cloud.points[behind, 1 - wall.axis]) > np.maximum(10, STRAY * seen)
    seen = seen > 3
    return float((seen & hiding).sum() / max(1, seen.sum()))


def _ceiling(cloud: Cloud, config: RoomConfig) -> float | None:
    """Height of the highest large surface that faces down."""
    down = cloud.points[(cloud.normals[:, 2] < -0.9) & (cloud.points[:, 2] > config.ceiling)]
    for z in sorted(peaks(down[:, 2], 0.05, 100, 0.2), reverse=True):
        on = down[np.abs(down[:, 2] - z) < 0.05]
        if area(on[:, 0], on[:, 1]) > 1.0:
            return z
    return None
