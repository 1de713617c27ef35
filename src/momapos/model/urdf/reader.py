"""Read untrusted URDF files, versions 1.0 to 1.2, into frozen records, scaled to meters.

`urdf_tree` checks the file; `link_elements` and `joint_elements` convert it; this module checks
which files the URDF names (none outside the root folder) and the result (a tree, unique names).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from momapos.core import Cache, UrdfError, read_text_bounded

from .coupling import follow
from .joint_elements import MAX_NAMED, JointReader, fix_equal_limits
from .link_elements import LinkReader
from .mesh_files import MeshFinder
from .model_cache import once
from .urdf_records import Geometry, Joint, JointKind, Link, Mesh, Mimic, Urdf
from .urdf_tree import (
    MAX_LINKS,
    MAX_URDF_BYTES,
    fix_root_joints,
    leftover_notes,
    mimics,
    read_tree,
    version_notes,
)

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
    actuated: bool = False,
) -> Urdf:
    """Read a URDF file; its notes say what is not honored, or read differently.

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
        actuated: Whether motors move the joints, as in robots: soft limits narrow their ranges, and
            joints with equal limits are fixed.

    Raises:
        UrdfError: The file is unusable.
    """
    if not (math.isfinite(scale) and scale > 0):
        raise UrdfError(f"{path}: scale must be a number > 0, not {scale}")
    content = read_text_bounded(path, MAX_URDF_BYTES, error=UrdfError) if text is None else text
    urdf, meshes = once(
        cache, "urdf", (content, scale, actuated),
        lambda: _parse(content, path, scale, actuated=actuated),
        (Urdf, Link, Joint, Geometry, Mimic),
    )  # fmt: skip
    finder = MeshFinder(path, root)
    if find_mesh is None:
        finder.check_packages(_needed(urdf, meshes, visuals=visuals and find_visual is None))
    find = find_mesh or finder.find
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


def _parse(text: str, path: Path, scale: float, *, actuated: bool) -> tuple[Urdf, tuple[str, ...]]:
    """Return a checked URDF without mesh files, and the names of these in order."""
    tree = read_tree(text, path)
    notes = [*version_notes(tree), *leftover_notes(tree)]
    rigid, follows = fix_root_joints(tree), mimics(tree, path, scale)
    elements = {link.get("name", ""): link for link in tree.findall("link")}
    if not elements:
        raise UrdfError(f"{path}: has no links")
    if len(elements) != len(tree.findall("link")):
        raise UrdfError(f"{path}: two links share a name; link names must be unique")
    by_joint = JointReader(path, scale, actuated=actuated)
    joints = [by_joint.joint(element) for element in tree.findall("joint")]
    duplicate = next((n for n, k in Counter(joint.name for joint in joints).items() if k > 1), None)
    if duplicate is not None:
        raise UrdfError(f"{path}: two joints are named {duplicate!r}; names must be unique")
    root_link, ordered = _order(path, list(elements), joints)
    kept = {root_link, *(joint.child for joint in ordered)}
    if len(kept) < len(elements):
        notes.append(_unconnected(root_link, [name for name in elements if name not in kept]))
    reader = LinkReader(path, scale)
    links = {name: reader.link(link) for name, link in elements.items() if name in kept}
    if actuated:
        ordered, follows = fix_equal_limits(ordered, follows, by_joint)
    movable = {joint.name for joint in ordered if joint.movable}
    # A mimic joint with a fixed leader moves by itself.
    follows = {n: m for n, m in follows.items() if n in movable and m.joint in movable}
    urdf = Urdf(
        tree.get("name", ""), None, root_link, links,
        follow(ordered, follows, str(path), UrdfError), scale, rigid,
        notes=tuple(f"{path}: {words}" for words in (*notes, *by_joint.words())),
        without_axis=tuple(by_joint.without_axis),
    )  # fmt: skip
    return urdf, tuple(reader.meshes)


def _needed(urdf: Urdf, meshes: Sequence[str], *, visuals: bool) -> list[str]:
    """Return the names of the meshes that must exist, of all meshes in the order of the links."""
    needed = [
        shapes is link.collisions or visuals
        for link in urdf.links.values()
        for shapes in (link.collisions, link.visuals)
        for shape in shapes
        if shape.kind == "mesh"
    ]
    return [name for name, used in zip(meshes, needed, strict=True) if used]


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


def _order(path: Path, links: list[str], joints: list[Joint]) -> tuple[str, list[Joint]]:
    """Sort joints with parents first, and check that they form a tree.

    Of several trees, the one with the most movable joints counts, and of equal ones the largest.
    """
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
    trees = {name: _below(name, by_parent) for name in links if name not in parents}
    if sum(map(len, trees.values())) != len(joints) or not trees:
        raise UrdfError(f"{path}: the joints form a loop; a URDF must be a tree")
    root = max(trees, key=lambda name: (sum(j.movable for j in trees[name]), len(trees[name])))
    return root, trees[root]


def _below(root: str, by_parent: dict[str, list[Joint]]) -> list[Joint]:
    """Return the joints below a link, parents first."""
    ordered: list[Joint] = []
    queue = [root]
    while queue:
        for joint in by_parent.get(queue.pop(0), []):
            ordered.append(joint)
            queue.append(joint.child)
    return ordered


def _unconnected(root: str, left_out: list[str]) -> str:
    more = len(left_out) - MAX_NAMED
    named = ", ".join(map(repr, left_out[:MAX_NAMED])) + (f" and {more} more" if more > 0 else "")
    return (
        f"no joint connects {named} to {root!r}, so their place is unknown; they are left out. Add "
        "a joint, or remove them"
    )
