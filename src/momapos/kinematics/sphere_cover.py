"""Few spheres that cover the shapes of a link.

A cylinder gets spheres along its axis where these reach its rims without sticking out too far;
everything else is cut into cells of boxes, one sphere a cell. Spheres whose part others cover
as well are dropped in the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from momapos.geometry.transforms import apply
from momapos.kinematics.hulls import Boxes, Hull, cover, hull_of
from momapos.kinematics.urdf import Geometry

MARGIN = 0.006
"""Parts of a shape may stay uncovered by this much [m]."""
STICK_OUT = 0.02
"""How far spheres may stick out of slender shapes [m]."""
FINE_STICK_OUT = 0.01
"""The same for a gripper, which works next to handles [m]."""
BULKY_STICK_OUT = 0.035
"""The same for bulky shapes: up to this, as long as it is `SHARE` of their half thickness [m]."""
SHARE = 0.35
MAX_CELLS = 200
"""Cells of one box; beyond, they grow [-]."""
_GRID = np.stack(np.meshgrid(*[np.linspace(-1, 1, 7)] * 3, indexing="ij"), -1).reshape(-1, 3)


class _Cover(NamedTuple):
    """Spheres, and points of the shape that stand for all that they have to cover."""

    center: Float[np.ndarray, "s 3"]
    radius: Float[np.ndarray, " s"]
    points: Float[np.ndarray, "p 3"]


def cover_shapes(
    shapes: Sequence[Geometry], *, fine: bool = False
) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, " s"]]:
    """Cover the shapes of one link up to `MARGIN`.

    Args:
        shapes: At least one.
        fine: Whether spheres must stick out little, as those of a gripper.

    Returns:
        Centres in the link frame and radii [m].
    """
    cover = _join([_cover_shape(shape, fine) for shape in shapes])
    keep = _needed(cover)
    return cover.center[keep], cover.radius[keep]


def cover_boxes(
    boxes: Boxes, *, stick_out: float = FINE_STICK_OUT
) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, " s"]]:
    """Cover boxes up to `MARGIN`: centres in the frame of the boxes, and radii [m]."""
    rows = zip(boxes.center, boxes.rotation, boxes.half, strict=True)
    return _join([_cells(*row, stick_out) for row in rows])[:2]


def _cover_shape(shape: Geometry, fine: bool) -> _Cover:
    if shape.kind == "sphere":
        center = shape.T_link_geometry[None, :3, 3]
        return _Cover(center, np.array([shape.size[0]]), center)
    if shape.kind == "cylinder":
        radius, length = shape.size
        found = _along_axis(radius, length, _allowed(min(radius, length / 2), fine))
        if found is not None:
            T = shape.T_link_geometry
            return _Cover(apply(T, found.center), found.radius, apply(T, found.points))
    hull = hull_of(shape)
    # Cells adapt to a cylinder, so that one box is enough; meshes have any form.
    boxes = cover(hull, depth=0 if shape.kind == "cylinder" else 3)
    rows = zip(boxes.center, boxes.rotation, boxes.half, strict=True)
    return _join([_cells(c, R, h, _allowed(float(h.min()), fine), hull) for c, R, h in rows])


def _allowed(thin: float, fine: bool) -> float:
    """How far spheres may stick out of a shape of this half thickness."""
    return FINE_STICK_OUT if fine else float(np.clip(SHARE * thin, STICK_OUT, BULKY_STICK_OUT))


def _join(covers: Sequence[_Cover]) -> _Cover:
    return _Cover(*(np.concatenate(column) for column in zip(*covers, strict=True)))


def _along_axis(radius: float, length: float, stick_out: float) -> _Cover | None:
    """Spheres along z that cover a cylinder, or None where they would stick out of its ends."""
    best, cost = None, np.inf
    for wide in np.linspace(0.0, stick_out, 21)[1:]:
        # Half the length of cylinder that one sphere covers.
        reach = np.sqrt((radius + wide + MARGIN) ** 2 - radius**2)
        count = max(1, int(np.ceil(length / (2 * reach) - 1e-9)))
        end = max(0.0, length / 2 - reach)
        fits = radius + wide - (length / 2 - end) <= stick_out
        if fits and count * (wide + STICK_OUT) < cost:
            best, cost = (wide, end, count), count * (wide + STICK_OUT)
    if best is None:
        return None
    wide, end, count = best
    center = np.zeros((count, 3))
    center[:, 2] = np.linspace(-end, end, count) if count > 1 else 0.0
    angle = np.arange(16) * np.pi / 8
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    rings = np.concatenate([0.0 * ring[:1], 0.5 * ring, ring])
    z = np.linspace(-length / 2, length / 2, 4 * count + 1)
    points = np.column_stack([np.tile(rings, (len(z), 1)), np.repeat(z, len(rings))])
    return _Cover(center, np.full(count, radius + wide), points)


def _cells(
    center: np.ndarray, rotation: np.ndarray, half: np.ndarray, stick_out: float,
    hull: Hull | None = None,
) -> _Cover:  # fmt: skip
    """One sphere for each cell of a box, or for what of the hull lies in the cell."""
    count = _count(half, stick_out)
    cell = half / count
    index = np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), -1).reshape(-1, 3)
    local = ((2 * index + 1) * cell - half)[:, None] + _GRID * cell
    points = center + local @ rotation.T
    inside = np.ones(points.shape[:2], bool)
    if hull is not None:
        # A point speaks for its surroundings, up to halfway to the next.
        inside = _depth(points, hull) > -np.linalg.norm(cell) / 6
    used = inside.any(1)
    points, inside = points[used], inside[used]
    low = np.where(inside[..., None], local[used], np.inf).min(1)
    high = np.where(inside[..., None], local[used], -np.inf).max(1)
    middle = center + (low + high) / 2 @ rotation.T
    far = np.where(inside, np.linalg.norm(points - middle[:, None], axis=-1), 0.0).max(1)
    radius = np.maximum(far - MARGIN, cell.min() / 2)
    return _Cover(middle, radius, points[inside])


def _count(half: np.ndarray, stick_out: float) -> np.ndarray:
    """Cells along each axis, so that spheres around them stick out no further than allowed."""
    size = (stick_out + MARGIN) / (np.sqrt(3) - 1)
    while True:
        count = np.maximum(1, np.ceil(half / size - 1e-9)).astype(int)
        cell = half / count
        if np.prod(count) > MAX_CELLS:
            return np.maximum(1, count * (MAX_CELLS / np.prod(count)) ** (1 / 3)).astype(int)
        if np.linalg.norm(cell) - MARGIN - cell.min() <= stick_out:
            return count
        size *= 0.95


def _depth(points: Float[np.ndarray, "*n 3"], hull: Hull) -> Float[np.ndarray, "*n"]:
    """Distance of points to the nearest face of a hull, negative outside [m]."""
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    normal, a = (normal[length > 0] / length[length > 0, None], a[length > 0])
    offset = np.einsum("fk,fk->f", normal, a)
    planes = np.unique(np.round(np.column_stack([normal, offset]), 6), axis=0)
    return (planes[:, 3] - points @ planes[:, :3].T).min(-1)


def _needed(cover: _Cover) -> Float[np.ndarray, " s"]:
    """Indices of spheres without which some point would stay uncovered; small ones go first."""
    # A millimetre less, for what lies between the points.
    slack = MARGIN - 1e-3
    covers = cdist(cover.center, cover.points) <= cover.radius[:, None] + slack
    times = covers.sum(0)
    keep = np.ones(len(covers), bool)
    for s in np.argsort(cover.radius):
        if (times[covers[s]] > 1).all():
            keep[s] = False
            times -= covers[s]
    return np.flatnonzero(keep)
