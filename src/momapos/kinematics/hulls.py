"""Collision shapes as convex hulls, and the boxes that cover them.

One convex hull per collision element is the exact geometry everywhere in momapos (as in most
physics engines); the boxes are what the batched kernels test.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numba import njit
from scipy.spatial import ConvexHull, QhullError

from momapos.errors import UrdfError
from momapos.geometry.transforms import apply
from momapos.kinematics.urdf import Geometry

MAX_MESH_BYTES = 200_000_000
MESH_SUFFIXES = (".obj", ".stl", ".dae", ".ply", ".off", ".glb")
SLACK = 1.25
"""A covering box may hold this many times the volume of its piece of hull [-]."""
FLAT = 1e-3
"""Thickness given to flat meshes [m]."""
MAX_FRAMES = 12
"""Face directions that a box is tried along [-]."""
_CIRCLE = 24


@dataclass(frozen=True)
class Hull:
    """A convex body fixed to a link."""

    vertices: Float[np.ndarray, "n 3"]
    """In the link frame [m]."""
    faces: Float[np.ndarray, "f 3"]
    """Vertex indices, anticlockwise seen from outside."""
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


def hull_of(geometry: Geometry, link: str = "") -> Hull:
    """Return the convex hull of a shape, in the link frame.

    Raises:
        UrdfError: The mesh cannot be read, is empty, or holds NaN.
    """
    if geometry.kind == "mesh":
        assert geometry.mesh is not None
        points = _mesh_points(geometry.mesh) * np.array(geometry.size)
    else:
        points = _primitive_points(geometry)
    vertices, faces = _convex(points, geometry.mesh)
    return Hull(apply(geometry.T_link_geometry, vertices), faces, geometry.name or link)


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


@lru_cache(maxsize=4096)
def _mesh_points_cached(path: Path, stamp: int) -> Float[np.ndarray, "n 3"]:
    import trimesh

    if path.stat().st_size > MAX_MESH_BYTES:
        raise UrdfError(f"{path}: mesh is larger than {MAX_MESH_BYTES // 1_000_000} MB")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise UrdfError(f"{path}: not a mesh that can be read; use {', '.join(MESH_SUFFIXES)}")
    if path.suffix.lower() == ".obj":
        # Vertices alone: materials and textures are neither needed nor trusted.
        lines = path.read_text(errors="replace").splitlines()
        try:
            rows = [[*map(float, x.split()[1:4])] for x in lines if x.startswith("v ")]
            points = np.array(rows, float).reshape(-1, 3)
        except ValueError as error:
            raise UrdfError(f"{path}: not a usable OBJ mesh ({error})") from error
    else:
        try:
            mesh: Any = trimesh.load(path, force="mesh")
            points = np.array(mesh.vertices, float)
        except Exception as error:  # trimesh raises whatever its many readers met
            reason = " ".join(str(error).split())
            raise UrdfError(f"{path}: not a usable mesh ({reason})") from error
    if len(points) == 0:
        raise UrdfError(f"{path}: the mesh is empty")
    if not np.isfinite(points).all():
        raise UrdfError(f"{path}: the mesh holds NaN or infinite vertices")
    if np.abs(points).max() > 1e7:
        far = np.abs(points).max()
        raise UrdfError(f"{path}: the mesh has a vertex at {far:g}; is it damaged?")
    return points


def _mesh_points(path: Path) -> Float[np.ndarray, "n 3"]:
    return _mesh_points_cached(path, path.stat().st_mtime_ns)


def _convex(points: Float[np.ndarray, "n 3"], path: Path | None) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and outward faces of the convex hull; flat point sets get 1 mm of thickness."""
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


def cover(hull: Hull, *, depth: int = 3) -> Boxes:
    """Cover a hull by oriented boxes, few and tight.

    The hull is cut in half across its longest axis while one box would hold more than `SLACK`
    times its volume, at most `depth` times.
    """
    boxes = _cover(hull.vertices[hull.faces], depth)
    return Boxes(*(np.stack(column) for column in zip(*boxes, strict=True)))


def fit_box(
    points: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Fit a small oriented box around points: centre, rotation (axes as columns), half edges."""
    vertices, faces = _convex(points, None)
    return _fit_box(vertices[faces])[:3]


def _cover(
    triangles: Float[np.ndarray, "f 3 3"], depth: int
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    center, rotation, half, volume = _fit_box(triangles)
    box_volume = float(np.prod(2 * half))
    # Slivers under a millilitre are never worth a second box.
    if depth == 0 or box_volume < SLACK * volume or box_volume < 1e-6:
        return [(center, rotation, half)]
    axis = rotation[:, int(np.argmax(half))]
    pieces = [_clip(triangles, side * axis, side * float(center @ axis)) for side in (-1.0, 1.0)]
    if any(len(piece) < 4 for piece in pieces):
        return [(center, rotation, half)]
    parts = [box for piece in pieces for box in _cover(piece, depth - 1)]
    saved = box_volume - sum(float(np.prod(2 * h)) for _, _, h in parts)
    return parts if saved > 0.1 * box_volume else [(center, rotation, half)]


@njit(cache=True, nogil=True)
def _clip(triangles: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Cut a convex body (f, 3, 3) down to normal . x <= offset, and close the cut.

    Each triangle that the plane crosses gives one edge of the cut; a fan from the middle of the
    cut to these edges closes it.
    """
    count = len(triangles)
    out, used = np.empty((3 * count, 3, 3)), 0
    edges, crossing = np.empty((count, 2, 3)), 0
    side, polygon = np.empty(3), np.empty((4, 3))
    for f in range(count):
        for k in range(3):
            side[k] = (
                triangles[f, k, 0] * normal[0] + triangles[f, k, 1] * normal[1]
                + triangles[f, k, 2] * normal[2] - offset
            )  # fmt: skip
        corners = 0
        for k in range(3):
            n = (k + 1) % 3
            if side[k] <= 0:
                polygon[corners] = triangles[f, k]
                corners += 1
            if (side[k] <= 0) != (side[n] <= 0):
                t = side[k] / (side[k] - side[n])
                polygon[corners] = triangles[f, k] + t * (triangles[f, n] - triangles[f, k])
                edges[crossing, 1 if side[k] <= 0 else 0] = polygon[corners]
                corners += 1
        for k in range(1, corners - 1):
            out[used, 0], out[used, 1], out[used, 2] = polygon[0], polygon[k], polygon[k + 1]
            used += 1
        if corners > 0 and side.max() > 0:
            crossing += 1
    middle = np.zeros(3)
    for e in range(crossing):
        middle += (edges[e, 0] + edges[e, 1]) / (2 * crossing)
    for e in range(crossing):
        out[used, 0], out[used, 1], out[used, 2] = middle, edges[e, 0], edges[e, 1]
        used += 1
    return out[:used].copy()


@njit(cache=True, nogil=True)
def _fit_box(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Fit a small oriented box around a convex body given by its surface (f, 3, 3).

    Of the frame's own axes, and frames built on the largest faces with their longest edge, the
    one whose box is smallest; the frame's own axes win ties, so that boxes stay recognisable.

    Returns:
        Centre (3,), rotation (3, 3) with the axes as columns, half edges (3,) [m], and the
        volume of the body [m^3].
    """
    count = len(triangles)
    normals, area, volume = np.empty((count, 3)), np.empty(count), 0.0
    for f in range(count):
        volume += _normal(triangles, f, normals) / 6
        area[f] = np.sqrt(normals[f, 0] ** 2 + normals[f, 1] ** 2 + normals[f, 2] ** 2)
    order = np.argsort(-area)
    frame, extent = np.eye(3), np.empty((2, 3))
    best_size, tried = 0.98 * _extent(triangles, frame, extent, np.inf), 0
    best, best_extent = np.eye(3), extent.copy()
    for f in order:
        if tried == MAX_FRAMES or area[f] < 1e-12:
            break
        if not _face_frame(triangles[f], normals[f], frame):
            continue
        tried += 1
        size = _extent(triangles, frame, extent, best_size)
        if size < best_size:
            best_size, best[:], best_extent[:] = size, frame, extent
    middle = np.zeros(3)
    for k in range(3):
        middle += best[:, k] * (best_extent[0, k] + best_extent[1, k]) / 2
    return middle, best, (best_extent[1] - best_extent[0]) / 2, volume


@njit(cache=True, nogil=True)
def _normal(triangles: np.ndarray, f: int, out: np.ndarray) -> float:
    """Write the normal of triangle f, twice its area long; return 6 times the volume below it."""
    a, b, c, o = triangles[f, 0], triangles[f, 1], triangles[f, 2], triangles[0, 0]
    x0, x1, x2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    y0, y1, y2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    n0, n1, n2 = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    out[f, 0], out[f, 1], out[f, 2] = n0, n1, n2
    return n0 * (a[0] - o[0]) + n1 * (a[1] - o[1]) + n2 * (a[2] - o[2])


@njit(cache=True, nogil=True)
def _face_frame(triangle: np.ndarray, normal: np.ndarray, frame: np.ndarray) -> bool:
    """Write the frame of a face to `frame`: x along its longest edge, z along its normal."""
    longest, first = -1.0, 0
    for k in range(3):
        length = 0.0
        for i in range(3):
            length += (triangle[(k + 1) % 3, i] - triangle[k, i]) ** 2
        if length > longest:
            longest, first = length, k
    frame[:, 2] = normal / np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    frame[:, 0] = triangle[(first + 1) % 3] - triangle[first]
    frame[:, 0] -= np.sum(frame[:, 0] * frame[:, 2]) * frame[:, 2]
    norm = np.sqrt(np.sum(frame[:, 0] ** 2))
    if norm < 1e-9:
        return False
    frame[:, 0] /= norm
    frame[:, 1] = np.cross(frame[:, 2], frame[:, 0])
    return True


@njit(cache=True, nogil=True)
def _extent(
    triangles: np.ndarray, frame: np.ndarray, extent: np.ndarray, enough: float
) -> float:
    """Write the bounds along the columns of a frame; stop where their volume is `enough`."""
    extent[0], extent[1] = np.inf, -np.inf
    volume = 0.0
    for f in range(len(triangles)):
        for c in range(3):
            x, y, z = triangles[f, c, 0], triangles[f, c, 1], triangles[f, c, 2]
            for k in range(3):
                value = x * frame[0, k] + y * frame[1, k] + z * frame[2, k]
                extent[0, k] = min(extent[0, k], value)
                extent[1, k] = max(extent[1, k], value)
        volume = 1.0
        for k in range(3):
            volume *= extent[1, k] - extent[0, k]
        if volume >= enough:
            break
    return volume
