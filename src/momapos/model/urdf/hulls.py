"""Convex hulls of collision shapes, and boxes that cover them.

Throughout momapos, as in most physics engines, the exact geometry is one convex hull per collision
element. The batched kernels test the boxes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import UrdfError, look
from momapos.core.geometry import apply

from .meshes import surface_vertices
from .reader import Geometry

if TYPE_CHECKING:
    from jaxtyping import Float, Int

MAX_VOLUME_RATIO = 1.25
"""Largest ratio of a covering box's volume to that of its part of the hull [-]."""
FLAT_THICKNESS = 1e-3
"""Thickness given to flat meshes [m]."""
MAX_FRAMES = 12
"""Number of face directions to try for a box [-]."""
MIN_CUT_VOLUME = 1e-5
"""Smaller boxes are not cut [m^3]."""
MIN_SAVING = 0.1
"""Smallest share of a box's volume that a cut must save [-]."""
MIN_STRIP_RADIUS = 0.08
"""Upright cylinders with a larger radius are covered by strips [m]."""
STRIPS = 10
"""Number of strips across a wide cylinder; they protrude by 5 % of the radius [-]."""
MIN_BOX_EDGE = 1e-4
"""Boxes with a shorter edge may count as flat [m]."""
_BOX_FACES = np.array([
    [0, 2, 6], [6, 4, 0], [0, 4, 5], [5, 1, 0], [4, 6, 5], [5, 6, 7],
    [3, 2, 0], [0, 1, 3], [3, 6, 2], [7, 6, 3], [1, 5, 3], [3, 5, 7],
])  # fmt: skip
"""Qhull's triangles of a box whose corners are in order."""
_CIRCLE = 24
_Box = tuple[np.ndarray, np.ndarray, np.ndarray, float]
"""Center, rotation, half edges, and the volume of the body inside."""


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex body fixed to a link."""

    vertices: Float[np.ndarray, "n 3"]
    """Vertices in the link frame [m]."""
    faces: Int[np.ndarray, "f 3"]
    """Vertex indices, counterclockwise as seen from outside."""
    name: str


@dataclass(frozen=True, eq=False)
class Boxes:
    """Oriented boxes."""

    center: Float[np.ndarray, "b 3"]
    rotation: Float[np.ndarray, "b 3 3"]
    """Columns are the box axes."""
    half: Float[np.ndarray, "b 3"]
    """Half edges [m]."""

    def __len__(self) -> int:
        return len(self.center)

    @cached_property
    def extent(self) -> Float[np.ndarray, "b 3"]:
        """Half edges of the boxes around them that are aligned with the axes [m]."""
        return np.einsum("bij,bj->bi", np.abs(self.rotation), self.half)

    def take(self, rows: Int[np.ndarray, " k"]) -> Boxes:
        """Return a subset of the boxes."""
        return Boxes(self.center[rows], self.rotation[rows], self.half[rows])

    def moved(self, T: Float[np.ndarray, "4 4"]) -> Boxes:
        """Transform the boxes."""
        return Boxes(apply(T, self.center), T[:3, :3] @ self.rotation, self.half)

    @classmethod
    def join(cls, parts: Iterable[Boxes]) -> Boxes:
        """Concatenate sets of boxes."""
        every = [cls(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3))), *parts]
        return cls(
            np.concatenate([part.center for part in every]),
            np.concatenate([part.rotation for part in every]),
            np.concatenate([part.half for part in every]),
        )


@dataclass(frozen=True, eq=False)
class MovingBoxes:
    """Oriented boxes at each of several joint values."""

    center: Float[np.ndarray, "v m 3"]
    rotation: Float[np.ndarray, "v m 3 3"]
    """Columns are the box axes."""
    half: Float[np.ndarray, "v m 3"]
    """Half edges [m]."""

    @classmethod
    def join(cls, parts: Sequence[MovingBoxes]) -> MovingBoxes:
        """Concatenate one or more sets of boxes, which have the same number of values."""
        return cls(
            np.concatenate([part.center for part in parts], axis=1),
            np.concatenate([part.rotation for part in parts], axis=1),
            np.concatenate([part.half for part in parts], axis=1),
        )

    def at(self, value: int) -> Boxes:
        """Return the boxes at the value with an index."""
        return Boxes(self.center[value], self.rotation[value], self.half[value])

    def sweep(self) -> Boxes:
        """Return the boxes at all values, as one set."""
        return Boxes(
            self.center.reshape(-1, 3), self.rotation.reshape(-1, 3, 3), self.half.reshape(-1, 3)
        )


def hull_of(geometry: Geometry, link: str = "") -> Hull:
    """Return the convex hull of a shape, in the link frame.

    Raises:
        UrdfError: The mesh is unreadable, empty, or contains NaN.
    """
    if geometry.kind == "mesh":
        assert geometry.mesh is not None
        points = surface_vertices(geometry.mesh) * np.array(geometry.size)
    else:
        points = _primitive_points(geometry)
    if geometry.kind == "box" and min(geometry.size) > MIN_BOX_EDGE:
        vertices, faces = unique_rows(np.round(points, 7)), _BOX_FACES.copy()
    else:
        file = geometry.mesh if isinstance(geometry.mesh, Path) else None
        vertices, faces = _convex(points, str(file or link))
    return Hull(apply(geometry.T_link_geometry, vertices), faces, geometry.name or link)


def hull_around(points: Float[np.ndarray, "n 3"], name: str) -> Hull:
    """Return the convex hull of points; flat sets get a thickness of 1 mm."""
    return Hull(*_convex(points, name), name)


def _primitive_points(geometry: Geometry) -> Float[np.ndarray, "n 3"]:
    if geometry.kind == "box":
        corners = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T
        return corners * np.array(geometry.size)
    angle = np.linspace(0, 2 * np.pi, _CIRCLE, endpoint=False)
    if geometry.kind == "cylinder":
        radius, length = geometry.size
        radius /= np.cos(np.pi / _CIRCLE)  # the prism contains the cylinder
        ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)
        return np.vstack([np.column_stack([ring, np.full(_CIRCLE, z)]) for z in (-1, 1)]) * (
            1.0,
            1.0,
            length / 2,
        )
    import trimesh

    return np.array(trimesh.creation.icosphere(2, geometry.size[0] * 1.02).vertices)


def _convex(points: Float[np.ndarray, "n 3"], where: str) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and outward faces of the convex hull; see `hull_around`."""
    from scipy.spatial import ConvexHull, QhullError

    look()
    points = unique_rows(np.round(points, 7))
    spread = np.linalg.svd(points - points.mean(0), full_matrices=False)[1]
    flat = len(points) < 4 or spread[-1] < 1e-6 * np.sqrt(len(points))
    try:
        hull = ConvexHull(_thicken(points) if flat else points)
    except QhullError:
        try:
            hull = ConvexHull(_thicken(points), qhull_options="QJ")
        except QhullError as error:
            raise UrdfError(f"{where}: the mesh has no volume") from error
    index = np.full(len(hull.points), -1)
    index[hull.vertices] = np.arange(len(hull.vertices))
    vertices, faces = hull.points[hull.vertices], index[hull.simplices]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return vertices, faces


def unique_rows(points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "m d"]:
    """Sort rows and drop duplicates, faster than `np.unique`."""
    rows = points[np.lexsort(points.T[::-1])]
    return rows[np.r_[True, (rows[1:] != rows[:-1]).any(1)]]


def _thicken(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    _, _, basis = np.linalg.svd(points - points.mean(0), full_matrices=True)
    a, b = FLAT_THICKNESS / 2 * basis[-1], FLAT_THICKNESS / 2 * basis[-2]
    return np.vstack([points + s * a + t * b for s in (-1, 1) for t in (-1, 1)])


def cover_shape(geometry: Geometry, hull: Hull) -> Boxes:
    """Cover a shape by boxes: a wide upright cylinder by strips, other shapes as in `cover`."""
    T = geometry.T_link_geometry
    if geometry.kind == "box":
        return Boxes(T[None, :3, 3], T[None, :3, :3], np.array([geometry.size]) / 2)
    if geometry.kind == "cylinder" and geometry.size[0] > MIN_STRIP_RADIUS and T[2, 2] > 0.99:
        radius, length = geometry.size
        edge = radius * np.cos(np.linspace(np.pi, 0, STRIPS + 1))
        nearest = np.where(
            edge[:-1] * edge[1:] < 0, 0.0, np.minimum(*np.abs([edge[:-1], edge[1:]]))
        )
        center = np.zeros((STRIPS, 3))
        center[:, 0] = (edge[:-1] + edge[1:]) / 2
        half = np.stack(
            [np.diff(edge) / 2, np.sqrt(radius**2 - nearest**2), np.full(STRIPS, length / 2)], -1
        )
        return Boxes(apply(T, center), np.repeat(T[None, :3, :3], STRIPS, axis=0), half)
    return cover(hull)


def cover(hull: Hull, *, depth: int = 3) -> Boxes:
    """Cover a hull by few, tight oriented boxes.

    The hull is halved across its longest axis, up to `depth` times, while its box has more than
    `MAX_VOLUME_RATIO` times its volume.
    """
    boxes = _cover(hull.vertices, hull.faces, depth, _fit_box(hull.vertices, hull.faces))
    center, rotation, half, _ = zip(*boxes, strict=True)
    return Boxes(np.stack(center), np.stack(rotation), np.stack(half))


def fit_box(
    points: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Fit a small oriented box around points: center, rotation (axes as columns), half edges."""
    vertices, faces = _convex(points, "a set of points")
    return _fit_box(vertices, faces)[:3]


def slab(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    axis: Float[np.ndarray, "3"],
    low: float,
    high: float = np.inf,
) -> Float[np.ndarray, "n 3"]:
    """Return points whose hull is the part of a convex body between two planes across an axis.

    Args:
        vertices, faces: The body.
        axis: Unit vector.
        low, high: Positions of the planes along the axis [m].

    Returns:
        The points, (0, 3) if no part of the body is between the planes.
    """
    at = vertices @ axis
    a, b = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).T
    points = [vertices[(low <= at) & (at <= high)]]
    for plane in (low, high):
        cut = (at[a] - plane) * (at[b] - plane) < 0
        t = (plane - at[a[cut]]) / (at[b[cut]] - at[a[cut]])
        points.append(vertices[a[cut]] + t[:, None] * (vertices[b[cut]] - vertices[a[cut]]))
    return np.concatenate(points)


def _cover(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], depth: int, box: _Box
) -> list[_Box]:
    center, rotation, half, volume = box
    size = _volume(box)
    if depth == 0 or size < MAX_VOLUME_RATIO * volume or size < MIN_CUT_VOLUME:
        return [box]
    axis = rotation[:, int(np.argmax(half))]
    pieces = [
        _clip(vertices, faces, side * axis, side * float(center @ axis)) for side in (-1.0, 1.0)
    ]
    if any(piece is None for piece in pieces):
        return [box]
    halves = [(*piece, _fit_box(*piece)) for piece in pieces if piece]
    # Stop if this cut saves too little: further cuts would add many boxes.
    if sum(_volume(fit) for _, _, fit in halves) > (1 - MIN_SAVING) * size:
        return [box]
    return [part for v, f, fit in halves for part in _cover(v, f, depth - 1, fit)]


def _volume(box: _Box) -> float:
    return float(np.prod(2 * box[2]))


def _clip(
    vertices: np.ndarray, faces: np.ndarray, normal: np.ndarray, offset: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the part of a convex body with normal . x <= offset, or None if it has no volume."""
    from scipy.spatial import ConvexHull, QhullError

    side = vertices @ normal - offset
    # Both directions, since qhull does not orient the faces of a piece.
    edges = faces[:, [0, 1, 1, 2, 2, 0, 1, 0, 2, 1, 0, 2]].reshape(-1, 2)
    a, b = edges[(side[edges[:, 0]] < 0) & (side[edges[:, 1]] > 0)].T
    t = side[a] / (side[a] - side[b])
    crossing = vertices[a] + t[:, None] * (vertices[b] - vertices[a])
    try:
        hull = ConvexHull(np.vstack([vertices[side <= 0], crossing]))
    except (QhullError, ValueError):
        return None
    return hull.points, hull.simplices


def _fit_box(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> _Box:
    """Fit a small oriented box around a convex body given by its surface.

    Candidates are the frame's own axes, and frames from the largest faces with each of their edges
    (the longest edge of a triangle may be the diagonal of a rectangle). The frame's own axes win
    ties, so that boxes stay recognizable.

    Returns:
        Center (3,), rotation (3, 3) with the axes as columns, half edges (3,) [m], and the
        volume of the body [m^3].
    """
    corners = vertices[faces]
    edges = corners[:, [1, 2, 0]] - corners
    normals = _cross(edges[:, 0], edges[:, 1])
    area = np.sqrt(np.einsum("fi,fi->f", normals, normals))
    volume = float(np.abs(np.einsum("fi,fi->f", normals, corners[:, 0] - vertices.mean(0))).sum())
    top = np.argsort(-area, kind="stable")[:MAX_FRAMES]
    top = top[area[top] > 1e-12]
    z = np.repeat(normals[top] / area[top, None], 3, axis=0)
    x = edges[top].reshape(-1, 3)
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    frames = np.concatenate([np.eye(3)[None], np.stack([x, _cross(z, x), z], axis=-1)])
    local = vertices @ frames
    low, high = local.min(1), local.max(1)
    size = np.prod(high - low, axis=1)
    size[0] *= 0.98
    best = int(np.argmin(size))
    middle = frames[best] @ ((low[best] + high[best]) / 2)
    return middle, frames[best], (high[best] - low[best]) / 2, volume / 6


def _cross(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Return a x b per row; `np.cross` takes 10 times as long for few rows."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]
