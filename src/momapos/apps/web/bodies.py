"""What things look like: triangles of the links of a model, in each link's frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import UrdfError
from momapos.core.geometry import apply
from momapos.model.scene import SceneObject
from momapos.model.urdf import Articulated, Geometry, Hull, mesh_triangles

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MOST_TRIANGLES = 60_000
"""A shape with more triangles is drawn as its convex hull [-]."""
HANDLE = "handle"
"""Shapes and links with this in their names are set off by their color."""


@dataclass(frozen=True)
class Surface:
    """Triangles that are seen from their counterclockwise side."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]

    def moved(self, T: Float[np.ndarray, "4 4"]) -> Surface:
        """The same surface somewhere else."""
        return Surface(apply(T, self.vertices), self.faces)

    def only(self, faces: Bool[np.ndarray, " f"]) -> Surface:
        """Some of its triangles."""
        return Surface(self.vertices, self.faces[faces])

    @property
    def normals(self) -> Float[np.ndarray, "f 3"]:
        """Of each triangle, as long as twice its area [m^2]."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)


@dataclass(frozen=True)
class LinkLook:
    """What one link looks like."""

    link: str
    body: Surface
    handle: Surface
    """What a hand may take hold of, by its name; without triangles where there is none."""


def joined(surfaces: Iterable[Surface]) -> Surface:
    """Many surfaces as one."""
    parts = [one for one in surfaces if len(one.faces)]
    if not parts:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    first = np.cumsum([0, *(len(one.vertices) for one in parts[:-1])])
    faces = [one.faces + k for one, k in zip(parts, first.tolist(), strict=True)]
    return Surface(np.concatenate([one.vertices for one in parts]), np.concatenate(faces))


def hull_surface(hull: Hull) -> Surface:
    """The surface of a convex hull."""
    return Surface(hull.vertices, hull.faces)


@lru_cache(maxsize=1024)
def looks(model: Articulated, *, collision: bool = False) -> tuple[LinkLook, ...]:
    """What the links of a model look like, those without shapes left out.

    Args:
        model: The model.
        collision: Whether to take the hulls that are checked, even where there are visuals.
    """
    found = []
    for name, link in model.urdf.links.items():
        if collision or not link.visuals:
            pairs = [(hull.name or name, hull_surface(hull)) for hull in model.hulls[name]]
        else:
            pairs = [(shape.name or name, _surface(model, name, shape)) for shape in link.visuals]
        body = joined(surface for word, surface in pairs if not _is_handle(name, word))
        handle = joined(surface for word, surface in pairs if _is_handle(name, word))
        if len(body.faces) or len(handle.faces):
            found.append(LinkLook(name, body, handle))
    return tuple(found)


def _is_handle(link: str, shape: str) -> bool:
    return HANDLE in link.lower() or HANDLE in shape.lower()


def _surface(model: Articulated, link: str, shape: Geometry) -> Surface:
    """A shape of a link; of a mesh its own triangles where they can be read."""
    if shape.kind == "mesh" and shape.mesh is not None:
        try:
            triangles = mesh_triangles(shape.mesh) * np.array(shape.size)
        except UrdfError:  # the points of a mesh without readable faces have a hull
            triangles = np.zeros((0, 3, 3))
        if 0 < len(triangles) <= MOST_TRIANGLES:
            if np.prod(shape.size) < 0:  # mirrored: what was outside is inside
                triangles = triangles[:, ::-1]
            return _sharing_corners(apply(shape.T_link_geometry, triangles.reshape(-1, 3)))
    return hull_surface(model.hull(link, shape))


def _sharing_corners(corners: Float[np.ndarray, "c 3"]) -> Surface:
    """Triangles by their corners, three each; those at one place are one vertex.

    A browser gets, and moves, a tenth of the vertices; each triangle is lit by itself anyway.
    """
    points, at = np.unique(corners, axis=0, return_inverse=True)
    return Surface(points, at.reshape(-1, 3))


def standing(
    item: SceneObject, part: Callable[[LinkLook], Surface], *, collision: bool = False
) -> Surface:
    """One part of all links of an object, in the world.

    Args:
        item: The object.
        part: The body or the handle of a link.
        collision: As for `looks`.
    """
    poses = item.link_poses()
    return joined(
        part(look).moved(poses[look.link]) for look in looks(item.model, collision=collision)
    )


def facing(surface: Surface, point: Float[np.ndarray, "3"]) -> Surface:
    """The triangles of a surface that a point lies in front of.

    Walls of which only these are drawn hide nothing of the room from without.
    """
    corner = surface.vertices[surface.faces[:, 0]]
    return surface.only(np.einsum("fk,fk->f", surface.normals, point - corner) > 0)
