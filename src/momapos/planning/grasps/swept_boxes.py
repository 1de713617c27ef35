"""When boxes that move along a line touch convex hulls, for many poses of the boxes at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import F1, F2, F3, entry, kernel
from momapos.model.kinematics import BoxArrays
from momapos.model.urdf import Boxes, Hull

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
        depth, cosine = np.empty(points.shape[:2]), np.empty(points.shape[:2])
        _surface(
            np.ascontiguousarray(points), np.ascontiguousarray(outward), self.normals,
            self.offsets, depth, cosine,
        )  # fmt: skip
        return depth, cosine

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
    begin, end, cosine = (np.empty((len(R), len(boxes))) for _ in range(3))
    _touches(
        BoxArrays(boxes.center, boxes.rotation, boxes.half), hull.vertices, hull.normals,
        hull.offsets, np.ascontiguousarray(R), np.ascontiguousarray(p), direction, margin,
        begin, end, cosine,
    )  # fmt: skip
    return Touch(begin, end, cosine)


@entry
def _touches(
    boxes: BoxArrays,
    vertices: F2,
    normals: F2,
    offsets: F1,
    R: F3,
    p: F2,
    direction: F1,
    margin: float,
    begin: F2,
    end: F2,
    cosine: F2,
) -> None:
    """All in the frame of the tool, in which the boxes and their axes stay as they are."""
    center, rotation, half = boxes
    own_normals, own_offsets = np.empty_like(normals), np.empty(len(normals))
    own = np.empty_like(vertices)
    for g in range(len(R)):
        for k in range(len(normals)):
            own_offsets[k] = offsets[k]
            for i in range(3):
                own_offsets[k] -= normals[k, i] * p[g, i]
                own_normals[k, i] = 0.0
                for j in range(3):
                    own_normals[k, i] += normals[k, j] * R[g, j, i]
        for m in range(len(vertices)):
            for i in range(3):
                own[m, i] = 0.0
                for j in range(3):
                    own[m, i] += (vertices[m, j] - p[g, j]) * R[g, j, i]
        for b in range(len(center)):
            first, last, lean = -np.inf, np.inf, 0.0
            # Along the normals of the hull.
            for k in range(len(normals)):
                middle, reach, rate = 0.0, 0.0, 0.0
                for i in range(3):
                    middle += own_normals[k, i] * center[b, i]
                    rate += own_normals[k, i] * direction[i]
                    along = 0.0
                    for j in range(3):
                        along += own_normals[k, j] * rotation[b, j, i]
                    reach += abs(along) * half[b, i]
                gap = middle - reach - own_offsets[k] - margin
                when = _nearing(gap, rate)
                if when > first:
                    first, lean = when, abs(rate)
                if rate > _STILL:
                    last = min(last, -gap / rate)
            # Along the axes of the box, both ways.
            for i in range(3):
                at, rate, low, high = 0.0, 0.0, np.inf, -np.inf
                for j in range(3):
                    at += center[b, j] * rotation[b, j, i]
                    rate += direction[j] * rotation[b, j, i]
                for m in range(len(own)):
                    along = 0.0
                    for j in range(3):
                        along += own[m, j] * rotation[b, j, i]
                    low, high = min(low, along), max(high, along)
                for sign in (-1.0, 1.0):
                    gap = (at - high if sign > 0 else low - at) - half[b, i] - margin
                    when = _nearing(gap, sign * rate)
                    if when > first:
                        first, lean = when, abs(rate)
                    if sign * rate > _STILL:
                        last = min(last, -gap / (sign * rate))
            begin[g, b] = first if first <= last else np.inf
            end[g, b], cosine[g, b] = last, lean


@kernel
def _nearing(gap, rate):
    """Travel from which on an axis does not separate any more what nears along it."""
    if rate < -_STILL:
        return -gap / rate
    return np.inf if gap > 0.0 and rate <= _STILL else -np.inf


@entry
def _surface(points: F3, outward: F2, normals: F2, offsets: F1, depth: F2, cosine: F2) -> None:
    rates = np.empty(len(normals))
    for g in range(len(points)):
        for k in range(len(normals)):
            rates[k] = 0.0
            for i in range(3):
                rates[k] += outward[g, i] * normals[k, i]
        for n in range(points.shape[1]):
            least, nearest, leaves = np.inf, np.inf, 0
            for k in range(len(normals)):
                inside = offsets[k]
                for i in range(3):
                    inside -= points[g, n, i] * normals[k, i]
                least = min(least, inside)
                if rates[k] > _STILL and inside / rates[k] < nearest:
                    nearest, leaves = inside / rates[k], k
            depth[g, n], cosine[g, n] = least, rates[leaves]
