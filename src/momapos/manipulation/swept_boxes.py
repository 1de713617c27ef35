"""When boxes that move along a line touch convex hulls, for many poses of the boxes at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.kinematics.hulls import Boxes, Hull

if TYPE_CHECKING:
    from jaxtyping import Float

NEVER = np.inf
_STILL = 1e-9
"""Along an axis that turns less than this with the motion nothing comes nearer [-]."""
_ALIKE = 4
"""Digits up to which the normals of faces are the same."""


@dataclass(frozen=True)
class Convex:
    """A convex hull as its corners and the planes of its faces."""

    vertices: Float[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "k 3"]
    """Outward unit normals, each once."""
    offsets: Float[np.ndarray, " k"]
    """How far the planes are from the origin along them [m]."""

    def depth(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, " *n"]:
        """How deep points lie inside, negative outside [m]."""
        return (self.offsets - points @ self.normals.T).min(-1)

    def surface(
        self, points: Float[np.ndarray, "g n 3"], outward: Float[np.ndarray, "g 3"]
    ) -> tuple[Float[np.ndarray, "g n"], Float[np.ndarray, "g n"]]:
        """How deep points lie inside [m], and how a line from them meets the surface.

        Args:
            points: In groups.
            outward: Unit direction of the line of each group.

        Returns:
            Depth, negative outside; cosine between the line and the normal of the face by which
            it leaves.
        """
        inside = self.offsets - points @ self.normals.T
        rate = outward @ self.normals.T
        ahead = np.where(rate > _STILL, rate, np.nan)[:, None]
        with np.errstate(invalid="ignore"):
            way = np.where(np.isnan(ahead), np.inf, inside / ahead)
        face = way.argmin(-1)
        return inside.min(-1), np.take_along_axis(rate, face, 1)

    def span(
        self, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
    ) -> tuple[float, float]:
        """Where a line enters and leaves it [m]; no end beyond the begin where it misses."""
        rate, gap = self.normals @ direction, self.offsets - self.normals @ origin
        facing, leaving = rate < -_STILL, rate > _STILL
        if (gap[~facing & ~leaving] < 0).any():
            return 0.0, 0.0
        begin = (gap[facing] / rate[facing]).max(initial=-np.inf)
        end = (gap[leaving] / rate[leaving]).min(initial=np.inf)
        return float(begin), float(end)


def convex_of(hull: Hull, T: Float[np.ndarray, "4 4"]) -> Convex:
    """A hull, placed."""
    vertices = hull.vertices @ T[:3, :3].T + T[:3, 3]
    a, b, c = (vertices[hull.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals = normals[length > 0] / length[length > 0, None]
    _, first = np.unique(np.round(normals, _ALIKE) + 0.0, axis=0, return_index=True)
    normals = normals[first]
    return Convex(vertices, normals, (vertices @ normals.T).max(0))


@dataclass(frozen=True)
class Touch:
    """When each box of each pose touches a hull, as travel along the line [m]."""

    begin: Float[np.ndarray, "g b"]
    """NEVER where it does not; negative where it overlaps from before the start."""
    end: Float[np.ndarray, "g b"]
    """Where it has passed."""
    cosine: Float[np.ndarray, "g b"]
    """Between the line and the normal of the contact at the beginning [-]."""


def touches_hull(
    boxes: Boxes,
    hull: Convex,
    R: Float[np.ndarray, "g 3 3"],
    p: Float[np.ndarray, "g 3"],
    direction: Float[np.ndarray, "3"],
    margin: float = 0.0,
) -> Touch:
    """When boxes that move along a line touch a hull.

    Two convex bodies are apart while a plane separates them; the faces of both are tried. Where
    only edges cross, that says "touch" a little too early, and never too late.

    Args:
        boxes: In the frame of the tool.
        hull: In the frame of the part.
        R, p: Poses of the tool in the part.
        direction: Unit vector of the motion in the frame of the tool.
        margin: Distance that counts as a touch [m].
    """
    count = len(boxes)
    axes = boxes.rotation.transpose(1, 0, 2).reshape(3, -1)  # columns: all axes of all boxes
    # Along the normals of the hull.
    normals = np.einsum("kj,gji->gki", hull.normals, R)
    middle = normals @ boxes.center.T
    reach = (np.abs(normals @ axes).reshape(*normals.shape[:2], count, 3) * boxes.half).sum(-1)
    gap = middle - reach - (hull.offsets - p @ hull.normals.T)[..., None] - margin
    rate = np.broadcast_to((normals @ direction)[..., None], gap.shape)
    one = _interval(gap, rate)
    # Along the axes of the boxes, both ways.
    span = ((hull.vertices - p[:, None]) @ R) @ axes
    low = span.min(1).reshape(-1, count, 3) - margin
    high = span.max(1).reshape(-1, count, 3) + margin
    at = np.einsum("bi,bij->bj", boxes.center, boxes.rotation)
    gap = np.stack([low - at - boxes.half, at - boxes.half - high], 1)
    gap = gap.transpose(0, 1, 3, 2).reshape(len(R), 6, count)
    turn = np.einsum("i,bij->jb", direction, boxes.rotation)
    rate = np.broadcast_to(np.concatenate([-turn, turn]), gap.shape)
    other = _interval(gap, rate)
    begin = np.maximum(one[0], other[0])
    end = np.minimum(one[1], other[1])
    begin = np.where(begin <= end, begin, NEVER)
    return Touch(begin, end, np.where(one[0] > other[0], one[2], other[2]))


def _interval(
    gap: Float[np.ndarray, "g k b"], rate: Float[np.ndarray, "g k b"]
) -> tuple[Float[np.ndarray, "g b"], Float[np.ndarray, "g b"], Float[np.ndarray, "g b"]]:
    """Travel from which on no axis separates, until one does again, and the last one's cosine."""
    nearing, parting = rate < -_STILL, rate > _STILL
    safe = np.where(nearing | parting, rate, 1.0)
    when = -gap / safe
    begin = np.where(nearing, when, np.where(~parting & (gap > 0), NEVER, -np.inf))
    end = np.where(parting, when, np.inf)
    last = begin.argmax(1)
    cosine = np.abs(np.take_along_axis(rate, last[:, None], 1)[:, 0])
    return begin.max(1), end.min(1), cosine
