"""Read the URDF of furniture as it is drawn.

Files of furniture are often made to be looked at: links have visual shapes only, a visual mesh is
lost, COLLADA meshes lie on their backs. A robot's file is read as it is.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from momapos.core import Cache, UrdfError

from .collada import turned_up, up_axis
from .mesh_files import MeshFinder
from .meshes import mesh_bytes, mesh_points
from .model_cache import once
from .reader import read_urdf
from .urdf_records import Geometry, Link, Urdf

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
    its visual shapes are its collision shapes. A visual mesh that does not exist or is damaged is
    left out if its body has other shapes. COLLADA meshes are turned so that their up axis is z.

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

    links = {
        name: Link(name, tuple(map(shape, link.collisions)), tuple(map(shape, link.visuals)))
        for name, link in urdf.links.items()
    }
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


def _names(links: Sequence[str]) -> str:
    """Return the first names of links, in words."""
    more = len(links) - MAX_NAMED
    named = ", ".join(map(repr, links[:MAX_NAMED]))
    return f"link{'s' * (len(links) > 1)} {named}" + (f" and {more} more" if more > 0 else "")
