"""An open door or flap, as a rectangle that turns about one of its edges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert, pose, rotation_about

from .scans import PartKind

if TYPE_CHECKING:
    from jaxtyping import Float

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class OpenLeaf:
    """An open leaf in the world.

    When closed, its outer face is the rectangle from `corner` along `along` and `across`, with
    normal `out`.
    """

    corner: Float[np.ndarray, "3"]
    """Corner of the closed outer face at the hinge [m]."""
    along: Float[np.ndarray, "3"]
    """Unit vector from the hinge to the free edge."""
    out: Float[np.ndarray, "3"]
    """Unit normal of the closed outer face, out of the furniture."""
    size: tuple[float, float]
    """Size along `along` and `across` [m]."""
    pivot: Float[np.ndarray, "3"]
    """Point on the axis [m]."""
    value: float
    """Opening angle [rad]."""
    thickness: float
    """[m]"""

    @property
    def axis(self) -> Float[np.ndarray, "3"]:
        """Return the unit axis about which positive values open the leaf."""
        return np.cross(self.along, self.out)

    @property
    def across(self) -> Float[np.ndarray, "3"]:
        """Return the unit vector along the hinge: up, or to the side."""
        axis = self.axis
        return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))

    @property
    def normal(self) -> Float[np.ndarray, "3"]:
        """Return the unit normal of the outer face of the open leaf."""
        return np.asarray(np.cos(self.value) * self.out - np.sin(self.value) * self.along)

    @property
    def upright(self) -> bool:
        """Return whether the axis is vertical: a door, not a flap."""
        return bool(abs(self.axis @ UP) > np.sqrt(0.5))

    @property
    def kind(self) -> PartKind:
        """Return how the leaf opens, as seen from outside."""
        if not self.upright:
            return "door_down" if self.along @ UP > 0.0 else "door_up"
        return "door_left" if self.along @ np.cross(UP, self.out) > 0.0 else "door_right"

    @property
    def T_closed_open(self) -> Float[np.ndarray, "4 4"]:
        """Return the transform that closes the open leaf."""
        R = rotation_about(self.axis, np.array(self.value))
        return invert(pose(self.pivot - R @ self.pivot, R))

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        """Return the center of the closed outer face [m]."""
        width, height = self.size
        return self.world(np.array([[width / 2, 0.0, height / 2]]))[0]

    def local(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Map world points to coordinates `along`, `out` and `across` the closed leaf [m]."""
        return (points - self.corner) @ np.stack([self.along, self.out, self.across], axis=1)

    def world(self, local: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Map coordinates of the closed leaf to world points, the inverse of `local`."""
        return self.corner + local @ np.stack([self.along, self.out, self.across])

    def to_closed(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Map world points on the open leaf to `local` coordinates on the closed one [m]."""
        return self.local(apply(self.T_closed_open, points))
