"""Measure the free space that the convex hulls of meshes fill."""

from __future__ import annotations

from .articulated import Articulated
from .convex_pieces import MAX_TRIANGLES, free_share
from .meshes import mesh_triangles


def hull_space(model: Articulated, link: str, element: int) -> tuple[float, float]:
    """Return the volume of a collision element's hull, and of the free space in it [m^3].

    Primitives have no free space. That of meshes with more than `MAX_TRIANGLES` is not measured and
    counts as zero.

    Raises:
        UrdfError: The faces of its mesh are unreadable.
    """
    shape = model.urdf.links[link].collisions[element]

    def measure() -> tuple[float, float]:
        assert shape.mesh is not None
        triangles = mesh_triangles(shape.mesh) * shape.size
        return free_share(triangles) if 0 < len(triangles) <= MAX_TRIANGLES else (0.0, 0.0)

    if shape.kind != "mesh":
        return 0.0, 0.0
    return model.cached("hull-space", measure, link, element)
