"""Find the mesh files that a URDF names, within the allowed folders."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice, pairwise
from pathlib import Path

from momapos.core import FileFormatError, UrdfError, parse_xml, read_text_bounded, resolved

MAX_MESH_PARENTS = 4
"""Meshes may be up to this many folders above the URDF's; packages have them next to `urdf` [-]."""
MAX_PACKAGES = 200
"""Number of folders that are searched for a package, in each of the URDF's parent folders [-]."""
MAX_MANIFEST_BYTES = 100_000
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
        try:
            found = self._look(kind, relative) or (self._elsewhere(relative) if absolute else None)
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
        name, _, rest = relative.partition("/")
        if scheme and scheme[1] == "package" and name not in self.packages:
            package = self._package(name)
            if package is not None:
                mesh = resolved(package / rest)
                if self._allowed(mesh) and mesh.is_file():
                    return mesh
                raise UrdfError(
                    f"{self.path}: mesh {rest!r} does not exist in the package {package}"
                )
            looked = ", ".join(str(folder) for folder in self._folders)
            raise UrdfError(
                f"{self.path}: package {name!r} of mesh {filename!r} was not found (searched in "
                f"{looked}); move it there, or give its folder: --package {name}=DIR of momapos "
                "robot check, [packages] in a robot file"
            )
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
            looked = ", ".join(str(folder) for folder in self._folders)
            options = " ".join(f"--package {name}=DIR" for name in lost)
            raise UrdfError(
                f"{self.path}: packages {', '.join(map(repr, lost))} were not found (searched in "
                f"{looked}); move them there, or give their folders: {options} of momapos robot "
                "check, [packages] in a robot file"
            )

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

    def _package(self, name: str) -> Path | None:
        """Return the folder of a package near the URDF: by its own name, or as in `package.xml`."""
        for folder in self._folders:
            if folder.name == name and self._allowed(folder):
                return folder
            near = (folder, *islice(_subfolders(folder), MAX_PACKAGES))
            for one in near:
                if self._allowed(resolved(one)) and (one.name == name or package_name(one) == name):
                    return one
        return None

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


def _subfolders(folder: Path) -> Iterator[Path]:
    """Yield the folders in a folder, as far as they can be listed."""
    with suppress(OSError):
        yield from (one for one in folder.iterdir() if one.is_dir())


def package_name(folder: Path) -> str | None:
    """Return the name in the `package.xml` of a folder; None without one."""
    manifest = folder / "package.xml"
    try:
        if not manifest.is_file():
            return None
        text = read_text_bounded(manifest, MAX_MANIFEST_BYTES, error=UrdfError)
        tree = parse_xml(text, manifest, error=UrdfError)
    except (OSError, UrdfError):
        return None
    return (tree.findtext("name") or "").strip() or None
