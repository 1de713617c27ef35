"""Read untrusted URDF files into frozen records, scaled to meters.

yourdfpy parses. `urdf_tree` checks its input; this module checks which files the URDF names (none
outside the root folder) and the result (a tree, finite numbers, ordered limits).
"""

from __future__ import annotations

import io
import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, tostring

import numpy as np

from momapos.core import Cache, UrdfError, read_text_bounded

from .coupling import follow
from .mesh_files import MeshFinder
from .model_cache import once
from .urdf_records import Geometry, Joint, JointKind, Link, Mesh, Mimic, Urdf
from .urdf_tree import (
    MAX_LINKS,
    MAX_URDF_BYTES,
    fix_root_joints,
    inertials,
    mimics,
    needed,
    read_tree,
)

if TYPE_CHECKING:
    from jaxtyping import Float

__all__ = [
    "MAX_LINKS",
    "MAX_URDF_BYTES",
    "Geometry",
    "Joint",
    "JointKind",
    "Link",
    "Mesh",
    "Mimic",
    "Urdf",
    "box_urdf",
    "read_urdf",
]


FindMesh = Callable[[str], Path]
"""Returns the path of a mesh that a URDF names."""
FindVisual = Callable[[str, str], Path | None]
"""Returns the path of a visual mesh, given its link and its name; None to leave it out."""


def read_urdf(
    path: Path,
    *,
    root: Path | None = None,
    scale: float = 1.0,
    cache: Cache | None = None,
    text: str | None = None,
    find_mesh: FindMesh | None = None,
    find_visual: FindVisual | None = None,
    visuals: bool = True,
) -> Urdf:
    """Read a URDF file.

    Args:
        path: The file.
        root: Folder that must contain all meshes; by default the folder four levels above the file
            (packages have meshes next to the `urdf` folder).
        scale: Uniform scale of all lengths [-].
        cache: Cache for parsed files.
        text: Content to parse instead of the file's.
        find_mesh: Function to find meshes instead of `MeshFinder`.
        find_visual: Function to find visual meshes; by default as for collisions.
        visuals: Whether to read visual elements; if not, their meshes need not exist.

    Raises:
        UrdfError: The file is unusable.
    """
    if not (math.isfinite(scale) and scale > 0):
        raise UrdfError(f"{path}: scale must be a number > 0, not {scale}")
    content = read_text_bounded(path, MAX_URDF_BYTES, error=UrdfError) if text is None else text
    urdf, meshes = once(
        cache, "urdf", (content, scale), lambda: _parse(content, path, scale),
        (Urdf, Link, Joint, Geometry, Mimic),
    )  # fmt: skip
    find = find_mesh or MeshFinder(path, root).find
    drawn = find_visual or (lambda _, name: find(name))
    urdf = _with_meshes(urdf, path, iter(meshes), find, drawn if visuals else lambda *_: None)
    if visuals:
        return urdf
    return replace(
        urdf, links={name: replace(link, visuals=()) for name, link in urdf.links.items()}
    )


def box_urdf(name: str, size: tuple[float, float, float]) -> Urdf:
    """Build the model of a rigid box, its frame at the center."""
    shape = Geometry("box", size, np.eye(4))
    return Urdf(name, None, "box", {"box": Link("box", (shape,), (shape,))}, ())


def _parse(text: str, path: Path, scale: float) -> tuple[Urdf, tuple[str, ...]]:
    """Return a checked URDF without mesh files, and the names of these in order."""
    tree = read_tree(text, path)
    rigid, follows = fix_root_joints(tree), mimics(tree, path, scale)
    masses = inertials(tree, path, scale)
    robot = _with_yourdfpy(tree, path)
    reader = _Reader(path, scale)
    links = {link.name: reader.link(link) for link in robot.links}
    links |= {n: replace(links[n], mass=m, center=at) for n, (m, at) in masses.items()}
    if len(links) != len(robot.links):
        raise UrdfError(f"{path}: two links share a name; link names must be unique")
    joints = [reader.joint(joint) for joint in robot.joints]
    duplicate = next((n for n, k in Counter(joint.name for joint in joints).items() if k > 1), None)
    if duplicate is not None:
        raise UrdfError(f"{path}: two joints are named {duplicate!r}; names must be unique")
    root_link, ordered = _order(path, links, joints)
    movable = {joint.name for joint in ordered if joint.movable}
    # A mimic joint with a fixed leader moves by itself.
    follows = {n: m for n, m in follows.items() if n in movable and m.joint in movable}
    ordered = follow(ordered, follows, str(path), UrdfError)
    urdf = Urdf(robot.name or path.stem, None, root_link, links, ordered, scale, rigid)
    return urdf, tuple(reader.meshes)


def _with_yourdfpy(tree: Element, path: Path) -> Any:
    import yourdfpy

    text = tostring(needed(tree))
    try:
        urdf = yourdfpy.URDF.load(io.BytesIO(text), build_scene_graph=False, load_meshes=False)
    except Exception as error:  # yourdfpy raises errors of any class
        raise UrdfError(f"{path}: not a usable URDF ({error})") from error
    if not urdf.robot.links:
        raise UrdfError(f"{path}: has no links")
    return urdf.robot


class _Reader:
    """Converts yourdfpy's records to ours, scaled and checked."""

    def __init__(self, path: Path, scale: float) -> None:
        self.path, self.scale = path, scale
        self.meshes: list[str] = []

    def link(self, link: Any) -> Link:
        shapes = [
            tuple(self.geometry(link.name, item) for item in items if item.geometry is not None)
            for items in (link.collisions, link.visuals)
        ]
        return Link(link.name, shapes[0], shapes[1])

    def geometry(self, link: str, item: Any) -> Geometry:
        T, g, s = self.transform(item.origin), item.geometry, self.scale
        name = item.name or ""
        if g.mesh is not None:
            factor = np.ones(3) if g.mesh.scale is None else np.broadcast_to(g.mesh.scale, 3)
            shape = Geometry("mesh", tuple(s * factor), T, name)
            self.meshes.append(g.mesh.filename)
        elif g.box is not None:
            shape = Geometry("box", tuple(s * np.asarray(g.box.size, float)), T, name)
        elif g.cylinder is not None:
            shape = Geometry("cylinder", (s * g.cylinder.radius, s * g.cylinder.length), T, name)
        elif g.sphere is not None:
            shape = Geometry("sphere", (s * g.sphere.radius,), T, name)
        else:
            raise UrdfError(f"{self.path}: a shape of link {link!r} has no geometry")
        sizes = np.abs(shape.size)
        if not (len(sizes) and np.isfinite(sizes).all() and sizes.min() > 0):
            raise UrdfError(f"{self.path}: a {shape.kind} of link {link!r} has size {shape.size}")
        return shape

    def transform(self, origin: Any) -> Float[np.ndarray, "4 4"]:
        T = np.eye(4) if origin is None else np.array(origin, float)
        T[:3, 3] *= self.scale
        return T

    def joint(self, joint: Any) -> Joint:
        kind, where = joint.type, f"{self.path}: joint {joint.name!r}"
        if kind not in ("revolute", "continuous", "prismatic", "fixed"):
            raise UrdfError(
                f"{where} is {kind!r}; revolute, continuous, prismatic and fixed are supported"
            )
        axis = np.array([1.0, 0.0, 0.0] if joint.axis is None else joint.axis, float)
        length = float(np.linalg.norm(axis))
        if kind != "fixed" and length < 1e-9:
            raise UrdfError(f"{where} has a zero axis")
        lower, upper = self.limits(where, kind, joint.limit)
        velocity = getattr(joint.limit, "velocity", None) or math.inf
        effort = getattr(joint.limit, "effort", None) or math.inf
        unit = axis / length if length > 1e-9 else axis
        T = self.transform(joint.origin)
        ends = joint.parent, joint.child
        return Joint(joint.name, kind, *ends, T, unit, lower, upper, velocity, effort=effort)

    def limits(self, where: str, kind: str, limit: Any) -> tuple[float, float]:
        if kind == "fixed":
            return 0.0, 0.0
        lower, upper = getattr(limit, "lower", None), getattr(limit, "upper", None)
        if kind == "continuous" or (lower is None and upper is None):
            return -math.inf, math.inf
        factor = self.scale if kind == "prismatic" else 1.0
        lower, upper = factor * (lower or 0.0), factor * (upper or 0.0)
        if lower > upper:
            raise UrdfError(f"{where} has lower limit {lower:g} above upper limit {upper:g}")
        return lower, upper


def _with_meshes(
    urdf: Urdf,
    path: Path,
    names: Iterator[str],
    find: FindMesh,
    find_visual: Callable[[str, str], Path | None],
) -> Urdf:
    """Add the paths of a URDF and of its meshes to its record."""

    def found(
        shapes: tuple[Geometry, ...], find_one: Callable[[str], Path | None]
    ) -> tuple[Geometry, ...]:
        meshes = [find_one(next(names)) if shape.kind == "mesh" else None for shape in shapes]
        return tuple(
            replace(shape, mesh=mesh)
            for shape, mesh in zip(shapes, meshes, strict=True)
            if shape.kind != "mesh" or mesh is not None
        )

    links = {
        name: replace(
            link,
            collisions=found(link.collisions, find),
            visuals=found(link.visuals, partial(find_visual, name)),
        )
        for name, link in urdf.links.items()
    }
    return replace(urdf, path=path, links=links)


def _order(
    path: Path, links: dict[str, Link], joints: list[Joint]
) -> tuple[str, tuple[Joint, ...]]:
    """Sort joints with parents first, and check that they form one tree."""
    by_parent: dict[str, list[Joint]] = {}
    parents: dict[str, str] = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise UrdfError(f"{path}: joint {joint.name!r} names a missing link {link!r}")
        if joint.child in parents:
            raise UrdfError(f"{path}: link {joint.child!r} has two parents (a loop); need a tree")
        parents[joint.child] = joint.parent
        by_parent.setdefault(joint.parent, []).append(joint)
    roots = [name for name in links if name not in parents]
    if not roots:
        raise UrdfError(f"{path}: the joints form a loop; a URDF must be a tree")
    ordered: list[Joint] = []
    queue = [roots[0]]
    while queue:
        for joint in by_parent.get(queue.pop(0), []):
            ordered.append(joint)
            queue.append(joint.child)
    if len(ordered) != len(joints):
        raise UrdfError(f"{path}: the joints form a loop; a URDF must be a tree")
    if len(roots) > 1:
        raise UrdfError(f"{path}: links {roots[0]!r} and {roots[1]!r} are not connected")
    return roots[0], tuple(ordered)
