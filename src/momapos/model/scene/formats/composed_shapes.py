"""Replace shapes that URDF lacks by URDF shapes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import FileFormatError
from momapos.core.geometry import pose
from momapos.model.urdf import Geometry, Mesh

if TYPE_CHECKING:
    from jaxtyping import Float

MIN_FLOOR_NORMAL_Z = 0.999
"""Minimum z of a unit normal for a plane to be a floor [-]."""
PLANE_THICKNESS = 0.02
"""Thickness of the box that replaces a bounded plane [m]."""
_BALL_RINGS = 12
"""Number of rings of the ball mesh [-]."""


def plane(x: float, y: float, T: Float[np.ndarray, "4 4"], name: str = "") -> Geometry:
    """Return a box behind a bounded plane with normal z.

    Args:
        x: Edge along x [m].
        y: Edge along y [m].
        T: Pose of the plane.
        name: Name of the shape.
    """
    return Geometry(
        "box", (x, y, PLANE_THICKNESS), T @ pose(np.array([0.0, 0.0, -PLANE_THICKNESS / 2])), name
    )


def ellipsoid(
    half: tuple[float, float, float], T: Float[np.ndarray, "4 4"], name: str = ""
) -> tuple[Geometry, Path, Mesh]:
    """Return an ellipsoid as a scaled ball mesh, with the file name and content of that mesh.

    Args:
        half: Half axes [m].
        T: Pose of the ellipsoid.
        name: Name of the shape.
    """
    file = Path("ball.obj")
    return Geometry("mesh", half, T, name, file), file, _ball()


def prism(
    polygon: Float[np.ndarray, "k 2"], height: float, error: Callable[[str], FileFormatError]
) -> Mesh:
    """Return the convex hull of an extruded polygon as a mesh, with z from -height/2 to height/2.

    Args:
        polygon: Its corners [m].
        height: Its extent along z [m].
        error: Makes the error for a polygon that encloses no area.
    """
    from scipy.spatial import QhullError

    ends = [np.pad(polygon, ((0, 0), (0, 1)), constant_values=z) for z in (-height / 2, height / 2)]
    try:
        return _hull_mesh(np.concatenate(ends))[0]
    except QhullError as reason:
        raise error("the polygon of a prism encloses no area") from reason


def _hull_mesh(points: Float[np.ndarray, "n 3"]) -> tuple[Mesh, Float[np.ndarray, " f"]]:
    """Return the convex hull as a mesh that is counterclockwise seen from outside, and the
    distances of its faces from the origin [m]."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    normals, faces = hull.equations[:, :3], hull.simplices.astype(np.int64)
    a0, b0, c0 = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("fi,fi->f", np.cross(b0 - a0, c0 - a0), normals) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Mesh(points, faces), -hull.equations[:, 3]


def _ball() -> Mesh:
    polar = np.linspace(0.0, np.pi, _BALL_RINGS + 1)[1:-1]
    around = np.linspace(0.0, 2 * np.pi, 2 * _BALL_RINGS, endpoint=False)
    p, a = (grid.ravel() for grid in np.meshgrid(polar, around, indexing="ij"))
    rings = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=1)
    points = np.vstack([rings, [[0, 0, 1], [0, 0, -1]]])
    mesh, away = _hull_mesh(points)
    return Mesh(points / np.abs(away).min(), mesh.faces)
