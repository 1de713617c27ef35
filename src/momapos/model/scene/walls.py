"""Walls: solid upright boxes, given by segments or by the floor's outline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError, finite_array, finite_number
from momapos.core.geometry import any_overlap, signed_area

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

WALL_HEIGHT, WALL_THICKNESS = 2.5, 0.1
"""Default height and thickness of a wall; also the height of what a map shows as occupied [m]."""
MIN_LENGTH = 1e-3
"""Minimum length, height and thickness of a wall [m]."""
MAX_LENGTH, MAX_HEIGHT, MAX_THICKNESS = 1e3, 100.0, 10.0
"""Maximum sizes of a wall [m]."""
MAX_DISTANCE = 1e4
"""Maximum distance of an end from the world's origin [m]."""
_THINNER = (WALL_THICKNESS, 0.05, 0.02, 0.01)
"""Thicknesses of a wall along the floor, the first that leaves the floor free [m]."""
_INSET = 2e-3
"""A wall that reaches less into the floor counts as outside [m]."""


@dataclass(frozen=True)
class Wall:
    """A solid wall on the floor; its center line is the segment between two points.

    Raises:
        SceneError: A number is not finite or out of range, or both ends are at one point.
    """

    start: tuple[float, float]
    """One end of the center line: x, y [m]."""
    end: tuple[float, float]
    """The other end: x, y [m]."""
    height: float = WALL_HEIGHT
    """Height above the floor [m]."""
    thickness: float = WALL_THICKNESS
    """Thickness, half of it on either side of the center line [m]."""

    def __post_init__(self) -> None:
        for name in ("start", "end"):
            x, y = finite_array(f"Wall.{name}", getattr(self, name), (2,)).tolist()
            if max(abs(x), abs(y)) > MAX_DISTANCE:
                raise SceneError(
                    f"Wall.{name} must be within 10 km of the origin, not {x:g}, {y:g}"
                )
            object.__setattr__(self, name, (x, y))
        for name, most in (("height", MAX_HEIGHT), ("thickness", MAX_THICKNESS)):
            value = finite_number(f"Wall.{name}", getattr(self, name), MIN_LENGTH, most)
            object.__setattr__(self, name, value)
        if not MIN_LENGTH <= self.length <= MAX_LENGTH:
            raise SceneError(
                f"Wall from {self.start} to {self.end} is {self.length:g} m long; it must be "
                f"{MIN_LENGTH:g} to {MAX_LENGTH:g} m"
            )

    @property
    def length(self) -> float:
        """Return the length of the center line [m]."""
        return math.dist(self.start, self.end)

    @property
    def size(self) -> tuple[float, float, float]:
        """Return length, thickness and height [m]."""
        return self.length, self.thickness, self.height

    @property
    def center(self) -> tuple[float, float, float]:
        """Return the middle of the box in the world [m]."""
        (x, y), (u, v) = self.start, self.end
        return (x + u) / 2, (y + v) / 2, self.height / 2

    @property
    def yaw(self) -> float:
        """Return the direction of the center line [rad]."""
        return math.atan2(self.end[1] - self.start[1], self.end[0] - self.start[0])


def wall_name(index: int) -> str:
    """Return the name of a wall's object by its index from 0."""
    return f"wall_{index + 1}"


def walls_around(floor: Float[np.ndarray, "k 2"]) -> tuple[Wall, ...]:
    """Return walls along all edges of a floor, just outside of it, so that it stays free.

    A wall is thinner where the floor continues behind it, and longer at an outer corner, which it
    fills.

    Args:
        floor: Corners of a simple polygon [m].
    """
    polygon = floor if signed_area(floor) > 0 else floor[::-1]
    polygon = polygon[np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1) > MIN_LENGTH]
    corner = np.roll(polygon, -1, axis=0)
    edge = corner - polygon
    along = edge / np.linalg.norm(edge, axis=1)[:, None]
    after = np.roll(along, -1, axis=0)
    outer = along[:, 0] * after[:, 1] - along[:, 1] * after[:, 0] > 0.0
    away = np.stack([along[:, 1], -along[:, 0]], axis=1)
    thickness, extension = np.full(len(polygon), _THINNER[-1]), np.zeros(len(polygon))
    left = np.ones(len(polygon), bool)
    for t in _THINNER:
        for longer in (t * outer, np.zeros(len(polygon))):
            end = corner + longer[:, None] * along
            free = left & ~_reach_into(floor, polygon, end, along, away, t)
            thickness[free], extension[free] = t, longer[free]
            left &= ~free
    shift = thickness[:, None] / 2 * away
    first, last = polygon + shift, corner + extension[:, None] * along + shift
    return tuple(
        Wall(tuple(a), tuple(b), WALL_HEIGHT, t)
        for a, b, t in zip(first.tolist(), last.tolist(), thickness.tolist(), strict=True)
    )


def _reach_into(
    floor: Float[np.ndarray, "k 2"],
    start: Float[np.ndarray, "n 2"],
    end: Float[np.ndarray, "n 2"],
    along: Float[np.ndarray, "n 2"],
    away: Float[np.ndarray, "n 2"],
    thickness: float,
) -> Bool[np.ndarray, " n"]:
    """Return which walls outside of the edges from start to end would reach into the floor."""
    near, far = _INSET * away, (thickness - _INSET) * away
    start, end = start + _INSET * along, end - _INSET * along
    return any_overlap(floor, np.stack([start + near, end + near, end + far, start + far], axis=1))


def check_crossing(walls: Sequence[Wall], where: str) -> None:
    """Check that no two walls cross away from their ends.

    Raises:
        SceneError: Two walls cross; the message starts with `where`.
    """
    if not walls:
        return
    a, b = np.array([w.start for w in walls]), np.array([w.end for w in walls])
    d, length = b - a, np.array([w.length for w in walls])
    cross = d[:, None, 0] * d[None, :, 1] - d[:, None, 1] * d[None, :, 0]
    offset = a[None] - a[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        # The lines meet at the shares s and t of their segments.
        s = (offset[..., 0] * d[None, :, 1] - offset[..., 1] * d[None, :, 0]) / cross
        t = (offset[..., 0] * d[:, None, 1] - offset[..., 1] * d[:, None, 0]) / cross
    thick = np.array([w.thickness for w in walls])
    # Walls that meet at an end may overlap by their thickness there.
    reach = np.maximum(thick[:, None], thick[None])
    inside = (np.minimum(s, 1 - s) * length[:, None] > reach) & (
        np.minimum(t, 1 - t) * length[None] > reach
    )
    rows = np.argwhere(np.triu(inside & np.isfinite(s) & np.isfinite(t), 1))
    if len(rows):
        i, j = rows[0].tolist()
        x, y = a[i] + s[i, j] * d[i]
        raise SceneError(
            f"{where}: {wall_name(i)} and {wall_name(j)} cross at ({x:.3g}, {y:.3g}); a wall may "
            f"end at another one, so split {wall_name(i)} there"
        )
