"""Cover the shapes of a link with few spheres.

A cylinder has spheres on its axis, or rings of them; other shapes are divided into cells of boxes,
with one sphere per cell. Spheres that cover no point of their own are dropped.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import look, owner_cache
from momapos.core.geometry import apply
from momapos.model.urdf import Boxes, Geometry, Hull, cover, hull_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MARGIN = 0.006
"""Largest distance of uncovered points of a shape from the spheres [m]."""
GRIPPER, ARM, BODY = 0.01, 0.02, 0.035
"""Largest protrusion of spheres from a gripper, which works near handles, from an arm, and from the
links that carry the arm, such as a torso [m]."""
MIN_BULKY_HALF = 0.06
"""Shapes with a larger half thickness may protrude as far as bodies [m]."""
MAX_CELLS = 200
"""Largest number of cells of a box; in larger boxes, the cells grow [-]."""
MAX_PLANES = 500
"""Largest number of planes that represent the surface of a hull [-]."""
MAX_DISTANCES = 4_000_000
"""Largest number of distances of points to faces in memory at once [-]."""
_LAYERS = ((0, 1), (3, 0), (4, 0), (5, 0), (6, 0), *((k, 1) for k in range(5, 17)))
"""Numbers of spheres in a ring and at its center."""
_SIDE = 7
_GRID = np.stack(np.meshgrid(*[np.linspace(-1, 1, _SIDE)] * 3, indexing="ij"), -1).reshape(-1, 3)
_OUTER = _GRID[np.abs(_GRID).max(1) == 1]
_DIRECTIONS = _OUTER / np.linalg.norm(_OUTER, axis=1, keepdims=True)


class _SphereCover(NamedTuple):
    """Spheres, and sample points of the shape that they must cover."""

    center: Float[np.ndarray, "s 3"]
    radius: Float[np.ndarray, " s"]
    points: Float[np.ndarray, "p 3"]


def cover_shapes(
    shapes: Sequence[Geometry], stick_out: float
) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, " s"]]:
    """Cover the shapes of one link up to `MARGIN`.

    Args:
        shapes: At least one shape.
        stick_out: Largest protrusion from a shape that is not bulky [m].

    Returns:
        Centers in the link frame and radii [m].
    """
    return _cover_link(tuple(shapes), stick_out)


@owner_cache(owner=lambda shapes: shapes[0])
def _cover_link(
    shapes: tuple[Geometry, ...], stick_out: float
) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, " s"]]:
    """Cover the shapes of one link, cached: each arm of a robot is covered, and each posture."""
    base = _join([_cover_shape(shape, stick_out) for shape in shapes])
    keep = _needed(base)
    return base.center[keep], base.radius[keep]


def box_spheres(boxes: Boxes) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, " s"]]:
    """Cover boxes up to `MARGIN`; return centers in the frame of the boxes, and radii [m]."""
    rows = zip(boxes.center, boxes.rotation, boxes.half, strict=True)
    return _join([_cells(*row, GRIPPER) for row in rows])[:2]


def _cover_shape(shape: Geometry, stick_out: float) -> _SphereCover:
    if not isinstance(shape.mesh, Path):
        return _compute_cover(shape, stick_out)
    # Cached, since the same mesh is covered for each arm, and each time the robot is loaded.
    T = shape.T_link_geometry
    stamp = os.stat(shape.mesh).st_mtime_ns
    return _mesh_cover(shape.mesh, stamp, shape.size, T.tobytes(), stick_out)


@lru_cache(maxsize=256)
def _mesh_cover(
    mesh: Path, _stamp: int, size: tuple[float, ...], T: bytes, stick_out: float
) -> _SphereCover:
    shape = Geometry("mesh", size, np.frombuffer(T).reshape(4, 4), mesh=mesh)
    return _compute_cover(shape, stick_out)


def _compute_cover(shape: Geometry, stick_out: float) -> _SphereCover:
    look()
    if shape.kind == "sphere":
        center, size = shape.T_link_geometry[None, :3, 3], shape.size[0]
        return _SphereCover(center, np.array([size]), center + size * _DIRECTIONS)
    if shape.kind == "cylinder":
        radius, length = shape.size
        found = _rings(radius, length, _allowed(min(radius, length / 2), stick_out))
        if found is not None:
            T = shape.T_link_geometry
            return _SphereCover(apply(T, found.center), found.radius, apply(T, found.points))
    hull = hull_of(shape)
    # For a cylinder one box is enough, since cells adapt to it; meshes have any shape.
    boxes = cover(hull, depth=0 if shape.kind == "cylinder" else 3)
    rows = zip(boxes.center, boxes.rotation, boxes.half, strict=True)
    return _join([_cells(c, R, h, _allowed(float(h.min()), stick_out), hull) for c, R, h in rows])


def _allowed(thin: float, stick_out: float) -> float:
    return max(stick_out, BODY) if thin > MIN_BULKY_HALF else stick_out


def _join(covers: Sequence[_SphereCover]) -> _SphereCover:
    return _SphereCover(*(np.concatenate(column) for column in zip(*covers, strict=True)))


def _rings(radius: float, length: float, stick_out: float) -> _SphereCover | None:
    """Cover a cylinder along z by layers of spheres, or return None if they protrude too far.

    A layer is a sphere on the axis, a ring of them, or both. The points farthest from a ring are
    halfway between two neighbors: on the rim, and on the axis or at the end of the central sphere.
    """
    best, cost = None, np.inf
    for k, hub in _LAYERS:
        turn = np.cos(np.pi / k) if k else 0.0
        for r in np.linspace(0.2 * radius, radius + stick_out, 41):
            d = float(np.clip(radius * turn, 0.0, max(0.0, radius + stick_out - r)))
            rim = radius**2 + d**2 - 2 * radius * d * turn
            across = max(rim, (d / (2 * turn)) ** 2 if k and hub else d**2)
            if (r + MARGIN) ** 2 <= across:
                continue
            reach = np.sqrt((r + MARGIN) ** 2 - across)
            count = max(1, int(np.ceil(length / (2 * reach) - 1e-9)))
            end = max(0.0, length / 2 - reach) if count > 1 else 0.0
            out = max(d + r - radius, end + r - length / 2)
            price = (k + hub) * count * (out + ARM)
            if out <= stick_out + 1e-9 and price < cost:
                best, cost = (k, hub, r, d, np.linspace(-end, end, count)), price
    if best is None:
        return None
    k, hub, r, d, z = best
    ring = _rods(np.arange(k) * 2 * np.pi / max(k, 1), [d], z)
    center = np.vstack([ring, _rods(np.zeros(hub), [0.0], z)])
    angle, height = np.arange(24) * np.pi / 12, np.linspace(-length / 2, length / 2, 4 * len(z) + 1)
    points = _rods(angle, [0.0, radius / 2, radius], height)
    return _SphereCover(center, np.full(len(center), r), points)


def _rods(angle: np.ndarray, radius: Sequence[float], z: np.ndarray) -> np.ndarray:
    """Return points at all combinations of cylinder coordinates."""
    a, r, h = (x.ravel() for x in np.meshgrid(angle, radius, z, indexing="ij"))
    return np.stack([r * np.cos(a), r * np.sin(a), h], -1)


def _cells(
    center: np.ndarray, rotation: np.ndarray, half: np.ndarray, stick_out: float,
    hull: Hull | None = None,
) -> _SphereCover:  # fmt: skip
    """Return one sphere per cell of a box, around the part of the hull in it."""
    count = _count(half, stick_out)
    cell = half / count
    # Each grid point represents its surroundings, halfway to the next.
    step = float(np.linalg.norm(cell)) / (_SIDE - 1)
    index = np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), -1).reshape(-1, 3)
    points = center + (((2 * index + 1) * cell - half)[:, None] + _GRID * cell) @ rotation.T
    inside = np.ones(points.shape[:2], bool)
    if hull is not None:
        moved = _project(points, hull)
        inside = np.linalg.norm(moved - points, axis=-1) <= step + 1e-9
        points = moved
    points, inside = points[inside.any(1)], inside[inside.any(1)]
    local = (points - center) @ rotation
    low = np.where(inside[..., None], local, np.inf).min(1)
    high = np.where(inside[..., None], local, -np.inf).max(1)
    middle = (low + high) / 2
    far = np.where(inside, np.linalg.norm(local - middle[:, None], axis=-1), 0.0).max(1)
    radius = np.maximum(far - MARGIN, cell.min() / 2)
    return _SphereCover(center + middle @ rotation.T, radius, points[inside])


def _count(half: np.ndarray, stick_out: float) -> np.ndarray:
    """Return the smallest number of cells along each axis with an allowed protrusion."""
    most = np.ceil(half / ((stick_out + MARGIN) / (np.sqrt(3) - 1))).astype(int) + 2
    ranges = (np.arange(1, min(n, MAX_CELLS) + 1) for n in most)
    counts = np.stack(np.meshgrid(*ranges, indexing="ij"), -1).reshape(-1, 3)
    counts = counts[counts.prod(1) <= MAX_CELLS]
    cell = half / counts
    out = np.linalg.norm(cell, axis=1) - MARGIN - cell.min(1)
    fits = out <= stick_out
    return counts[np.where(fits, counts.prod(1), np.inf).argmin() if fits.any() else out.argmin()]


def _planes(hull: Hull) -> tuple[Float[np.ndarray, "f 3"], Float[np.ndarray, " f"]]:
    """Return outward unit normals and offsets of planes that bound a hull.

    These are its faces, or evenly spread supporting planes if it has too many.
    """
    if len(hull.faces) > MAX_PLANES:
        normal = _unit_vectors(MAX_PLANES)
        return normal, (hull.vertices @ normal.T).max(0)
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    normal, a = normal[length > 1e-12] / length[length > 1e-12, None], a[length > 1e-12]
    offset = np.einsum("fk,fk->f", normal, a)
    planes = np.unique(np.round(np.column_stack([normal, offset]), 5), axis=0)
    return planes[:, :3], planes[:, 3]


def _unit_vectors(count: int) -> Float[np.ndarray, "count 3"]:
    """Return unit vectors spread evenly over the sphere, on a spiral."""
    z = (2 * np.arange(count) + 1) / count - 1
    angle = np.pi * (np.sqrt(5) - 1) * np.arange(count)
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)


def _project(points: Float[np.ndarray, "*n 3"], hull: Hull) -> Float[np.ndarray, "*n 3"]:
    """Move points outside a hull to its surface, along the normals of faces."""
    normal, offset = _planes(hull)
    moved = points.reshape(-1, 3).copy()
    size = max(1, MAX_DISTANCES // len(normal))
    for first in range(0, len(moved), size):
        part = moved[first : first + size]
        for _ in range(3):
            out = part @ normal.T - offset
            part -= np.maximum(0.0, out.max(-1))[..., None] * normal[out.argmax(-1)]
    return moved.reshape(points.shape)


def _needed(cover: _SphereCover) -> Bool[np.ndarray, " s"]:
    """Return which spheres to keep; those that cover few points are dropped first."""
    from scipy.spatial.distance import cdist

    look()
    far = cdist(cover.center, cover.points) - cover.radius[:, None]
    covers = far <= MARGIN + 1e-9
    # 1 mm less, for the surface between the points.
    well = far <= MARGIN - 1e-3
    times, keep = well.sum(0), np.ones(len(well), bool)
    for s in np.argsort(covers.sum(1)):
        if (times - well[s])[covers[s]].all():
            keep[s] = False
            times -= well[s]
    return keep
