"""Convert USD colliders to our shapes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import FileFormatError
from momapos.core.geometry import invert, pose, pose_rpy
from momapos.model.urdf import MAX_POINTS, Geometry, Mesh, capsule_shapes

from .composed_shapes import ellipsoid
from .imported_room import ImportReport

if TYPE_CHECKING:
    from jaxtyping import Float, Int

SCALE_TOLERANCE = 1e-4
"""Relative tolerance for equal scales, and tolerance for right angles [-]."""
_QUARTER = np.pi / 2
_TURNED = {"X": (0.0, _QUARTER, 0.0), "Y": (-_QUARTER, 0.0, 0.0), "Z": (0.0, 0.0, 0.0)}
"""Rotations from z to the axis of a round shape."""


def matrix(found: Any) -> Float[np.ndarray, "4 4"]:
    """Return a USD matrix, which multiplies row vectors, for column vectors."""
    return np.array(found, float).T


def rigid(T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return the nearest transform without scale."""
    u, _, vt = np.linalg.svd(T[:3, :3])
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return pose(T[:3, 3], turn)


class ColliderShapes:
    """Converts colliders to shapes, and counts approximations."""

    kinds = ("Cube", "Sphere", "Cylinder", "Capsule", "Cone", "Mesh", "Plane")

    def __init__(self, report: ImportReport) -> None:
        self.report = report
        self.meshes: dict[Path, Mesh] = {}

    def shapes(
        self, prim: Any, T_world: Float[np.ndarray, "4 4"], T_world_link: Float[np.ndarray, "4 4"]
    ) -> list[Geometry]:
        """Return the shapes of a collider.

        Args:
            prim: The collider.
            T_world: Transform of its coordinates to the world in meters, which may scale.
            T_world_link: Pose of its link.

        Raises:
            FileFormatError: The size or the vertices are invalid.
        """
        kind, name = str(prim.GetTypeName()), prim.GetName()
        T = invert(T_world_link) @ T_world
        if kind == "Mesh":
            return [self._mesh(*_corners(prim), T, name)]
        if kind == "Plane":
            self.report.dropped["planes"] += 1
            return []
        scale = np.linalg.norm(T[:3, :3], axis=0)
        straight = T[:3, :3] / np.maximum(scale, 1e-12)
        if np.abs(straight.T @ straight - np.eye(3)).max() > SCALE_TOLERANCE:
            raise FileFormatError(f"{prim.GetPath()}: a {kind} is sheared; use a mesh instead")
        place = rigid(T)
        if kind == "Cube":
            edge = _size(prim, "size", 2.0)
            return [Geometry("box", tuple((edge * scale).tolist()), place, name)]
        if kind == "Sphere":
            half = _size(prim, "radius", 1.0) * scale
            if np.ptp(half) <= SCALE_TOLERANCE * half.max():
                return [Geometry("sphere", (float(half[0]),), place, name)]
            self.report.approximated["ellipsoids as meshes"] += 1
            shape, file, mesh = ellipsoid((half[0], half[1], half[2]), place, name)
            self.meshes[file] = mesh
            return [shape]
        return self._round(prim, kind, scale, place, name)

    def _round(
        self,
        prim: Any,
        kind: str,
        scale: Float[np.ndarray, "3"],
        place: Float[np.ndarray, "4 4"],
        name: str,
    ) -> list[Geometry]:
        axis = str(prim.GetAttribute("axis").Get() or "Z")
        along = "XYZ".index(axis)
        across = np.delete(scale, along)
        radius = _size(prim, "radius", 0.5 if kind == "Capsule" else 1.0) * float(across.max())
        height = _size(prim, "height", 1.0 if kind == "Capsule" else 2.0) * float(scale[along])
        if np.ptp(across) > SCALE_TOLERANCE * across.max():
            self.report.approximated["elliptic round shapes as circular ones"] += 1
        T = place @ pose_rpy((0.0, 0.0, 0.0), _TURNED[axis])
        if kind == "Capsule":
            return capsule_shapes(radius, height, T, name)
        self.report.approximated["cones as cylinders"] += kind == "Cone"
        return [Geometry("cylinder", (radius, height), T, name)]

    def _mesh(
        self,
        points: Float[np.ndarray, "v 3"],
        faces: Int[np.ndarray, "f 3"],
        T: Float[np.ndarray, "4 4"],
        name: str,
    ) -> Geometry:
        place = rigid(T)
        local = (points @ T[:3, :3].T) @ place[:3, :3]
        file = Path(f"mesh{len(self.meshes)}.obj")
        self.meshes[file] = Mesh(local, faces)
        return Geometry("mesh", (1.0, 1.0, 1.0), place, name, file)


def _size(prim: Any, key: str, otherwise: float) -> float:
    value = prim.GetAttribute(key).Get()
    size = otherwise if value is None else float(value)
    if not 0 < size < 1e6:
        raise FileFormatError(f"{prim.GetPath()}: {key} must be > 0, not {size:g}")
    return size


def _corners(prim: Any) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Return the vertices of a mesh, and its faces split into triangles."""
    found = [
        prim.GetAttribute(k).Get() for k in ("points", "faceVertexCounts", "faceVertexIndices")
    ]
    points = np.array(found[0] if found[0] is not None else [], float).reshape(-1, 3)
    counts, corners = (np.array(f if f is not None else [], np.int64) for f in found[1:])
    where = f"{prim.GetPath()}: a mesh"
    if not 4 <= len(points) <= MAX_POINTS or len(corners) > MAX_POINTS:
        raise FileFormatError(f"{where} has {len(points)} vertices; it must have 4 to {MAX_POINTS}")
    if not np.isfinite(points).all():
        raise FileFormatError(f"{where} contains NaN or infinite vertices")
    if (counts < 0).any() or counts.sum() != len(corners):
        raise FileFormatError(
            f"{where} has faces with {counts.sum()} vertices, but {len(corners)} vertex indices"
        )
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise FileFormatError(f"{where} names a vertex that does not exist")
    fans = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, fans)
    step = np.arange(len(first)) - np.repeat(np.cumsum(fans) - fans, fans)
    faces = np.stack([corners[first], corners[first + step + 1], corners[first + step + 2]], axis=1)
    return points, faces
