"""Compute when boxes that move along a line touch convex hulls, for many poses at once."""

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
"""Rate of approach along an axis below which the distance counts as constant [-]."""
_NORMAL_DIGITS = 4
"""Decimals to which face normals are compared [-]."""


@dataclass(frozen=True, eq=False)
class Convex:
    """A convex hull: its corners and the planes of its faces."""

    vertices: Float[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "k 3"]
    """Distinct outward unit normals."""
    offsets: Float[np.ndarray, " k"]
    """Distances of the planes from the origin along their normals [m]."""

    def depth(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, " *n"]:
        """Return the depth of points inside the hull; negative outside [m]."""
        return (self.offsets - points @ self.normals.T).min(-1)

    def surface(
        self, points: Float[np.ndarray, "g n 3"], outward: Float[np.ndarray, "g 3"]
    ) -> tuple[Float[np.ndarray, "g n"], Float[np.ndarray, "g n"]]:
        """Return the depth of points [m], and the angle at which a line from them leaves the hull.

        Args:
            points: Points in groups.
            outward: Unit direction of each group's lines.

        Returns:
            Depth, negative outside; cosine between the line and the normal of the exit face.
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
        """Return where a line enters and leaves the hull [m]; end <= begin if it misses."""
        rate, gap = self.normals @ direction, self.offsets - self.normals @ origin
        facing, leaving = rate < -_STILL, rate > _STILL
        if (gap[~facing & ~leaving] < 0).any():
            return 0.0, 0.0
        begin = (gap[facing] / rate[facing]).max(initial=-np.inf)
        end = (gap[leaving] / rate[leaving]).min(initial=np.inf)
        return float(begin), float(end)


def convex_of(hull: Hull, T: Float[np.ndarray, "4 4"]) -> Convex:
    """Transform a hull."""
    vertices = hull.vertices @ T[:3, :3].T + T[:3, 3]
    a, b, c = (vertices[hull.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals = normals[length > 0] / length[length > 0, None]
    _, first = np.unique(np.round(normals, _NORMAL_DIGITS) + 0.0, axis=0, return_index=True)
    normals = normals[first]
    return Convex(vertices, normals, (vertices @ normals.T).max(0))


@dataclass(frozen=True, eq=False)
class Touch:
    """The travel at which each box of each pose touches a hull [m]."""

    begin: Float[np.ndarray, "g b"]
    """First contact; NEVER without contact, negative if they overlap at the start."""
    end: Float[np.ndarray, "g b"]
    """End of the contact."""
    cosine: Float[np.ndarray, "g b"]
    """Cosine between the line and the contact normal at the first contact [-]."""


def touches_hull(
    boxes: Boxes,
    hull: Convex,
    R: Float[np.ndarray, "g 3 3"],
    p: Float[np.ndarray, "g 3"],
    direction: Float[np.ndarray, "3"],
    margin: float = 0.0,
) -> Touch:
    """Compute when boxes that move along a line touch a hull.

    The separating axes are the face normals of both bodies. For crossing edges this reports a
    contact slightly early, never late.

    Args:
        boxes: Boxes in the tool frame.
        hull: Hull in the part's frame.
        R, p: Poses of the tool in the part.
        direction: Unit vector of the motion in the tool frame.
        margin: Distance that counts as contact [m].
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
    """Fill in `begin`, `end` and `cosine`; works in the tool frame, where the boxes are fixed."""
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
    """Return the travel at which two bodies meet along an axis."""
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
