"""Polygons and upright boxes on the floor, and convex hulls of points on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.compiled import F2, entry

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


def following(polygon: Float[np.ndarray, "*batch k 2"]) -> Float[np.ndarray, "*batch k 2"]:
    """Return the next corner of each corner, 5 times as fast as `np.roll`."""
    return np.concatenate([polygon[..., 1:, :], polygon[..., :1, :]], axis=-2)


def contains(
    polygon: Float[np.ndarray, "k 2"], points: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """Return whether points lie in a simple polygon of either orientation (even-odd rule)."""
    a, b = polygon, following(polygon)
    y = points[:, None, 1]
    crosses = (a[None, :, 1] > y) != (b[None, :, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return np.count_nonzero(crosses & (points[:, None, 0] < x), axis=1) % 2 == 1


def all_inside(
    polygon: Float[np.ndarray, "k 2"], outlines: Float[np.ndarray, "n m 2"]
) -> Bool[np.ndarray, " n"]:
    """Return whether convex outlines lie in a polygon: corners inside, no crossing edges."""
    n, m, _ = outlines.shape
    if _is_convex(polygon):
        edge = following(polygon) - polygon
        inward = np.stack([-edge[:, 1], edge[:, 0]], -1) * np.sign(signed_area(polygon))
        beyond = outlines.reshape(-1, 2) @ inward.T - (inward * polygon).sum(-1)
        return (beyond > 0).reshape(n, m * len(polygon)).all(1)
    rows = np.flatnonzero(contains(polygon, outlines.reshape(-1, 2)).reshape(n, m).all(1))
    inside = np.zeros(n, bool)
    inside[rows] = ~_edges_cross(polygon, outlines[rows])
    return inside


def _is_convex(polygon: Float[np.ndarray, "k 2"]) -> bool:
    edge = following(polygon) - polygon
    after = following(edge)
    turn = edge[:, 0] * after[:, 1] - edge[:, 1] * after[:, 0]
    return bool((turn >= 0).all() or (turn <= 0).all())


def any_overlap(
    polygon: Float[np.ndarray, "k 2"], outlines: Float[np.ndarray, "n m 2"]
) -> Bool[np.ndarray, " n"]:
    """Return whether convex outlines share a point with a polygon."""
    n, m, _ = outlines.shape
    within = np.asarray(contains(polygon, outlines.reshape(-1, 2)).reshape(n, m).any(1))
    undecided = np.flatnonzero(~within)
    left = outlines[undecided]
    within[undecided] = _contain(left, polygon[0]) | _edges_cross(polygon, left)
    return within


def _contain(
    outlines: Float[np.ndarray, "n m 2"], point: Float[np.ndarray, "2"]
) -> Bool[np.ndarray, " n"]:
    """Return which convex outlines, of either orientation, contain a point."""
    edge, toward = following(outlines) - outlines, point - outlines
    side = edge[..., 0] * toward[..., 1] - edge[..., 1] * toward[..., 0]
    return np.asarray((side >= 0).all(1) | (side <= 0).all(1))


def _edges_cross(
    polygon: Float[np.ndarray, "k 2"], outlines: Float[np.ndarray, "n m 2"]
) -> Bool[np.ndarray, " n"]:
    p, q = polygon, following(polygon)
    a, b = outlines[:, :, None], following(outlines)[:, :, None]

    def side(o: np.ndarray, d: np.ndarray, x: np.ndarray) -> np.ndarray:
        return (d[..., 0] - o[..., 0]) * (x[..., 1] - o[..., 1]) - (d[..., 1] - o[..., 1]) * (
            x[..., 0] - o[..., 0]
        )

    apart = (side(p, q, a) * side(p, q, b) > 0) | (side(a, b, p) * side(a, b, q) > 0)
    return (~apart).any((1, 2))


def signed_area(polygon: Float[np.ndarray, "k 2"]) -> float:
    """Return the area of a simple polygon, positive if it is counterclockwise [m^2]."""
    (x, y), (x_next, y_next) = polygon.T, following(polygon).T
    return float(0.5 * np.sum(x * y_next - x_next * y))


def edge_normals(polygon: Float[np.ndarray, "*batch k 2"]) -> Float[np.ndarray, "*batch k 2"]:
    """Return outward unit normals of a counterclockwise polygon's edges, in order of corners."""
    return normals_of(following(polygon) - polygon)


def normals_of(edge: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    """Return the unit normals to the right of some edges; zero for edges without length."""
    normal = np.stack([edge[..., 1], -edge[..., 0]], -1)
    return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)


def edge_distances(
    points: Float[np.ndarray, "*#batch n 2"], polygon: Float[np.ndarray, "*#batch k 2"]
) -> Float[np.ndarray, "*batch n"]:
    """Return the unsigned distance of points from the nearest edge of a polygon [m]."""
    edge = following(polygon) - polygon
    toward = points[..., :, None, :] - polygon[..., None, :, :]
    squared = np.maximum((edge**2).sum(-1), 1e-18)
    share = np.clip(np.einsum("...nki,...ki->...nk", toward, edge) / squared[..., None, :], 0, 1)
    gap = toward - share[..., None] * edge[..., None, :, :]
    return np.asarray(np.sqrt((gap**2).sum(-1)).min(-1))


def inscribed_radius(polygon: Float[np.ndarray, "k 2"]) -> float:
    """Return the radius of the largest origin-centered circle in a convex ccw polygon [m]."""
    return float(max(0.0, np.einsum("ij,ij->i", edge_normals(polygon), polygon).min()))


def convex_parts(polygon: Float[np.ndarray, "k 2"]) -> list[Float[np.ndarray, "_ 2"]]:
    """Return convex counterclockwise polygons that together cover a simple polygon."""
    if _is_convex(polygon):
        return [polygon if signed_area(polygon) > 0 else polygon[::-1]]
    return list(polygon[triangulated(polygon)])


def triangulated(polygon: Float[np.ndarray, "k 2"]) -> Int[np.ndarray, "t 3"]:
    """Triangulate a simple polygon by ear clipping; the triangles are counterclockwise."""
    left, triangles = list(range(len(polygon))), []
    if signed_area(polygon) < 0:
        left.reverse()
    while len(left) > 3:
        for k in range(len(left)):
            i, j, m = left[k - 1], left[k], left[(k + 1) % len(left)]
            a, b, c = polygon[i], polygon[j], polygon[m]
            others = polygon[[n for n in left if n not in (i, j, m)]]
            if _turn(a, b, c) > 0 and not _inside(others, a, b, c).any():
                triangles.append((i, j, m))
                left.pop(k)
                break
        else:  # no ear is left: the corners are collinear
            break
    triangles.append((left[0], left[1], left[2]))
    return np.array(triangles)


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    ahead, across = b - a, c - a
    return np.asarray(ahead[..., 0] * across[..., 1] - ahead[..., 1] * across[..., 0])


def _inside(points: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    inside = np.ones(len(points), bool)
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= np.asarray(_turn(p, q, points)) >= 0
    return inside


def convex_hull(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "k 2"]:
    """Return the corners of the convex hull, counterclockwise from the smallest x.

    A corner that protrudes by less than 0.1 nm is omitted.

    Args:
        points: At least three points. On one line they have no area, and two corners remain.
    """
    order = np.lexsort((points[:, 1], points[:, 0]))
    return _chain(np.ascontiguousarray(points[order], float))


@entry
def _chain(points: F2) -> np.ndarray:
    """Return the corners of the hull of points that are sorted by x, then y."""
    n = len(points)
    kept = np.empty((2 * n + 1, 2))
    count = 0
    for upper in (False, True):
        least = count + 1
        for k in range(n):
            c = points[n - 1 - k if upper else k]
            while count > least:
                a, b = kept[count - 2], kept[count - 1]
                abx, aby, acx, acy = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
                if abx * acy - aby * acx > 1e-10 * np.hypot(acx, acy):
                    break
                count -= 1
            kept[count, 0], kept[count, 1] = c[0], c[1]
            count += 1
        count -= 1  # the last corner is the first of the next chain
    return kept[:count].copy()


@dataclass(frozen=True, eq=False)
class UprightBox:
    """A box with vertical edges."""

    center: Float[np.ndarray, "3"]
    size: Float[np.ndarray, "3"]
    """Edge lengths along its own x, y, z [m]."""
    yaw: float = 0.0
    """Angle of its x axis about the world's z [rad]."""


def box_axes(yaw: float) -> Float[np.ndarray, "2 2"]:
    """Return the x and y axes of a box in the world, as rows."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, s], [-s, c]])


def to_local(points: Float[np.ndarray, "n 3"], box: UprightBox) -> Float[np.ndarray, "n 3"]:
    """Map world points to the frame at a box's center, along its edges."""
    return along_edges(points - box.center, box.yaw)


def along_edges(vectors: Float[np.ndarray, "n 3"], yaw: float) -> Float[np.ndarray, "n 3"]:
    """Map world vectors to axes turned by yaw [rad]."""
    turned = np.array(vectors, float)
    turned[:, :2] = turned[:, :2] @ box_axes(yaw).T
    return turned


def between(
    points: Float[np.ndarray, "n 3"],
    low: Float[np.ndarray, "3"] | Sequence[float],
    high: Float[np.ndarray, "3"] | Sequence[float],
) -> Bool[np.ndarray, " n"]:
    """Return which points lie between two corners; per coordinate, which is faster."""
    x, y, z = points.T
    inside = (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
    return np.asarray(inside & (z > low[2]) & (z < high[2]))


def corners(box: UprightBox) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the low and high corner, in the box's axes about the world's origin."""
    center = along_edges(np.asarray(box.center)[None], box.yaw)[0]
    return center - box.size / 2, center + box.size / 2


def from_corners(
    low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], yaw: float = 0.0
) -> UprightBox:
    """Return the box between two corners, in axes turned by yaw [rad] about the world's origin."""
    center = (low + high) / 2
    center[:2] = center[:2] @ box_axes(yaw)
    return UprightBox(center, high - low, yaw)


def bottom(box: UprightBox) -> float:
    """Return the height of a box's bottom [m]."""
    return float(box.center[2] - box.size[2] / 2)


def top(box: UprightBox) -> float:
    """Return the height of a box's top [m]."""
    return float(box.center[2] + box.size[2] / 2)
