"""Read untrusted URDF files, versions 1.0 to 1.2, into frozen records, scaled to meters.

`urdf_tree` checks the file and converts its elements; this module checks
which files the URDF names (none outside the root folder) and the result (a tree, unique names).
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from momapos.core import Cache, FileFormatError, UrdfError, read_text_bounded, resolved

from .model_cache import once
from .packages import MAX_MESH_PARENTS, find_package, not_found
from .urdf_records import Geometry, Joint, JointKind, Link, Mesh, Mimic, Urdf
from .urdf_tree import (
    MAX_LINKS,
    MAX_NAMED,
    MAX_URDF_BYTES,
    JointReader,
    LinkReader,
    fix_equal_limits,
    fix_root_joints,
    follow,
    leftover_notes,
    mimics,
    read_tree,
    version_notes,
)

_SCHEME = re.compile(r"^(package|file|model)://")


@dataclass(frozen=True)
class MeshFinder:
    """Finds the meshes of one URDF."""

    path: Path
    """The URDF."""
    root: Path | None = None
    """Folder that must contain all meshes; None: `MAX_MESH_PARENTS` folders above the URDF."""
    packages: Mapping[str, Path] = field(default_factory=dict)
    """Folders of packages by name, which may contain meshes, too."""

    def find(self, filename: str) -> Path:
        """Find a mesh; unknown packages are searched in the URDF's parent folders.

        Raises:
            UrdfError: The mesh does not exist, or is outside the allowed folders.
        """
        scheme, relative = _SCHEME.match(filename), _SCHEME.sub("", filename)
        kind = scheme[1] if scheme else ""
        absolute = kind == "file" and relative.startswith("/")
        name, _, rest = relative.partition("/")
        package = None
        try:
            if kind == "package" and name not in self.packages:
                package = self._package(name)
            found = self._in(package, rest) or self._look(kind, relative)
            found = found or (self._elsewhere(relative) if absolute else None)
            folder, *_ = self._folders
            outside = not self._allowed(resolved(folder / relative))
        except (FileFormatError, OSError) as error:  # too long, cyclic links, a NUL
            raise UrdfError(f"{self.path}: mesh {filename!r:.80} cannot be looked up") from error
        if found is not None:
            return found
        if absolute:
            lost = _package_of(relative)
            raise UrdfError(
                f"{self.path}: mesh {filename!r} does not exist here, or is outside {self._root}; "
                f"give the folder {lost!r} of that path: --package {lost}=DIR of momapos robot "
                "check, [packages] in a robot file"
            )
        if outside:
            raise UrdfError(
                f"{self.path}: mesh {filename!r} is outside {self._root}; move it inside"
            )
        if package is not None:
            raise UrdfError(f"{self.path}: mesh {rest!r} does not exist in the package {package}")
        if kind == "package" and name not in self.packages:
            raise UrdfError(f"{self.path}: mesh {filename!r}: {not_found([name], self._folders)}")
        beside = resolved(self.path).parent
        where = self.packages.get(name, self._root) if scheme else beside
        raise UrdfError(f"{self.path}: mesh {filename!r} does not exist below {where}")

    def check_packages(self, filenames: Iterable[str]) -> None:
        """Check whether several packages of meshes, or folders of absolute paths, are missing.

        Raises:
            UrdfError: Two or more are missing; it names all of them.
        """
        lost: dict[str, None] = {}
        for filename in filenames:
            scheme, relative = _SCHEME.match(filename), _SCHEME.sub("", filename)
            kind = scheme[1] if scheme else ""
            absolute = kind == "file" and relative.startswith("/")
            name = _package_of(relative) if absolute else relative.partition("/")[0]
            if not (absolute or kind == "package") or name in lost or name in self.packages:
                continue
            with suppress(FileFormatError, OSError):
                found = self._elsewhere(relative) if absolute else self._package(name)
                if found is None and self._look(kind, relative) is None:
                    lost[name] = None
        if len(lost) > 1:
            raise UrdfError(f"{self.path}: {not_found(list(lost), self._folders)}")

    def _elsewhere(self, path: str) -> Path | None:
        """Return the mesh of an absolute path of another machine, by a package folder in it."""
        parts = [part for part in path.split("/") if part]
        near = {folder.name: folder for folder in reversed(self._folders)}
        for index, name in enumerate(parts[:-1]):
            folder = self.packages.get(name) or near.get(name)
            if folder is not None:
                mesh = resolved(folder.joinpath(*parts[index + 1 :]))
                if self._allowed(mesh) and mesh.is_file():
                    return mesh
        return None

    def _in(self, package: Path | None, rest: str) -> Path | None:
        """Return a mesh of a package that was found."""
        if package is None:
            return None
        mesh = resolved(package / rest)
        inside = mesh.is_relative_to(resolved(package)) or self._allowed(mesh)
        return mesh if inside and mesh.is_file() else None

    def _package(self, name: str) -> Path | None:
        """Return the folder of a package; see `find_package`."""
        if name not in self._packages:
            self._packages[name] = find_package(name, self._folders, self._root)
        return self._packages[name]

    @cached_property
    def _packages(self) -> dict[str, Path | None]:
        """Packages that were searched."""
        return {}

    @cached_property
    def _folders(self) -> list[Path]:
        folder = resolved(self.path).parent
        return [folder, *list(folder.parents)[:MAX_MESH_PARENTS]]

    @cached_property
    def _root(self) -> Path:
        return resolved(self.root) if self.root else self._folders[-1]

    @cached_property
    def _roots(self) -> list[Path]:
        return [self._root, *(resolved(folder) for folder in self.packages.values())]

    def _allowed(self, path: Path) -> bool:
        return any(path.is_relative_to(root) for root in self._roots)

    def _look(self, scheme: str, relative: str) -> Path | None:
        name, _, rest = relative.partition("/")
        if scheme in ("package", "model") and name in self.packages:
            candidates = [self.packages[name] / rest]
        else:
            candidates = [f / text for f in self._folders for text in (relative, rest or relative)]
        for candidate in candidates:
            mesh = resolved(candidate)
            if self._allowed(mesh) and mesh.is_file():
                return mesh
        return None


def _package_of(path: str) -> str:
    """Return the folder of an absolute path that is most likely a package's: above `meshes`."""
    parts = [part for part in path.split("/") if part][:-1]
    before = [a for a, b in pairwise(parts) if b.lower() in ("mesh", "meshes")]
    return (before or parts or [""])[-1]


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
