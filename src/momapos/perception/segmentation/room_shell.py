"""Find the shell of a room: floor, ceiling and walls of an upright scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import Cloud

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


@dataclass(frozen=True)
class RoomWall:
    """A wall along x or y."""

    axis: int
    """0 if its normal is along x, 1 if along y."""
    sign: float
    """+1 if the room is on the side of larger coordinates, else -1."""
    offset: float
    """Coordinate along the axis [m]."""
    low: float
    """Start along the other axis [m]."""
    high: float
    """End along the other axis [m]."""
    top: float
    """Height up to which it was seen [m]."""

    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return the distance of points in front of the wall [m]; negative behind it."""
        return self.sign * (points[:, self.axis] - self.offset)

    def spans(
        self, points: Float[np.ndarray, "n 3"], margin: float = 0.0
    ) -> Bool[np.ndarray, " n"]:
        """Tell which points lie between the ends of the wall, extended by `margin` [m]."""
        along = points[:, 1 - self.axis]
        return (along > self.low - margin) & (along < self.high + margin)


@dataclass(frozen=True)
class RoomShell:
    """Walls and ceiling of a room; the floor is at z = 0."""

    walls: tuple[RoomWall, ...] = ()
    ceiling: float | None = None
    """Height of the ceiling [m]."""


MIN_WALL_AREA = 0.4
"""Minimum seen area of a wall [m2]."""
MIN_WALL_LENGTH = 1.0
"""Minimum length of a wall [m]."""
MIN_WALL_TOP = 1.35
"""Minimum seen height of a wall, unless nothing in the scan is this high [m]."""
MAX_OPEN_BEHIND = 0.3
"""Maximum share of a wall's length with something behind it: furniture fronts have walls behind
them, walls have nothing [-]."""
BEHIND_RANGE = (0.08, 2.0)
"""Range of "behind" [m]: closer is noise, farther is another room."""
SHELL_THICKNESS = 0.03
"""Points this close to a plane of the shell belong to it [m]."""
MIN_CEILING = 2.0
"""Minimum height of a ceiling [m]."""
STRIP = 0.1
"""Width of the strips of a wall that are checked for points behind them [m]."""
MAX_STRAY = 0.2
"""Points behind a strip are strays up to this share of the strip's own [-]."""
MAX_WALL_DISTANCE = 0.15
"""Objects at a wall are no farther from it [m]: skirting boards and hoses are behind them."""
MIN_COSINE = 0.9
"""Between the normal of an object's back and that of the wall [-]."""
CELL = 0.05
"""Raster cell for the measurement of areas [m]."""


def find_room(cloud: Cloud) -> RoomShell:
    """Find ceiling and walls of an upright cloud."""
    walls = [wall for axis in (0, 1) for sign in (1.0, -1.0) for wall in _walls(cloud, axis, sign)]
    return RoomShell(tuple(walls), _ceiling(cloud))


def in_room(room: RoomShell, cloud: Cloud) -> Bool[np.ndarray, " n"]:
    """Tell which points belong to floor, ceiling or walls, or lie beyond them."""
    points, normals = cloud.points, cloud.normals
    thick = SHELL_THICKNESS
    out = (points[:, 2] < thick) | ((points[:, 2] < 2 * thick) & (normals[:, 2] > 0.9))
    if room.ceiling is not None:
        out |= points[:, 2] > room.ceiling - thick
    for wall in room.walls:
        away = wall.distance(points)
        facing = wall.sign * normals[:, wall.axis] > 0.9
        out |= wall.spans(points, 0.5) & (away < np.where(facing, 1.5 * thick, thick))
    return out


def flat_on_wall(room: RoomShell, points: Float[np.ndarray, "n 3"], flat: float) -> bool:
    """Check whether points belong to a wall, like a picture: within `flat` [m] of it."""
    return any(
        np.percentile(wall.distance(points), 95) < flat and bool(wall.spans(points, 0.5).all())
        for wall in room.walls
    )


def at_wall(
    room: RoomShell, place: Float[np.ndarray, "3"], outward: Float[np.ndarray, "3"]
) -> bool:
    """Check whether a side of an object stands against a wall.

    Args:
        room: The walls.
        place: Middle of the side [m].
        outward: Normal of the side.
    """
    return any(
        -wall.sign * outward[wall.axis] > MIN_COSINE
        and bool(wall.spans(place[None], MAX_WALL_DISTANCE)[0])
        and abs(float(wall.distance(place[None])[0])) < MAX_WALL_DISTANCE
        for wall in room.walls
    )


def area(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"], cell: float = CELL) -> float:
    """Return the area that coplanar points cover, measured in raster cells [m2]."""
    return len(np.unique(cell_numbers(np.stack([a, b], axis=1), cell))) * cell**2


def cell_numbers(points: Float[np.ndarray, "n d"], cell: float) -> Int[np.ndarray, " n"]:
    """Return the number of each point's raster cell; different cells have different numbers."""
    cells = np.floor(points / cell).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    sides = cells.max(axis=0, initial=0) + 1
    return cells @ np.append(np.cumprod(sides[:0:-1])[::-1], 1)


def floor_seen(
    cloud: Cloud, low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"], margin: float = 0.1
) -> float:
    """Return the share of a rectangle on which the floor was seen, `margin` [m] off its edges."""
    points, thickness = cloud.points, SHELL_THICKNESS
    inside = ((points[:, :2] > low + margin) & (points[:, :2] < high - margin)).all(axis=1)
    floor = points[inside & (points[:, 2] < thickness)]
    return area(floor[:, 0], floor[:, 1]) / float(np.prod(high - low))


def ends(values: Float[np.ndarray, " n"], step: float) -> tuple[float, float]:
    """Return where evenly distributed values start and end.

    Stretches of `step` with less than a third of the median count are strays and do not count.
    """
    low = float(values.min())
    bins = np.floor((values - low) / step).astype(int)
    counts = np.bincount(bins)
    full = np.flatnonzero(counts > np.median(counts[counts > 0]) / 3)
    within = values[(bins >= full[0]) & (bins <= full[-1])]
    return float(within.min()), float(within.max())


def peaks(values: Float[np.ndarray, " n"], width: float, least: int, apart: float) -> list[float]:
    """Return where values are dense: densest first, each at least `apart` from those before.

    Args:
        values: Numbers on a line.
        width: Values within this of each other form a peak.
        least: Minimum number of values in a peak.
        apart: Minimum distance between peaks.
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


def _walls(cloud: Cloud, axis: int, sign: float) -> list[RoomWall]:
    facing = np.flatnonzero(sign * cloud.normals[:, axis] > 0.9)
    points = cloud.points[facing]
    tall = min(MIN_WALL_TOP, 0.75 * float(np.percentile(cloud.points[:, 2], 99)))
    walls = []
    for offset in peaks(points[:, axis], 2 * SHELL_THICKNESS, 100, 4 * SHELL_THICKNESS):
        on = points[np.abs(points[:, axis] - offset) < SHELL_THICKNESS]
        along, height = on[:, 1 - axis], on[:, 2]
        low, high = np.percentile(along, [0.2, 99.8])
        middle = np.percentile(along, 95) - np.percentile(along, 5)
        top = float(np.percentile(height, 99))
        if middle >= 0.9 * MIN_WALL_LENGTH and top >= tall and area(along, height) >= MIN_WALL_AREA:
            wall = RoomWall(axis, sign, offset, float(low), float(high), top)
            if _share_hiding(wall, along, cloud) <= MAX_OPEN_BEHIND:
                walls.append(wall)
    return walls


def _share_hiding(wall: RoomWall, along: Float[np.ndarray, " n"], cloud: Cloud) -> float:
    """Return the share of a surface's strips that have something behind them."""
    away = -wall.distance(cloud.points)
    behind = (away > BEHIND_RANGE[0]) & (away < BEHIND_RANGE[1])
    count = int(np.ceil((wall.high - wall.low) / STRIP)) + 1

    def strips(values: Float[np.ndarray, " m"]) -> Int[np.ndarray, " count"]:
        bins = np.floor((values - wall.low) / STRIP).astype(int)
        return np.bincount(bins[(bins >= 0) & (bins < count)], minlength=count)

    seen = strips(along)
    hiding = strips(cloud.points[behind, 1 - wall.axis]) > np.maximum(10, MAX_STRAY * seen)
    seen = seen > 3
    return float((seen & hiding).sum() / max(1, seen.sum()))


def _ceiling(cloud: Cloud) -> float | None:
    down = cloud.points[(cloud.normals[:, 2] < -0.9) & (cloud.points[:, 2] > MIN_CEILING)]
    for z in sorted(peaks(down[:, 2], 0.05, 100, 0.2), reverse=True):
        on = down[np.abs(down[:, 2] - z) < 0.05]
        if area(on[:, 0], on[:, 1]) > 1.0:
            return z
    return None
