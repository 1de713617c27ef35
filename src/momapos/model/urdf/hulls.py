"""Collision shapes as convex hulls, and the boxes that cover them.

One convex hull per collision element is the exact geometry everywhere in momapos (as in most
physics engines); the boxes are what the batched kernels test.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import UrdfError
from momapos.core.geometry import apply

from .meshes import mesh_points
from .reader import Geometry

if TYPE_CHECKING:
    from jaxtyping import Float, Int

SLACK = 1.25
"""A covering box may hold this many times the volume of its piece of hull [-]."""
FLAT = 1e-3
"""Thickness given to flat meshes [m]."""
MAX_FRAMES = 12
"""Face directions that a box is tried along [-]."""
SMALL = 1e-5
"""Boxes of less than this are never cut [m^3]."""
WORTH = 0.1
"""Share of a box's volume that a cut must save [-]."""
STRIPS_FROM = 0.08
"""Upright cylinders with a larger radius are covered by strips [m]."""
STRIPS = 10
"""Strips across a wide cylinder; they stick out by 5 % of the radius [-]."""
THIN = 1e-4
"""Boxes with an edge up to this may be flat [m]."""
_BOX_FACES = np.array([
    [0, 2, 6], [6, 4, 0], [0, 4, 5], [5, 1, 0], [4, 6, 5], [5, 6, 7],
    [3, 2, 0], [0, 1, 3], [3, 6, 2], [7, 6, 3], [1, 5, 3], [3, 5, 7],
])  # fmt: skip
"""How Qhull divides the faces of every box with its corners in order."""
_CIRCLE = 24
_Box = tuple[np.ndarray, np.ndarray, np.ndarray, float]
"""Center, rotation, half edges, and the volume of the body inside."""


@dataclass(frozen=True)
class Hull:
    """A convex body fixed to a link."""

    vertices: Float[np.ndarray, "n 3"]
    """In the link frame [m]."""
    faces: Int[np.ndarray, "f 3"]
    """Vertex indices, counterclockwise seen from outside."""
    name: str


@dataclass(frozen=True)
class Boxes:
    """Oriented boxes."""

    center: Float[np.ndarray, "b 3"]
    rotation: Float[np.ndarray, "b 3 3"]
    """Columns are the box axes."""
    half: Float[np.ndarray, "b 3"]
    """Half edges [m]."""

    def __len__(self) -> int:
        return len(self.center)


@dataclass(frozen=True)
class MovingBoxes:
    """Oriented boxes at each of the values that a joint takes."""

    center: Float[np.ndarray, "v m 3"]
    rotation: Float[np.ndarray, "v m 3 3"]
    """Columns are the box axes."""
    half: Float[np.ndarray, "v m 3"]
    """Half edges [m]."""

    def at(self, value: int) -> Boxes:
        """The boxes at one value, given by its index."""
        return Boxes(self.center[value], self.rotation[value], self.half[value])

    def sweep(self) -> Boxes:
        """The boxes at all values, as one set."""
        return Boxes(
            self.center.reshape(-1, 3), self.rotation.reshape(-1, 3, 3), self.half.reshape(-1, 3)
        )


def hull_of(geometry: Geometry, link: str = "") -> Hull:
    """Return the convex hull of a shape, in the link frame.

    Raises:
        UrdfError: The mesh cannot be read, is empty, or holds NaN.
    """
    if geometry.kind == "mesh":
        assert geometry.mesh is not None
        points = mesh_points(geometry.mesh) * np.array(geometry.size)
    else:
        points = _primitive_points(geometry)
    if geometry.kind == "box" and min(geometry.size) > THIN:
        vertices, faces = _unique_rows(np.round(points, 7)), _BOX_FACES.copy()
    else:
        vertices, faces = _convex(points, geometry.mesh)
    return Hull(apply(geometry.T_link_geometry, vertices), faces, geometry.name or link)


def hull_around(points: Float[np.ndarray, "n 3"], name: str) -> Hull:
    """Return the convex hull of points; flat ones get 1 mm of thickness."""
    return Hull(*_convex(points, None), name)


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


def _convex(points: Float[np.ndarray, "n 3"], path: Path | None) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and outward faces of the convex hull; flat point sets get 1 mm of thickness."""
    from scipy.spatial import ConvexHull, QhullError

    points = _unique_rows(np.round(points, 7))
    spread = np.linalg.svd(points - points.mean(0), full_matrices=False)[1]
    flat = len(points) < 4 or spread[-1] < 1e-6 * np.sqrt(len(points))
    try:
        hull = ConvexHull(_thicken(points) if flat else points)
    except QhullError:
        try:
            hull = ConvexHull(_thicken(points), qhull_options="QJ")
        except QhullError as error:
            raise UrdfError(f"{path}: the mesh has no volume") from error
    index = np.full(len(hull.points), -1)
    index[hull.vertices] = np.arange(len(hull.vertices))
    vertices, faces = hull.points[hull.vertices], index[hull.simplices]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return vertices, faces


def _unique_rows(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """Sort rows and drop repetitions, as `np.unique` does, but faster."""
    rows = points[np.lexsort(points.T[::-1])]
    return rows[np.r_[True, (rows[1:] != rows[:-1]).any(1)]]


def _thicken(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    _, _, basis = np.linalg.svd(points - points.mean(0), full_matrices=True)
    a, b = FLAT / 2 * basis[-1], FLAT / 2 * basis[-2]
    return np.vstack([points + s * a + t * b for s in (-1, 1) for t in (-1, 1)])


def cover_shape(geometry: Geometry, hull: Hull) -> Boxes:
    """Cover a shape by boxes: a box by itself, a wide upright cylinder by strips, else its hull."""
    T = geometry.T_link_geometry
    if geometry.kind == "box":
        return Boxes(T[None, :3, 3], T[None, :3, :3], np.array([geometry.size]) / 2)
    if geometry.kind == "cylinder" and geometry.size[0] > STRIPS_FROM and T[2, 2] > 0.99:
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
    """Cover a hull by oriented boxes, few and tight.

    The hull is cut in half across its longest axis while one box would hold more than `SLACK`
    times its volume, at most `depth` times.
    """
    boxes = _cover(hull.vertices, hull.faces, depth, _fit_box(hull.vertices, hull.faces))
    center, rotation, half, _ = zip(*boxes, strict=True)
    return Boxes(np.stack(center), np.stack(rotation), np.stack(half))


def fit_box(
    points: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Fit a small oriented box around points: center, rotation (axes as columns), half edges."""
    vertices, faces = _convex(points, None)
    return _fit_box(vertices, faces)[:3]


def slab(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    axis: Float[np.ndarray, "3"],
    low: float,
    high: float = np.inf,
) -> Float[np.ndarray, "n 3"]:
    """Points whose hull is the part of a convex body between two planes across an axis.

    Args:
        vertices, faces: The body.
        axis: Unit vector.
        low, high: Where the planes are along the axis [m].

    Returns:
        None, as an array (0, 3), where nothing of the body is there.
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
    if depth == 0 or size < SLACK * volume or size < SMALL:
        return [box]
    axis = rotation[:, int(np.argmax(half))]
    pieces = [
        _clip(vertices, faces, side * axis, side * float(center @ axis)) for side in (-1.0, 1.0)
    ]
    if any(piece is None for piece in pieces):
        return [box]
    halves = [(*piece, _fit_box(*piece)) for piece in pieces if piece]
    # A cut that saves nothing at once is not followed further: it would cost many boxes.
    if sum(_volume(fit) for _, _, fit in halves) > (1 - WORTH) * size:
        return [box]
    return [part for v, f, fit in halves for part in _cover(v, f, depth - 1, fit)]


def _volume(box: _Box) -> float:
    return float(np.prod(2 * box[2]))


def _clip(
    vertices: np.ndarray, faces: np.ndarray, normal: np.ndarray, offset: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """The part of a convex body with normal . x <= offset; None where it has no volume."""
    from scipy.spatial import ConvexHull, QhullError

    side = vertices @ normal - offset
    # Both ways, as qhull does not orient the faces of a piece.
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

    Of the frame's own axes, and frames built on the largest faces with each of their edges (the
    longest of a triangle may be the diagonal of a rectangle), the one whose box is smallest; the
    frame's own axes win ties, so that boxes stay recognisable.

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
    """Row-wise a x b; `np.cross` takes ten times as long on few rows."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]
