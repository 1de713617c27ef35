"""A door or flap that stands open, as a rectangle that turns about one of its edges."""

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
    """A leaf that stands open, in the world.

    Shut, its outer face is the rectangle from `corner` along `along` and `across`; it looks toward
    `out`.
    """

    corner: Float[np.ndarray, "3"]
    """At its hinge [m]."""
    along: Float[np.ndarray, "3"]
    """Unit vector from the hinge to the free edge."""
    out: Float[np.ndarray, "3"]
    """Unit vector out of the furniture."""
    size: tuple[float, float]
    """Along `along` and `across` [m]."""
    pivot: Float[np.ndarray, "3"]
    """On its axis [m]."""
    value: float
    """How far it is open [rad]."""
    thickness: float
    """[m]"""

    @property
    def axis(self) -> Float[np.ndarray, "3"]:
        """Unit vector about which it opens with a positive value."""
        return np.cross(self.along, self.out)

    @property
    def across(self) -> Float[np.ndarray, "3"]:
        """Unit vector along the hinge: up, or to the side."""
        axis = self.axis
        return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))

    @property
    def looks(self) -> Float[np.ndarray, "3"]:
        """Unit vector toward which its outer face looks now."""
        return np.asarray(np.cos(self.value) * self.out - np.sin(self.value) * self.along)

    @property
    def upright(self) -> bool:
        """Whether its axis is: it is a door then, and no flap."""
        return bool(abs(self.axis @ UP) > np.sqrt(0.5))

    @property
    def kind(self) -> PartKind:
        """How it opens, as seen from outside."""
        if not self.upright:
            return "door_down" if self.along @ UP > 0.0 else "door_up"
        return "door_left" if self.along @ np.cross(UP, self.out) > 0.0 else "door_right"

    @property
    def T_shut_open(self) -> Float[np.ndarray, "4 4"]:
        """Moves what is on the open leaf to where it is when this is shut."""
        R = rotation_about(self.axis, np.array(self.value))
        return invert(pose(self.pivot - R @ self.pivot, R))

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        """Of its outer face, shut [m]."""
        width, height = self.size
        return self.world(np.array([[width / 2, 0.0, height / 2]]))[0]

    def local(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """World points by their place along the shut leaf, out of it, and along its hinge [m]."""
        return (points - self.corner) @ np.stack([self.along, self.out, self.across], axis=1)

    def world(self, local: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The other way round."""
        return self.corner + local @ np.stack([self.along, self.out, self.across])

    def shut(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """World points on the open leaf, by their place on the shut one as `local` tells it [m]."""
        return self.local(apply(self.T_shut_open, points))
