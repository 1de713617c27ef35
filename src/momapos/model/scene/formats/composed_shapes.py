"""Replace shapes that URDF lacks by URDF shapes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

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


def capsule(
    radius: float, length: float, T: Float[np.ndarray, "4 4"], name: str = ""
) -> list[Geometry]:
    """Return a capsule along z as a cylinder and two balls, which is exact.

    Args:
        radius: Radius [m].
        length: Length of the straight part [m].
        T: Pose of the capsule.
        name: Name of all three shapes.
    """
    ends = (pose(np.array([0.0, 0.0, z])) for z in (length / 2, -length / 2))
    balls = [Geometry("sphere", (radius,), T @ end, name) for end in ends]
    return [Geometry("cylinder", (radius, length), T, name), *balls]


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


def _ball() -> Mesh:
    from scipy.spatial import ConvexHull

    polar = np.linspace(0.0, np.pi, _BALL_RINGS + 1)[1:-1]
    around = np.linspace(0.0, 2 * np.pi, 2 * _BALL_RINGS, endpoint=False)
    p, a = (grid.ravel() for grid in np.meshgrid(polar, around, indexing="ij"))
    rings = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=1)
    points = np.vstack([rings, [[0, 0, 1], [0, 0, -1]]])
    hull = ConvexHull(points)
    normals, faces = hull.equations[:, :3], hull.simplices.astype(np.int64)
    a0, b0, c0 = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("fi,fi->f", np.cross(b0 - a0, c0 - a0), normals) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Mesh(points / np.abs(hull.equations[:, 3]).min(), faces)
