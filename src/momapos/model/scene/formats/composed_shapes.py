"""Shapes that a URDF has no word for, made of those that it has."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import pose
from momapos.model.urdf import Geometry

from .imported_room import Mesh

if TYPE_CHECKING:
    from jaxtyping import Float

LEVEL = 0.999
"""A plane whose normal has at least this share along z is a floor [-]."""
THICK = 0.02
"""Thickness of the box that stands for a plane with edges [m]."""
_RINGS = 12
"""Of the ball that stands for ellipsoids and its like [-]."""


def capsule(
    radius: float, length: float, T: Float[np.ndarray, "4 4"], name: str = ""
) -> list[Geometry]:
    """A capsule along z: a cylinder and two balls, which is exact.

    Args:
        radius: Its radius [m].
        length: Of its straight part [m].
        T: Its pose.
        name: Of all three shapes.
    """
    ends = (pose(np.array([0.0, 0.0, z])) for z in (length / 2, -length / 2))
    balls = [Geometry("sphere", (radius,), T @ end, name) for end in ends]
    return [Geometry("cylinder", (radius, length), T, name), *balls]


def plane(x: float, y: float, T: Float[np.ndarray, "4 4"], name: str = "") -> Geometry:
    """A box behind a plane with edges, whose normal is z.

    Args:
        x: Edge along x [m].
        y: Edge along y [m].
        T: Its pose.
        name: Of the shape.
    """
    return Geometry("box", (x, y, THICK), T @ pose(np.array([0.0, 0.0, -THICK / 2])), name)


def ellipsoid(
    half: tuple[float, float, float], T: Float[np.ndarray, "4 4"], name: str = ""
) -> tuple[Geometry, Path, Mesh]:
    """An ellipsoid as a mesh of a ball that is scaled, and that ball by the name of its file.

    Args:
        half: Its half axes [m].
        T: Its pose.
        name: Of the shape.
    """
    file = Path("ball.obj")
    return Geometry("mesh", half, T, name, file), file, _ball()


def _ball() -> Mesh:
    """A ball of radius 1 as a mesh whose faces are outside of it."""
    from scipy.spatial import ConvexHull

    polar = np.linspace(0.0, np.pi, _RINGS + 1)[1:-1]
    around = np.linspace(0.0, 2 * np.pi, 2 * _RINGS, endpoint=False)
    p, a = (grid.ravel() for grid in np.meshgrid(polar, around, indexing="ij"))
    rings = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=1)
    points = np.vstack([rings, [[0, 0, 1], [0, 0, -1]]])
    hull = ConvexHull(points)
    normals, faces = hull.equations[:, :3], hull.simplices.astype(np.int64)
    a0, b0, c0 = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("fi,fi->f", np.cross(b0 - a0, c0 - a0), normals) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Mesh(points / np.abs(hull.equations[:, 3]).min(), faces)
