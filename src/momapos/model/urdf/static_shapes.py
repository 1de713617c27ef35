"""Shapes of collision elements that stand still: tighter than those of moving parts.

A mesh whose hull is mostly free space, such as a carcass, a table with legs or a tray, is cut into
convex pieces. Hulls that a box covers loosely, such as those of round tables, get strips.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from momapos.core import UrdfError

from .convex_pieces import CutConfig, free_volume, pieces_of, triangles_of
from .hulls import STRIPS, Boxes, Hull, cover_shape, fit_box, slab
from .reader import Geometry

MIN_FREE_SHARE = 1 / 3
"""A mesh is hollow if at least this share of its hull is free: the hull has 1.5 times the volume of
the rest. 172 of 912 meshes of real furniture have it [-]."""
MIN_FREE_VOLUME = 5e-3
"""A mesh is hollow if its hull has at least this free volume, about that of a hand with a wrist; 60
of the 172 meshes have it [m^3]."""
MAX_REMAINING_VOLUME = 1 / 1.5
"""Pieces are used if they have at most this share of the hull's volume [-]."""
CUT = CutConfig(max_void=2e-3, max_pieces=16, max_slabs=4, min_slab=0.003, min_even_slab=0.05)
"""Coarser than for handles. The 60 meshes take 17 s instead of 276 s to cut, once; the pieces have
59 % of the hull's volume instead of 42 % (medians)."""
MAX_LOOSENESS = 0.05
"""Boxes whose corners are farther outside of their hull are replaced by strips; the base keeps a
similar distance [m]."""
MIN_STRIP_SAVING = 0.1
"""Smallest share of the boxes' volume that strips must save [-]."""


@dataclass(frozen=True, eq=False)
class StaticElement:
    """A collision element where it stands still."""

    hulls: tuple[Hull, ...]
    """Its convex hull, or its convex pieces."""
    boxes: Boxes
    """Boxes that cover the hulls."""
    hollow_mesh: str
    """Name of its mesh file if much of the mesh's hull is free space; else ""."""

    def label(self, link: str, *, static: bool) -> str:
        """Return a link's name, with what stands for its mesh if that is not the mesh.

        Args:
            link: The link.
            static: Whether the element stands still; moving elements are hulls.
        """
        if not self.hollow_mesh:
            return link
        part = "piece" if static and len(self.hulls) > 1 else "hull"
        return f"{link} ({part} of {self.hollow_mesh})"


def static_element(geometry: Geometry, hull: Hull) -> StaticElement:
    """Return a collision element as it is checked where it stands still."""
    pieces: tuple[Hull, ...] = (hull,)
    hollow_mesh = ""
    if geometry.mesh is not None and _is_hollow(geometry, hull):
        mesh = geometry.mesh
        hollow_mesh = mesh.name if isinstance(mesh, Path) else "its mesh"
        found = pieces_of(geometry, hull, CUT)
        if sum(map(volume_of, found)) <= MAX_REMAINING_VOLUME * volume_of(hull):
            pieces = found
    if len(pieces) == 1:
        return StaticElement(pieces, _cover(geometry, hull), hollow_mesh)
    boxes = Boxes.join(_cover(geometry, piece) for piece in pieces)
    return StaticElement(pieces, boxes, hollow_mesh)


def _is_hollow(geometry: Geometry, hull: Hull) -> bool:
    volume = volume_of(hull)
    if volume < MIN_FREE_VOLUME:
        return False
    try:
        free = free_volume(triangles_of(geometry))
    except UrdfError:  # its faces are damaged, which its hull does not need
        return False
    return free > max(MIN_FREE_VOLUME, MIN_FREE_SHARE * volume)


def volume_of(hull: Hull) -> float:
    """Return the volume of a convex body [m^3]."""
    a, b, c = (hull.vertices - hull.vertices.mean(0))[hull.faces].transpose(1, 0, 2)
    return float(np.abs(np.einsum("ij,ij->i", a, np.cross(b, c))).sum()) / 6


def _cover(geometry: Geometry, hull: Hull) -> Boxes:
    """Cover a hull by boxes, or by strips if these are tighter."""
    boxes = cover_shape(geometry, hull)
    if geometry.kind == "box" or _looseness(boxes, hull) <= MAX_LOOSENESS:
        return boxes
    strips = min((_strips(hull, axis) for axis in range(3)), key=_volume)
    return strips if _volume(strips) < (1 - MIN_STRIP_SAVING) * _volume(boxes) else boxes


def _looseness(boxes: Boxes, hull: Hull) -> float:
    """Return how far corners of boxes are outside of the planes of a hull's faces [m]."""
    a, b, c = hull.vertices[hull.faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    kept = length > 1e-12
    normals = normals[kept] / length[kept, None]
    signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    local = signs[None] * boxes.half[:, None]
    corners = (boxes.center[:, None] + np.einsum("bij,bkj->bki", boxes.rotation, local)).reshape(
        -1, 3
    )
    return float((corners @ normals.T - (a[kept] * normals).sum(1)).max())


def _strips(hull: Hull, axis: int) -> Boxes:
    """Cover a hull by strips across an axis of the box around it, narrow at its ends."""
    center, R, half = fit_box(hull.vertices)
    edges = half[axis] * np.cos(np.linspace(np.pi, 0, STRIPS + 1))
    at = float(center @ R[:, axis])
    bounds = []
    for low, high in zip(edges[:-1] + at, edges[1:] + at, strict=True):
        points = slab(hull.vertices, hull.faces, R[:, axis], low - 1e-9, high + 1e-9) @ R
        bounds.append((points.min(0), points.max(0)))
    low, high = np.array(bounds).transpose(1, 0, 2)
    return Boxes((low + high) / 2 @ R.T, np.repeat(R[None], STRIPS, axis=0), (high - low) / 2)


def _volume(boxes: Boxes) -> float:
    return float(np.prod(2 * boxes.half, axis=1).sum())
