"""Triangles of the links of a model, in each link's frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import UrdfError, owner_cache
from momapos.core.geometry import apply
from momapos.model.scene import SceneObject
from momapos.model.urdf import Articulated, Geometry, Hull, mesh_triangles

if TYPE_CHECKING:
    from jaxtyping import Float, Float32, Int, UInt32

MAX_TRIANGLES = 60_000
"""A shape with more triangles is drawn as its convex hull [-]."""
HANDLE = "handle"
"""Shapes and links with this in their names get another color."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles that are visible from their counterclockwise side."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]

    def moved(self, T: Float[np.ndarray, "4 4"]) -> Surface:
        """Transform the surface."""
        return Surface(apply(T, self.vertices), self.faces)

    @property
    def arrays(self) -> tuple[Float32[np.ndarray, "v 3"], UInt32[np.ndarray, "f 3"]]:
        """Vertices and faces in the types that viser sends."""
        return self.vertices.astype(np.float32), self.faces.astype(np.uint32)


@dataclass(frozen=True)
class LinkSurfaces:
    """The surfaces of one link."""

    link: str
    body: Surface
    handle: Surface
    """Shapes with "handle" in their names; no triangles where there is none."""


def joined(surfaces: Iterable[Surface]) -> Surface:
    """Join surfaces into one."""
    parts = [one for one in surfaces if len(one.faces)]
    if not parts:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    first = np.cumsum([0, *(len(one.vertices) for one in parts[:-1])])
    faces = [one.faces + k for one, k in zip(parts, first.tolist(), strict=True)]
    return Surface(np.concatenate([one.vertices for one in parts]), np.concatenate(faces))


def _hull_surface(hull: Hull) -> Surface:
    return Surface(hull.vertices, hull.faces)


@owner_cache()
def link_surfaces(model: Articulated, *, collision: bool = False) -> tuple[LinkSurfaces, ...]:
    """Return the surfaces of a model's links, without links that have no shapes.

    Args:
        model: The model.
        collision: Whether to use the collision hulls even where there are visuals.
    """
    found = []
    for name, link in model.urdf.links.items():
        if collision or not link.visuals:
            pairs = [(hull.name or name, _hull_surface(hull)) for hull in model.hulls[name]]
        else:
            pairs = [(shape.name or name, _surface(model, name, shape)) for shape in link.visuals]
        body = joined(surface for word, surface in pairs if not _is_handle(name, word))
        handle = joined(surface for word, surface in pairs if _is_handle(name, word))
        if len(body.faces) or len(handle.faces):
            found.append(LinkSurfaces(name, body, handle))
    return tuple(found)


def _is_handle(link: str, shape: str) -> bool:
    return HANDLE in link.lower() or HANDLE in shape.lower()


def _surface(model: Articulated, link: str, shape: Geometry) -> Surface:
    """Return the surface of a shape: the triangles of a mesh if they are readable, else a hull."""
    if shape.kind == "mesh" and shape.mesh is not None:
        try:
            triangles = mesh_triangles(shape.mesh) * np.array(shape.size)
        except UrdfError:  # a mesh without readable faces still has a hull
            triangles = np.zeros((0, 3, 3))
        if 0 < len(triangles) <= MAX_TRIANGLES:
            if np.prod(shape.size) < 0:  # mirrored: inside out
                triangles = triangles[:, ::-1]
            return _merged(apply(shape.T_link_geometry, triangles.reshape(-1, 3)))
    return _hull_surface(model.hull(link, shape))


def _merged(corners: Float[np.ndarray, "c 3"]) -> Surface:
    """Build a surface from three corners per triangle, and merge equal ones.

    A browser then gets about a tenth of the vertices; shading is flat anyway.
    """
    points, at = np.unique(corners, axis=0, return_inverse=True)
    return Surface(points, at.reshape(-1, 3))


def world_surface(
    item: SceneObject, part: Callable[[LinkSurfaces], Surface], *, collision: bool = False
) -> Surface:
    """Return the bodies or the handles of all links of an object, in the world.

    Args:
        item: The object.
        part: Selects the body or the handle of a link.
        collision: As for `link_surfaces`.
    """
    poses = item.link_poses()
    links = link_surfaces(item.model, collision=collision)
    return joined(part(link).moved(poses[link.link]) for link in links)


def facing(surface: Surface, point: Float[np.ndarray, "3"]) -> Surface:
    """Select the triangles whose front faces a point.

    Walls drawn this way hide nothing of the room from outside.
    """
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    front = np.einsum("fk,fk->f", np.cross(b - a, c - a), point - a) > 0
    return Surface(surface.vertices, surface.faces[front])
