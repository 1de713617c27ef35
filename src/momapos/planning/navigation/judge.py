"""Whether the robot really touches anything: outlines against outlines, in plain numpy.

Nothing of what plans or steers is used here: no map, no thinning, no kernels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import contains, edge_distances, place_points

from .convex_polygons import ConvexPolygons, RobotPrisms, on_floor

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

FAR = 0.5
"""Distances above this are not told apart [m]."""
_AT_ONCE = 8
"""Poses that are looked at together; neighbors share what is near them."""


@dataclass(frozen=True, eq=False)
class FootprintCollisionChecker:
    """The robot and everything that it must not touch."""

    prisms: RobotPrisms
    obstacles: ConvexPolygons
    floor_polygon: Float[np.ndarray, "k 2"] | None

    @cached_property
    def _padded(self) -> Float[np.ndarray, "o k 2"]:
        """Corners of all obstacles; the first one again where one has fewer than others."""
        count = np.diff(self.obstacles.first)
        index = np.arange(count.max(initial=1))
        index = self.obstacles.first[:-1, None] + np.where(index < count[:, None], index, 0)
        return self.obstacles.corner[index]

    def distance(
        self, poses: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " n"], list[str]]:
        """Distance to the nearest obstacle at each pose [m], at most FAR, 0 where they overlap.

        Returns:
            The distances, and what is touched at each pose, "" where nothing is.
        """
        if len(poses) > _AT_ONCE:
            parts = [self.distance(poses[k : k + _AT_ONCE]) for k in range(0, len(poses), _AT_ONCE)]
            return np.concatenate([d for d, _ in parts]), [name for _, t in parts for name in t]
        best = np.full(len(poses), FAR)
        touched = [""] * len(poses)
        count = np.diff(self.obstacles.first)
        for layer, outline in enumerate(self.prisms.outlines):
            robot = place_points(poses, outline)[:, None]
            which, least = self._nearest_first(robot, layer)
            for k in range(0, len(which), _AT_ONCE):
                # The bounds of the rest are farther from all poses than what was found.
                if least[k] > best.max():
                    break
                some = which[k : k + _AT_ONCE]
                room = self._padded[some, : count[some].max()][None]
                apart = np.minimum(
                    edge_distances(robot, room).min(-1), edge_distances(room, robot).min(-1)
                )
                apart = np.where(overlap(robot, room), 0.0, apart)
                best = np.minimum(best, apart.min(1))
                for n in np.flatnonzero((apart <= 0).any(1)):
                    touched[n] = touched[n] or self.obstacles.names[some[int(apart[n].argmin())]]
        for n in np.flatnonzero(~on_floor(self.prisms, self.floor_polygon, poses)):
            touched[n] = touched[n] or "the edge of the floor"
        return best, touched

    def _nearest_first(
        self, robot: Float[np.ndarray, "n 1 k 2"], layer: int
    ) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Obstacles of a layer by how far their bounds are from those of the robot at all poses."""
        which = np.flatnonzero(self.obstacles.layer == layer)
        low, high = robot.min((0, 1, 2)), robot.max((0, 1, 2))
        box = self.obstacles.bounds[which]
        beside = np.maximum(np.maximum(box[:, :2] - high, low - box[:, 2:]), 0.0)
        least = np.hypot(beside[:, 0], beside[:, 1])
        order = np.argsort(least, kind="stable")
        return which[order], least[order]

    def to_discs(
        self, pose: Float[np.ndarray, "3"], discs: Float[np.ndarray, "d 5"]
    ) -> Float[np.ndarray, " d"]:
        """Distance between the robot and moving discs [m], negative where they overlap."""
        if not len(discs):
            return np.zeros(0)
        found = []
        for outline in self.prisms.outlines:
            robot = place_points(pose[None], outline)
            apart = edge_distances(discs[:, :2], robot[0])
            found.append(np.where(contains(robot[0], discs[:, :2]), 0.0, apart))
        return np.min(found, axis=0) - discs[:, 4]


def overlap(
    a: Float[np.ndarray, "*#batch k 2"], b: Float[np.ndarray, "*#batch m 2"]
) -> Bool[np.ndarray, " *batch"]:
    """Whether convex outlines have a point in common: no edge of either separates them."""

    def separated(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        along = np.roll(p, -1, axis=-2) - p
        normal = np.stack([along[..., 1], -along[..., 0]], -1)
        level = np.einsum("...ki,...ki->...k", normal, p)
        beyond = np.einsum("...ki,...mi->...km", normal, q) - level[..., None]
        return np.asarray((beyond.min(-1) > 0).any(-1))

    return ~(separated(a, b) | separated(b, a))
