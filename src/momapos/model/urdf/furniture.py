"""Read the URDF of furniture as it is drawn.

Files of furniture are often made to be looked at: links have visual shapes only, a visual mesh is
lost, COLLADA meshes lie on their backs. A robot's file is read as it is.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import Cache, UrdfError
from momapos.core.geometry import invert

from .articulated import CUT
from .convex_pieces import pieces_of, triangles_of
from .hulls import Hull, hull_of, unique_rows
from .meshes import mesh_bytes, mesh_digest, mesh_points, turned_up, up_axis
from .model_cache import once
from .reader import MeshFinder, read_urdf
from .urdf_records import Geometry, Link, Mesh, Urdf

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_MISSED = 0.03
"""Drawn shapes that get farther out of the collision shapes of their body are added to these: more
than what rounded edges, handles in simplified panels and overlapping fronts differ by [m]."""
MAX_PARTS = 50
"""Largest number of parts of a triangle's edge between sampled points [-]."""
MAX_SAMPLES = 20_000
"""Number of points to which those of a very detailed surface are thinned out [-]."""
MAX_NAMED = 4
"""Number of links that a note names [-]."""


def read_furniture(
    path: Path,
    *,
    root: Path | None = None,
    scale: float = 1.0,
    cache: Cache | None = None,
    text: str | None = None,
    visual_collisions: bool = True,
) -> Urdf:
    """Read the URDF of furniture; its notes say what differs from the file.

    A body is a link with all links that fixed joints join to it. If a body has no collision shapes,
    its visual shapes are its collision shapes. If it has some, visual shapes that get more than
    3 cm out of them are added. A visual mesh that does not exist or is damaged is left out if its
    body has other shapes. COLLADA meshes are turned so that their up axis is z.

    Args:
        path: The file.
        root: Folder that must contain all meshes, as for `read_urdf`.
        scale: Uniform scale of all lengths [-].
        cache: Cache for parsed files.
        text: Content to parse instead of the file's.
        visual_collisions: Whether visual shapes may be collision shapes; if not, a body that has
            only visual shapes is an error.

    Raises:
        UrdfError: The file is unusable.
    """
    visuals = _Visuals(MeshFinder(path, root), cache)
    urdf = read_urdf(path, root=root, scale=scale, cache=cache, text=text, find_visual=visuals.find)
    notes = list(urdf.notes)
    if visuals.lost:
        for links in rigid_bodies(urdf):
            shapes = any(urdf.links[n].collisions or urdf.links[n].visuals for n in links)
            first = next((visuals.lost[n] for n in links if n in visuals.lost), None)
            if first is not None and not shapes:
                raise first
        why = str(next(iter(visuals.lost.values()))).removeprefix(f"{path}: ")
        notes.append(f"{path}: left out visual meshes of {_names(list(visuals.lost))}: {why}")
    urdf = _turned_up(urdf, notes)
    urdf = _with_visual_collisions(urdf, visual_collisions, notes)
    if visual_collisions:
        urdf = _with_missed_visuals(urdf, cache, notes)
    return replace(urdf, notes=tuple(notes))


def rigid_bodies(urdf: Urdf) -> list[list[str]]:
    """Return the groups of links that fixed joints join, parents before children."""
    groups = {urdf.root: [urdf.root]}
    for joint in urdf.joints:
        groups[joint.child] = [] if joint.movable else groups[joint.parent]
        groups[joint.child].append(joint.child)
    return list({id(group): group for group in groups.values()}.values())


class _Visuals:
    """Finds visual meshes that can be read, and keeps why others can't."""

    def __init__(self, finder: MeshFinder, cache: Cache | None) -> None:
        self.finder, self.cache = finder, cache
        self.lost: dict[str, UrdfError] = {}

    def find(self, link: str, name: str) -> Path | None:
        try:
            mesh = self.finder.find(name)
            problem = _problem(mesh, self.cache)
        except UrdfError as error:
            problem = str(error)
        if not problem:
            return mesh
        self.lost.setdefault(link, UrdfError(problem))
        return None


def _problem(mesh: Path, cache: Cache | None) -> str:
    """Return why a mesh is unreadable; "" if it is not."""

    def compute() -> str:
        try:
            mesh_points(mesh)
        except UrdfError as error:
            return str(error)
        return ""

    stat = os.stat(mesh)
    return once(cache, "readable", (str(mesh), stat.st_size, stat.st_mtime_ns), compute)


def _turned_up(urdf: Urdf, notes: list[str]) -> Urdf:
    """Turn COLLADA meshes so that z is up."""
    turned: dict[str, str] = {}

    def shape(item: Geometry) -> Geometry:
        if not isinstance(item.mesh, Path) or item.mesh.suffix.lower() != ".dae":
            return item
        axis = up_axis(item.mesh, mesh_bytes(item.mesh))
        if axis == "Z_UP":
            return item
        turned[item.mesh.name] = axis
        T, size = turned_up(item.T_link_geometry, item.size, axis)
        return replace(item, T_link_geometry=T, size=size)

    links = {name: link.with_shapes(shape) for name, link in urdf.links.items()}
    if not turned:
        return urdf
    name, axis = next(iter(turned.items()))
    others = "" if len(turned) == 1 else f", and {len(turned) - 1} other meshes,"
    notes.append(
        f"{urdf.path}: {name}{others} says {axis} and is turned so that z is up; rviz does "
        "not turn it. If it stands upright there, write Z_UP"
    )
    return replace(urdf, links=links)


def _with_visual_collisions(urdf: Urdf, allowed: bool, notes: list[str]) -> Urdf:
    """Give bodies without collision shapes their visual shapes."""
    bare = [
        name
        for body in rigid_bodies(urdf)
        if not any(urdf.links[name].collisions for name in body)
        for name in body
        if urdf.links[name].visuals
    ]
    if not bare:
        return urdf
    if not allowed:
        raise UrdfError(
            f"{urdf.path}: no collision shapes of {_names(bare)}; add <collision> elements, or let "
            "visual shapes stand in (visual_collisions)"
        )
    notes.append(
        f"{urdf.path}: no collision shapes of {_names(bare)}; visual shapes are used instead"
    )
    changed = {
        name: replace(urdf.links[name], collisions=urdf.links[name].visuals) for name in bare
    }
    return replace(urdf, links={**urdf.links, **changed})


def _with_missed_visuals(urdf: Urdf, cache: Cache | None, notes: list[str]) -> Urdf:
    """Add the visual shapes that the collision shapes of their body miss.

    What a person sees stands in the way, whatever the file says.
    """
    added: dict[str, tuple[Geometry, ...]] = {}
    farthest = 0.0
    for body, poses in zip(rigid_bodies(urdf), _poses_in_bodies(urdf), strict=True):
        solid = [(poses[n], shape) for n in body for shape in urdf.links[n].collisions]
        drawn = [(n, shape) for n in body for shape in _only_drawn(urdf.links[n])]
        if not solid or not drawn:
            continue
        placed = [_placed(poses[n], shape) for n, shape in drawn]
        missed = _missed_pieces(placed, [_placed(T, shape) for T, shape in solid], cache)
        for (name, shape), pieces in zip(drawn, missed, strict=True):
            if pieces:
                shapes = _as_shapes(shape, invert(poses[name]), [hull for _, hull in pieces])
                added[name] = (*added.get(name, ()), *shapes)
                farthest = max(farthest, *(depth for depth, _ in pieces))
    if not added:
        return urdf
    notes.append(
        f"{urdf.path}: the collision shapes of {_names(list(added))} miss up to "
        f"{100 * farthest:.0f} cm of what is drawn; the drawn shapes are used, too"
    )
    links = {
        name: replace(urdf.links[name], collisions=(*urdf.links[name].collisions, *shapes))
        for name, shapes in added.items()
    }
    return replace(urdf, links={**urdf.links, **links})


def _poses_in_bodies(urdf: Urdf) -> list[dict[str, Float[np.ndarray, "4 4"]]]:
    """Return the poses of the links of each body in the frame of its first link."""
    fixed = {joint.child: joint for joint in urdf.joints if not joint.movable}
    found = []
    for body in rigid_bodies(urdf):
        poses = {body[0]: np.eye(4)}
        for name in body[1:]:
            poses[name] = poses[fixed[name].parent] @ fixed[name].T_parent_joint
        found.append(poses)
    return found


def _placed(T: Float[np.ndarray, "4 4"], shape: Geometry) -> Geometry:
    return replace(shape, T_link_geometry=T @ shape.T_link_geometry)


def _only_drawn(link: Link) -> list[Geometry]:
    """Return the visual shapes of a link that are not among its collision shapes."""

    def key(shape: Geometry) -> tuple[object, ...]:
        pose = np.round(shape.T_link_geometry, 6).tobytes()
        return shape.kind, tuple(np.round(shape.size, 6)), pose, shape.mesh

    solid = set(map(key, link.collisions))
    return [shape for shape in link.visuals if key(shape) not in solid]


def _as_shapes(
    shape: Geometry, T_link_body: Float[np.ndarray, "4 4"], pieces: Sequence[Hull]
) -> tuple[Geometry, ...]:
    """Return a drawn shape, or the pieces of a drawn mesh, as shapes of a link."""
    if shape.kind != "mesh":
        return (shape,)
    return tuple(
        replace(
            shape, size=(1.0, 1.0, 1.0), T_link_geometry=T_link_body, mesh=Mesh(h.vertices, h.faces)
        )
        for h in pieces
    )


def _missed_pieces(
    drawn: Sequence[Geometry], solid: Sequence[Geometry], cache: Cache | None
) -> Sequence[Sequence[tuple[float, Hull]]]:
    """Return the convex pieces of each drawn shape that get far out of the hulls of solid ones.

    Returns:
        For each drawn shape, how far each of its missed pieces gets out [m], and the piece.
    """

    def compute() -> list[list[tuple[float, Hull]]]:
        hulls = [_Planes.of(hull_of(shape)) for shape in solid]
        return [_missed(shape, hulls) for shape in drawn]

    def content(shape: Geometry) -> object:
        mesh = b"" if shape.mesh is None else mesh_digest(shape.mesh)
        return shape.kind, shape.size, shape.T_link_geometry.tobytes(), mesh

    key = tuple(map(content, drawn)), tuple(map(content, solid))
    return once(cache, "missed", key, compute, (Hull,))


class _Planes(NamedTuple):
    """Planes around a hull, and its corners."""

    equations: Float[np.ndarray, "_ 4"]
    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]

    @classmethod
    def of(cls, hull: Hull) -> _Planes:
        from scipy.spatial import ConvexHull

        equations = unique_rows(np.round(ConvexHull(hull.vertices).equations, 6))
        return cls(equations, hull.vertices.min(0), hull.vertices.max(0))

    def away(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return how far points are outside of the planes, which is at most as far as the hull."""
        return np.asarray((points @ self.equations[:, :3].T + self.equations[:, 3]).max(1))


def _missed(shape: Geometry, hulls: Sequence[_Planes]) -> list[tuple[float, Hull]]:
    if not _depth_outside(_triangles(shape), hulls):
        return []
    pieces = [(hull.vertices[hull.faces], hull) for hull in pieces_of(shape, hull_of(shape), CUT)]
    depths = [(_depth_outside(surface, hulls), hull) for surface, hull in pieces]
    return [(depth, hull) for depth, hull in depths if depth]


def _depth_outside(triangles: Float[np.ndarray, "t 3 3"], hulls: Sequence[_Planes]) -> float:
    """Return how far points of a surface are outside of all hulls [m]; 0 up to `MAX_MISSED`."""
    points = surface_points(triangles, MAX_MISSED)
    for hull in hulls:
        around = (points >= hull.low - MAX_MISSED) & (points <= hull.high + MAX_MISSED)
        close = np.flatnonzero(around.all(1))
        points = np.delete(points, close[hull.away(points[close]) <= MAX_MISSED], 0)
    if not len(points):
        return 0.0
    depth = float(np.min([hull.away(points) for hull in hulls], axis=0).max())
    return depth if depth > MAX_MISSED else 0.0


def _triangles(shape: Geometry) -> Float[np.ndarray, "t 3 3"]:
    """Return the triangles of a shape in the link frame; none of a mesh with unreadable faces."""
    if shape.kind != "mesh":
        hull = hull_of(shape)
        return hull.vertices[hull.faces]
    try:
        return triangles_of(shape)
    except UrdfError:  # drawn meshes may be damaged
        return np.empty((0, 3, 3))


def surface_points(
    triangles: Float[np.ndarray, "t 3 3"], spacing: float
) -> Float[np.ndarray, "n 3"]:
    """Return points on a surface, about as far apart as a spacing [m]; at most `MAX_SAMPLES`."""
    edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(1, initial=0.0)
    parts = np.clip(np.ceil(edges / spacing), 1, MAX_PARTS).astype(int)
    found = [np.empty((0, 3))]
    for n in np.unique(parts).tolist():
        i, j = np.mgrid[: n + 1, : n + 1].reshape(2, -1)
        weights = np.column_stack([i, j, n - i - j])[i + j <= n] / n
        found.append(np.einsum("wk,tkc->twc", weights, triangles[parts == n]).reshape(-1, 3))
    points = np.concatenate(found)
    return points[:: len(points) // MAX_SAMPLES + 1]


def _names(links: Sequence[str]) -> str:
    """Return the first names of links, in words."""
    more = len(links) - MAX_NAMED
    named = ", ".join(map(repr, links[:MAX_NAMED]))
    return f"link{'s' * (len(links) > 1)} {named}" + (f" and {more} more" if more > 0 else "")
