"""Check exactly whether the robot touches anything: outlines against outlines, in plain numpy.

And check whether the wheels of its base can make a motion.

It is independent of planning and steering: it uses no map, no reduced obstacles and no kernels.
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

MAX_DISTANCE = 0.5
"""Upper bound of the reported distances [m]."""
_SLACK = 1e-6
"""Rounding errors of a motion between two poses [m], [rad]."""
_BLOCK = 8
"""Number of poses, and of obstacles, that are checked together [-]."""


@dataclass(frozen=True, eq=False)
class FootprintCollisionChecker:
    """The robot and everything that it must not touch."""

    prisms: RobotPrisms
    obstacles: ConvexPolygons
    floor_polygon: Float[np.ndarray, "k 2"] | None

    @cached_property
    def _padded(self) -> Float[np.ndarray, "o k 2"]:
        """Corners of all obstacles, padded by each one's first corner."""
        count = np.diff(self.obstacles.first)
        index = np.arange(count.max(initial=1))
        index = self.obstacles.first[:-1, None] + np.where(index < count[:, None], index, 0)
        return self.obstacles.corner[index]

    def distance(
        self, poses: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " n"], list[str]]:
        """Compute the distance to the nearest obstacle at each pose.

        Returns:
            The distances [m], at most `MAX_DISTANCE`, 0 on overlap; and what is touched at each
            pose, "" for nothing.
        """
        if len(poses) > _BLOCK:
            parts = [self.distance(poses[k : k + _BLOCK]) for k in range(0, len(poses), _BLOCK)]
            return np.concatenate([d for d, _ in parts]), [name for _, t in parts for name in t]
        best = np.full(len(poses), MAX_DISTANCE)
        touched = [""] * len(poses)
        count = np.diff(self.obstacles.first)
        for layer, outline in enumerate(self.prisms.outlines):
            robot = place_points(poses, outline)[:, None]
            which, least = self._nearest_first(robot, layer)
            for k in range(0, len(which), _BLOCK):
                # The bounds of all further obstacles are farther than the nearest ones so far.
                if least[k] > best.max():
                    break
                some = which[k : k + _BLOCK]
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
        """Sort the obstacles of a layer by the distance of their bounds from those of the robot."""
        which = np.flatnonzero(self.obstacles.layer == layer)
        low, high = robot.min((0, 1, 2)), robot.max((0, 1, 2))
        box = self.obstacles.bounds[which]
        apart = np.maximum(np.maximum(box[:, :2] - high, low - box[:, 2:]), 0.0)
        least = np.hypot(apart[:, 0], apart[:, 1])
        order = np.argsort(least, kind="stable")
        return which[order], least[order]

    def disc_distances(
        self, pose: Float[np.ndarray, "3"], discs: Float[np.ndarray, "d 5"]
    ) -> Float[np.ndarray, " d"]:
        """Compute the distances between the robot and discs [m], negative on overlap."""
        if not len(discs):
            return np.zeros(0)
        found = []
        for outline in self.prisms.outlines:
            robot = place_points(pose[None], outline)
            apart = edge_distances(discs[:, :2], robot[0])
            found.append(np.where(contains(robot[0], discs[:, :2]), 0.0, apart))
        return np.min(found, axis=0) - discs[:, 4]


def impossible_motion(drive: str, radius: float, poses: Float[np.ndarray, "n 3"]) -> str:
    """Return what the wheels of a base cannot do between consecutive poses; "" if nothing.

    Args:
        drive: "omni", "differential" or "car".
        radius: Least turning radius of a car-like base [m].
        poses: x [m], y [m], yaw [rad]; each motion between them is an arc.
    """
    if drive == "omni":
        return ""
    step = np.diff(poses[:, :2], axis=0)
    turn = np.pi - (np.pi - np.diff(poses[:, 2])) % (2 * np.pi)
    middle = poses[:-1, 2] + turn / 2  # an arc's chord has the heading of its middle
    across = step[:, 1] * np.cos(middle) - step[:, 0] * np.sin(middle)
    if (np.abs(across) > _SLACK).any():
        return "it moved sideways"
    if drive == "car" and (radius * np.abs(turn) > _arc_lengths(step, turn) + _SLACK).any():
        return f"it turned tighter than its radius of {radius:.2f} m"
    return ""


def _arc_lengths(
    step: Float[np.ndarray, "n 2"], turn: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the lengths of arcs from their chords."""
    return np.asarray(np.hypot(step[:, 0], step[:, 1]) / np.sinc(turn / 2 / np.pi))


def overlap(
    a: Float[np.ndarray, "*#batch k 2"], b: Float[np.ndarray, "*#batch m 2"]
) -> Bool[np.ndarray, " *batch"]:
    """Check whether convex outlines overlap: no edge of either separates them."""

    def separated(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        along = np.roll(p, -1, axis=-2) - p
        normal = np.stack([along[..., 1], -along[..., 0]], -1)
        level = np.einsum("...ki,...ki->...k", normal, p)
        beyond = np.einsum("...ki,...mi->...km", normal, q) - level[..., None]
        return np.asarray((beyond.min(-1) > 0).any(-1))

    return ~(separated(a, b) | separated(b, a))
